//! Gather points: points of the wall where indirect light is computed, and interpolation from them.

use super::stratified_lobe::Lobe;
use crate::mucosa::grid::{CellHasher, pack};
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::ray;
use rayon::prelude::*;
use std::collections::HashMap;
use std::hash::BuildHasherDefault;

/// Distance between gather points, as a fraction of the harmonic mean distance of the surfaces
/// visible there (Ward et al. 1988); in a tube that mean is about its radius.
const SPACING: f32 = 0.3;
/// Minimum and maximum spacing of gather points, as fractions of the median spacing.
const SPACINGS: [f32; 2] = [0.2, 1.5];
/// Number of vertices, consecutive in the hierarchy, that share a distance.
const GROUP: usize = 4;
/// Square root of the number of rays per vertex that measure the distance.
const SIDE: usize = 2;
/// Interpolation radius of a gather point, in its spacings.
const INTERPOLATION_RADIUS: f32 = 1.5;
/// Minimum cosine between the normals of a vertex and of the gather point that represents it.
const SAME_SIDE: f32 = 0.7;
/// Cosine between normals below which a vertex does not interpolate from a gather point.
const OTHER_SIDE: f32 = 0.3;
/// Maximum number of gather points from which a vertex interpolates.
pub const MAX_NEIGHBORS: usize = 8;

/// Points of a wall, chosen among its vertices at rest.
pub struct GatherPoints {
    /// Vertex of each gather point, in the order of the hierarchy.
    pub vertex: Vec<u32>,
    /// Distance between gather points around each at rest [m].
    pub spacing: Vec<f32>,
    /// Gather point that represents each vertex.
    pub of_vertex: Vec<u32>,
    /// Gather points from which each vertex interpolates and their weights, which sum to 1; unused
    /// ones have weight 0.
    pub neighbors: Vec<[(u32, f32); MAX_NEIGHBORS]>,
}

impl GatherPoints {
    /// Chooses gather points on a wall at rest, with distances set by the visible surfaces.
    pub fn choose(wall: &Wall) -> Self {
        let order = in_hierarchy(wall);
        GatherPoints::of_ordered(wall, &order, &spacings(wall, &order))
    }

    /// Chooses gather points on a wall at rest at the given distances around each vertex [m], or at
    /// the distances of vertices if these are larger.
    pub fn apart(wall: &Wall, spacings: &[f32]) -> Self {
        GatherPoints::of_ordered(wall, &in_hierarchy(wall), spacings)
    }

    /// Chooses gather points among vertices in the order of the hierarchy.
    fn of_ordered(wall: &Wall, order: &[u32], spacings: &[f32]) -> Self {
        let widest = spacings.iter().fold(0.0, |a, &b| max(a, b));
        let mut grid = Grid::new(INTERPOLATION_RADIUS * widest);
        let (mut vertex, mut spacing): (Vec<u32>, Vec<f32>) = (Vec::new(), Vec::new());
        for &v in order {
            let (place, normal) = (wall.vertices[v as usize], wall.normals[v as usize]);
            let own = spacings[v as usize];
            let mut is_covered = false;
            grid.near(place, |gather_point| {
                let other = vertex[gather_point as usize] as usize;
                let offset = sub(place, wall.vertices[other]);
                let reach = min(own, spacing[gather_point as usize]);
                is_covered |= dot(offset, offset) < reach * reach
                    && dot(normal, wall.normals[other]) > SAME_SIDE;
            });
            if !is_covered {
                grid.put(place, vertex.len() as u32);
                vertex.push(v);
                spacing.push(own);
            }
        }
        let near =
            |v: usize| interpolation_weights(wall, (&vertex, &spacing), &grid, v, spacings[v]);
        let mut neighbors = vec![[(0, 0.0); MAX_NEIGHBORS]; wall.vertices.len()];
        let found: Vec<_> = order.par_iter().map(|&v| near(v as usize)).collect();
        for (&v, found) in order.iter().zip(found) {
            neighbors[v as usize] = found;
        }
        let mut of_vertex: Vec<u32> = neighbors.iter().map(|h| h[0].0).collect();
        for (s, &v) in vertex.iter().enumerate() {
            of_vertex[v as usize] = s as u32;
        }
        GatherPoints { vertex, spacing, of_vertex, neighbors }
    }
}

