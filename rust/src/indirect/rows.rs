//! Rows of light transport: what a site sees of the wall.

use super::lobe::Lobe;
use super::sites::{Sites, nearest_corner};
use crate::lanes::*;
use crate::path::ray;
use crate::wall::Wall;

/// Rays of a row are a square of so many by so many; even.
const SIDE: usize = 16;
/// Share of a row that one ray carries.
const RAY: f32 = 1.0 / (SIDE * SIDE) as f32;
/// How far in front of the wall rays start, in spacings of sites.
const LIFT: f32 = 0.02;

/// How much of the light that reaches a site comes from another.
#[derive(Clone, Copy)]
pub struct Link {
    /// The other site.
    pub from: u32,
    /// Share of the cosine-weighted hemisphere that it fills.
    pub share: f32,
}

/// What a site sees of the others.
pub struct Row {
    /// By all rays.
    pub fine: Box<[Link]>,
    /// By every fourth ray: enough for light that is reflected once more before it is seen.
    pub coarse: Box<[Link]>,
}

/// Traces the row of a site at rest: stratified rays, weighted by the cosine.
pub fn trace_row(wall: &Wall, sites: &Sites, site: usize) -> Row {
    let mut seen = look(wall, sites, site);
    seen.sort_unstable();
    let runs = || seen.chunk_by(|a, b| a.0 == b.0);
    let link = |from: u32, count: usize, ray: f32| Link { from, share: count as f32 * ray };
    let coarse = |run: &[(u32, bool)]| {
        let count = run.iter().filter(|s| s.1).count();
        (count > 0).then(|| link(run[0].0, count, 4.0 * RAY))
    };
    Row {
        fine: runs().map(|run| link(run[0].0, run.len(), RAY)).collect(),
        coarse: runs().filter_map(coarse).collect(),
    }
}

/// The site that each ray meets, and whether the ray is one of every fourth.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn look(wall: &Wall, sites: &Sites, site: usize) -> Vec<(u32, bool)> {
    let vertex = sites.vertex[site] as usize;
    let normal = wall.normals[vertex];
    let origin = add(wall.vertices[vertex], scale(normal, LIFT * sites.spacing[site]));
    let lobe = Lobe::turned(normal, 1.0, SIDE, site);
    let mut seen = Vec::with_capacity(SIDE * SIDE);
    for (i, direction) in lobe.directions().enumerate() {
        let (row, column) = (i / SIDE, i % SIDE);
        let hit = ray::cast::<false>(&wall.bvh, origin, direction, f32::MAX, u32::MAX);
        // The back of a wall is dark.
        if let Some(hit) = hit.filter(|hit| hit.edges[2] < 0.0) {
            let vertex = nearest_corner(wall, hit.triangle, hit.edges);
            // Corners of blocks of two by two by turns, so that no direction is preferred.
            let (x, y) = (column / 2, row / 2);
            let is_fourth = (column % 2, row % 2) == (y % 2, (x + y) % 2);
            seen.push((sites.of_vertex[vertex], is_fourth));
        }
    }
    seen
}
