//! Sites: the points of the wall where bounced light is reckoned, and how it is spread from them.

use crate::lanes::*;
use crate::mucosa::grid::{CellHasher, pack};
use crate::query;
use crate::wall::Wall;
use rayon::prelude::*;
use std::collections::HashMap;
use std::hash::BuildHasherDefault;

/// Least distance between sites, as a share of the lumen's width.
const SPACING: f32 = 0.1;
/// How far a site is heard, in spacings.
const HEARING: f32 = 1.5;
/// Least cosine between the normals of a vertex and of the site that stands for it.
const SAME_SIDE: f32 = 0.7;
/// Cosine between normals at which a vertex no longer hears a site.
const OTHER_SIDE: f32 = 0.3;
/// Sites that a vertex hears at most.
pub const HEARD: usize = 8;
/// Vertices from which the lumen's width is measured.
const PROBES: usize = 512;
/// A site that is none.
const NONE: u32 = u32::MAX;

/// Points of a wall, chosen among its vertices at rest.
pub struct Sites {
    /// Vertex of each site; neighbours in the hierarchy are neighbours here.
    pub vertex: Vec<u32>,
    /// Width of the lumen at rest [m]: the median way across it.
    pub lumen: f32,
    /// Distance between sites at rest [m].
    pub spacing: f32,
    /// The site that stands for each vertex.
    pub of_vertex: Vec<u32>,
    /// Sites heard by each vertex and their weights, which sum to 1; unused ones weigh 0.
    pub heard: Vec<[(u32, f32); HEARD]>,
    /// Vertices that each site stands for: `members[start[s]..start[s + 1]]`.
    start: Vec<u32>,
    members: Vec<u32>,
}

impl Sites {
    /// Chooses sites on a wall at rest.
    pub fn choose(wall: &Wall) -> Self {
        let lumen = lumen_width(wall);
        let spacing = SPACING * lumen;
        let mut grid = Grid::new(HEARING * spacing);
        let mut vertex: Vec<u32> = Vec::new();
        let mut seen = vec![false; wall.vertices.len()];
        for &v in wall.bvh.corners.iter().flatten() {
            if std::mem::replace(&mut seen[v as usize], true) {
                continue;
            }
            let (place, normal) = (wall.vertices[v as usize], wall.normals[v as usize]);
            let mut is_covered = false;
            grid.near(place, |site| {
                let other = vertex[site as usize] as usize;
                let offset = sub(place, wall.vertices[other]);
                is_covered |= dot(offset, offset) < spacing * spacing
                    && dot(normal, wall.normals[other]) > SAME_SIDE;
            });
            if !is_covered {
                grid.put(place, vertex.len() as u32);
                vertex.push(v);
            }
        }
        let heard: Vec<_> = (0..wall.vertices.len())
            .into_par_iter()
            .map(|v| if seen[v] { hear(wall, &vertex, &grid, v) } else { [(0, 0.0); HEARD] })
            .collect();
        let mut of_vertex: Vec<u32> =
            heard.iter().map(|h| if h[0].1 > 0.0 { h[0].0 } else { NONE }).collect();
        for (s, &v) in vertex.iter().enumerate() {
            of_vertex[v as usize] = s as u32;
        }
        let (start, members) = members(&of_vertex, vertex.len());
        Sites { vertex, lumen, spacing, of_vertex, heard, start, members }
    }

    /// Vertices that site `s` stands for.
    pub fn members(&self, s: usize) -> &[u32] {
        &self.members[self.start[s] as usize..self.start[s + 1] as usize]
    }
}

/// The vertex nearest to where a ray meets a triangle, given as in `tile::Hits`.
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

/// Median way from the wall along its normal to the other side [m].
fn lumen_width(wall: &Wall) -> f32 {
    let corners = &wall.bvh.corners;
    let step = (corners.len() / PROBES).max(1);
    let across = |corner: &[u32; 3]| {
        let v = corner[0] as usize;
        let origin = add(wall.vertices[v], scale(wall.normals[v], 1e-5 * wall.extent));
        query::cast(&wall.bvh, origin, wall.normals[v]).map(|(distance, _)| distance)
    };
    let mut ways: Vec<f32> = corners.iter().step_by(step).filter_map(across).collect();
    ways.sort_unstable_by(f32::total_cmp);
    ways.get(ways.len() / 2).copied().unwrap_or(wall.extent)
}

/// The sites that vertex `v` hears, the loudest first.
fn hear(wall: &Wall, vertex: &[u32], grid: &Grid, v: usize) -> [(u32, f32); HEARD] {
    let (place, normal) = (wall.vertices[v], wall.normals[v]);
    let reach = grid.edge * grid.edge;
    let mut found: Vec<(u32, f32)> = Vec::new();
    grid.near(place, |site| {
        let other = vertex[site as usize] as usize;
        let offset = sub(place, wall.vertices[other]);
        let near = max(1.0 - dot(offset, offset) / reach, 0.0);
        let facing = max(dot(normal, wall.normals[other]) - OTHER_SIDE, 0.0);
        let weight = near * near * facing * facing;
        if weight > 0.0 {
            found.push((site, weight));
        }
    });
    found.sort_unstable_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    found.truncate(HEARD);
    let sum: f32 = found.iter().map(|h| h.1).sum();
    std::array::from_fn(|k| found.get(k).map_or((0, 0.0), |h| (h.0, h.1 / sum)))
}

/// Vertices sorted by their site.
fn members(of_vertex: &[u32], num_sites: usize) -> (Vec<u32>, Vec<u32>) {
    let mut order: Vec<u32> =
        (0..of_vertex.len() as u32).filter(|&v| of_vertex[v as usize] != NONE).collect();
    order.sort_by_key(|&v| of_vertex[v as usize]);
    let mut start = vec![0u32; num_sites + 1];
    for &v in &order {
        start[of_vertex[v as usize] as usize + 1] += 1;
    }
    for s in 0..num_sites {
        start[s + 1] += start[s];
    }
    (start, order)
}

/// Sites by the cells of space they lie in.
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

    fn put(&mut self, place: Vec3, site: u32) {
        self.cells.entry(pack(self.cell(place))).or_default().push(site);
    }

    /// Visits all sites nearer than an edge, and some farther.
    fn near(&self, place: Vec3, mut visit: impl FnMut(u32)) {
        let [x, y, z] = self.cell(place);
        for k in 0..27 {
            let cell = [x + k % 3 - 1, y + k / 3 % 3 - 1, z + k / 9 - 1];
            self.cells.get(&pack(cell)).into_iter().flatten().for_each(|&site| visit(site));
        }
    }
}