/// Vertex nearest to the hit of a ray on a triangle, given as in `packet::Hits`.
#[inline(always)]
pub fn nearest_corner(wall: &Wall, triangle: u32, edges: Vec3) -> usize {
    let [a, b, c] = wall.bvh.corners[triangle as usize];
    let inverse = 1.0 / edges[2];
    let (wa, wb) = (edges[0] * inverse, edges[1] * inverse);
    let wc = 1.0 - wa - wb;
    (if wa >= wb && wa >= wc {
        a
    } else if wb >= wc {
        b
    } else {
        c
    }) as usize
}

/// Vertices of triangles, each once, in the order of the hierarchy.
fn in_hierarchy(wall: &Wall) -> Vec<u32> {
    let mut seen = vec![false; wall.vertices.len()];
    let is_new = |v: &u32| !std::mem::replace(&mut seen[*v as usize], true);
    wall.bvh.corners.iter().flatten().copied().filter(is_new).collect()
}

/// Target distance of gather points around each vertex [m].
fn spacings(wall: &Wall, order: &[u32]) -> Vec<f32> {
    let shared: Vec<f32> =
        order.par_chunks(GROUP).map(|group| SPACING * openness(wall, group)).collect();
    let mut sorted = shared.clone();
    sorted.sort_unstable_by(f32::total_cmp);
    let [least, most] = SPACINGS.map(|factor| factor * sorted[sorted.len() / 2]);
    let mut found = vec![most; wall.vertices.len()];
    for (group, own) in order.chunks(GROUP).zip(shared) {
        for &v in group {
            found[v as usize] = clamp(own, least, most);
        }
    }
    found
}

/// Harmonic mean distance of the surfaces visible from a group of vertices [m]; rays without a hit
/// count with the extent of the wall.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn openness(wall: &Wall, group: &[u32]) -> f32 {
    let mut sum = 0.0;
    for (k, &v) in group.iter().enumerate() {
        let normal = wall.normals[v as usize];
        let origin = add(wall.vertices[v as usize], scale(normal, 1e-4 * wall.extent));
        for direction in Lobe::shifted(normal, 1.0, SIDE, k).directions() {
            let hit = ray::cast::<false>(&wall.bvh, origin, direction, wall.extent, u32::MAX);
            sum += 1.0 / hit.map_or(wall.extent, |hit| max(hit.distance, 1e-4 * wall.extent));
        }
    }
    (SIDE * SIDE * group.len()) as f32 / sum
}

/// Gather points from which vertex `v` interpolates, in descending order of weight; `own` is the
/// spacing around it.
fn interpolation_weights(
    wall: &Wall,
    (vertex, spacing): (&[u32], &[f32]),
    grid: &Grid,
    v: usize,
    own: f32,
) -> [(u32, f32); MAX_NEIGHBORS] {
    let (place, normal) = (wall.vertices[v], wall.normals[v]);
    let mut found: Vec<(u32, f32)> = Vec::new();
    grid.near(place, |gather_point| {
        let other = vertex[gather_point as usize] as usize;
        let offset = sub(place, wall.vertices[other]);
        let reach = INTERPOLATION_RADIUS * min(own, spacing[gather_point as usize]);
        let near = max(1.0 - dot(offset, offset) / (reach * reach), 0.0);
        let facing = max(dot(normal, wall.normals[other]) - OTHER_SIDE, 0.0);
        let weight = near * near * facing * facing;
        if weight > 0.0 {
            found.push((gather_point, weight));
        }
    });
    found.sort_unstable_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    found.truncate(MAX_NEIGHBORS);
    let sum: f32 = found.iter().map(|h| h.1).sum();
    std::array::from_fn(|k| found.get(k).map_or((0, 0.0), |h| (h.0, h.1 / sum)))
}

/// Gather points sorted into cells of space.
struct Grid {
    edge: f32,
    cells: HashMap<u64, Vec<u32>, BuildHasherDefault<CellHasher>>,
}

impl Grid {
    fn new(edge: f32) -> Self {
        Grid { edge, cells: HashMap::default() }
    }

    fn cell(&self, place: Vec3) -> [i32; 3] {
        place.map(|x| (x / self.edge).floor() as i32)
    }

    fn put(&mut self, place: Vec3, gather_point: u32) {
        self.cells.entry(pack(self.cell(place))).or_default().push(gather_point);
    }

    /// Visits all gather points within an edge length, and some beyond.
    fn near(&self, place: Vec3, mut visit: impl FnMut(u32)) {
        let [x, y, z] = self.cell(place);
        for k in 0..27 {
            let cell = [x + k % 3 - 1, y + k / 3 % 3 - 1, z + k / 9 - 1];
            self.cells
                .get(&pack(cell))
                .into_iter()
                .flatten()
                .for_each(|&gather_point| visit(gather_point));
        }
    }
}
