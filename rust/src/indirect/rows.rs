//! Rows of light transport: what a site sees of the wall.

use super::lamps::nearest_corner;
use super::sites::Sites;
use crate::lanes::*;
use crate::tile::{Hits, MISS, Pyramid, trace};
use crate::wall::Wall;
use std::f32::consts::{FRAC_PI_2, TAU};

/// Rays of a row: a tile for each quarter of the hemisphere.
const QUARTERS: usize = 4;
/// Share of a row that one ray carries.
const RAY: f32 = 1.0 / (QUARTERS * LANES) as f32;
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
    let vertex = sites.vertex[site] as usize;
    let normal = wall.normals[vertex];
    let origin = add(wall.vertices[vertex], scale(normal, LIFT * sites.spacing));
    let mut seen = Vec::with_capacity(QUARTERS * LANES);
    for quarter in 0..QUARTERS {
        look(wall, sites, origin, hemisphere_quarter(normal, site, quarter), &mut seen);
    }
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

/// Whether a ray is one of every fourth: one in each block of two by two cells.
fn is_coarse(i: usize) -> bool {
    let (x, y) = (i % TILE, i / TILE);
    // Corners of the block by turns, so that no direction is preferred.
    (x % 2, y % 2) == (x / 2 % 2, (x / 2 + y / 2) % 2)
}

/// A quarter of a site's hemisphere, in cells of equal cosine-weighted size.
fn hemisphere_quarter(normal: Vec3, site: usize, quarter: usize) -> Lane3 {
    let least = if normal[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let right = normalize(cross(normal, least));
    let down = cross(normal, right);
    // Neighbours turn by the golden ratio, so that their errors differ.
    let turn = TAU * (site as f32 * 0.618_034).fract();
    let mut directions = [[0.0; LANES]; 3];
    for i in 0..LANES {
        let square = ((i / TILE) as f32 + 0.5) / TILE as f32;
        let share = ((i % TILE) as f32 + 0.5) / TILE as f32;
        let angle = turn + FRAC_PI_2 * (quarter as f32 + share);
        let (across, up) = (square.sqrt(), (1.0 - square).sqrt());
        let [x, y] = [across * angle.cos(), across * angle.sin()];
        for k in 0..3 {
            directions[k][i] = x * right[k] + y * down[k] + up * normal[k];
        }
    }
    directions
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn look(wall: &Wall, sites: &Sites, origin: Vec3, directions: Lane3, seen: &mut Vec<(u32, bool)>) {
    let rays = Pyramid::around(directions, &[true; LANES]);
    let mut hits = Hits::within([f32::MAX; LANES]);
    trace::<false>(&wall.bvh, origin, &rays, wall.extent, &mut hits);
    for i in 0..LANES {
        // The back of a wall is dark.
        if hits.triangle[i] == MISS || hits.edges[2][i] > 0.0 {
            continue;
        }
        seen.push((sites.of_vertex[nearest_corner(wall, &hits, i)], is_coarse(i)));
    }
}
