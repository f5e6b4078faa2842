//! Form-factor rows: gather points visible from a gather point.

use super::deformed_transport::Patch;
use super::gather_points::{GatherPoints, nearest_corner};
use super::stratified_lobe::Lobe;
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::ray;

/// Square root of the number of rays of a row; even.
const SIDE: usize = 12;
/// Fraction of a row that one ray carries.
const RAY: f32 = 1.0 / (SIDE * SIDE) as f32;
/// Distance of ray starts from the wall, in spacings of gather points.
const LIFT: f32 = 0.02;

/// Form factor from a gather point to another.
#[derive(Clone, Copy)]
pub struct FormFactor {
    /// The other gather point.
    pub from: u32,
    /// Fraction of the cosine-weighted hemisphere that it covers.
    pub form_factor: f32,
    /// `Patch::geometry` at rest.
    pub geometry: f32,
}

/// Form factor with direction, for surfaces whose normal is not that of the gather point.
#[derive(Clone, Copy)]
pub struct FormFactorVector {
    /// The other gather point.
    pub from: u32,
    /// Sum of the directions to it; its component along a normal is that normal's form factor.
    pub direction: Vec3,
    /// `Patch::geometry` at rest.
    pub geometry: f32,
}

/// Form factors from a gather point to all gather points visible from it.
pub struct FormFactorRow {
    /// From all rays.
    pub fine: Box<[FormFactorVector]>,
    /// From every fourth ray: sufficient for light that is reflected again before it is visible.
    pub coarse: Box<[FormFactor]>,
}

/// A ray of a row: the gather point that it hits, its index and its direction over its cosine.
type RowRay = (u32, usize, Vec3);

/// Traces the row of a gather point at rest: stratified rays, weighted by the cosine.
pub fn trace_row(wall: &Wall, gather_points: &GatherPoints, gather_point: usize) -> FormFactorRow {
    let mut seen = look(wall, gather_points, gather_point);
    seen.sort_unstable_by_key(|&(from, number, _)| (from, number));
    let runs = || seen.chunk_by(|a, b| a.0 == b.0);
    let own = Patch::of(wall, gather_points, gather_point);
    let geometry = |from: u32| {
        let other = Patch::of(wall, gather_points, from as usize);
        own.geometry(&other, gather_points.spacing[from as usize])
    };
    let beam = |run: &[RowRay]| FormFactorVector {
        from: run[0].0,
        direction: scale(run.iter().fold([0.0; 3], |sum, ray| add(sum, ray.2)), RAY),
        geometry: geometry(run[0].0),
    };
    let coarse = |run: &[RowRay]| {
        let count = run.iter().filter(|ray| is_fourth(ray.1)).count();
        let (from, form_factor) = (run[0].0, 4.0 * RAY * count as f32);
        (count > 0).then(|| FormFactor { from, form_factor, geometry: geometry(from) })
    };
    FormFactorRow { fine: runs().map(beam).collect(), coarse: runs().filter_map(coarse).collect() }
}

/// True for every fourth ray: alternating corners of 2 × 2 blocks, so that no direction is
/// preferred.
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
fn look(wall: &Wall, gather_points: &GatherPoints, gather_point: usize) -> Vec<RowRay> {
    let vertex = gather_points.vertex[gather_point] as usize;
    let normal = wall.normals[vertex];
    let origin =
        add(wall.vertices[vertex], scale(normal, LIFT * gather_points.spacing[gather_point]));
    let lobe = Lobe::turned(normal, 1.0, SIDE, gather_point);
    let (mut seen, mut pile) = (Vec::with_capacity(SIDE * SIDE), ray::Pile::default());
    for (number, direction) in lobe.directions().enumerate() {
        let ray = (origin, direction);
        let hit = ray::cast_in::<false>(&mut pile, &wall.bvh, ray, f32::MAX, u32::MAX);
        // The back of a wall reflects no light.
        if let Some(hit) = hit.filter(|hit| hit.edges[2] < 0.0) {
            let vertex = nearest_corner(wall, hit.triangle, hit.edges);
            let weighted = scale(direction, 1.0 / dot(direction, normal));
            seen.push((gather_points.of_vertex[vertex], number, weighted));
        }
    }
    seen
}
