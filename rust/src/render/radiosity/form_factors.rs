//! Rows of light transport: what a site sees of the wall.

use super::deformed_transport::Place;
use super::gather_points::{Sites, nearest_corner};
use super::stratified_lobe::Lobe;
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::ray;

/// Rays of a row are a square of so many by so many; even.
const SIDE: usize = 12;
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
    /// `Place::exchange` at rest.
    pub exchange: f32,
}

/// The same with the direction, for surfaces whose normal is not that of the site.
#[derive(Clone, Copy)]
pub struct Beam {
    /// The other site.
    pub from: u32,
    /// Sum of the directions to it; its part along a normal is the share for that normal.
    pub way: Vec3,
    /// `Place::exchange` at rest.
    pub exchange: f32,
}

/// What a site sees of the others.
pub struct Row {
    /// By all rays.
    pub fine: Box<[Beam]>,
    /// By every fourth ray: enough for light that is reflected once more before it is seen.
    pub coarse: Box<[Link]>,
}

/// A ray of a row: the site that it meets, its number and its direction over its cosine.
type Ray = (u32, usize, Vec3);

/// Traces the row of a site at rest: stratified rays, weighted by the cosine.
pub fn trace_row(wall: &Wall, sites: &Sites, site: usize) -> Row {
    let mut seen = look(wall, sites, site);
    seen.sort_unstable_by_key(|&(from, number, _)| (from, number));
    let runs = || seen.chunk_by(|a, b| a.0 == b.0);
    let own = Place::of(wall, sites, site);
    let exchange = |from: u32| {
        let other = Place::of(wall, sites, from as usize);
        own.exchange(&other, sites.spacing[from as usize])
    };
    let beam = |run: &[Ray]| Beam {
        from: run[0].0,
        way: scale(run.iter().fold([0.0; 3], |sum, ray| add(sum, ray.2)), RAY),
        exchange: exchange(run[0].0),
    };
    let coarse = |run: &[Ray]| {
        let count = run.iter().filter(|ray| is_fourth(ray.1)).count();
        let (from, share) = (run[0].0, 4.0 * RAY * count as f32);
        (count > 0).then(|| Link { from, share, exchange: exchange(from) })
    };
    Row { fine: runs().map(beam).collect(), coarse: runs().filter_map(coarse).collect() }
}

/// Whether a ray is one of every fourth: corners of blocks of two by two by turns, so that no
/// direction is preferred.
fn is_fourth(number: usize) -> bool {
    let (row, column) = (number / SIDE, number % SIDE);
    let (x, y) = (column / 2, row / 2);
    (column % 2, row % 2) == (y % 2, (x + y) % 2)
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn look(wall: &Wall, sites: &Sites, site: usize) -> Vec<Ray> {
    let vertex = sites.vertex[site] as usize;
    let normal = wall.normals[vertex];
    let origin = add(wall.vertices[vertex], scale(normal, LIFT * sites.spacing[site]));
    let lobe = Lobe::turned(normal, 1.0, SIDE, site);
    let mut seen = Vec::with_capacity(SIDE * SIDE);
    for (number, direction) in lobe.directions().enumerate() {
        let hit = ray::cast::<false>(&wall.bvh, origin, direction, f32::MAX, u32::MAX);
        // The back of a wall is dark.
        if let Some(hit) = hit.filter(|hit| hit.edges[2] < 0.0) {
            let vertex = nearest_corner(wall, hit.triangle, hit.edges);
            let way = scale(direction, 1.0 / dot(direction, normal));
            seen.push((sites.of_vertex[vertex], number, way));
        }
    }
    seen
}
