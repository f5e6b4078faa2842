//! Light through the tissue behind the wall, in real time.
//!
//! Light that leaves a point of the wall has entered around it. Random walks from that point, as in
//! path tracing, sample the entries: by reciprocity light takes the same paths back. They are
//! traced once, at rest, from *nodes*, vertices at least a free path apart. In each frame LEDs and
//! indirect light illuminate the nodes that are needed, and each visible vertex gathers from them.

mod frame;
mod transport_row;

pub use frame::{SubsurfaceFrame, SubsurfaceLight};
use once_cell::race::OnceBox;
use transport_row::{Row, trace_row};

use super::gather_points::GatherPoints;
use super::lazy_cache::CachePool;
use super::patch_albedo::PatchAlbedo;
use crate::render::path::subsurface::Tissue;
use crate::render::scene::SceneData;
use crate::simd::f32x64::*;
use crate::wall::Wall;

/// Minimum distance between nodes, over the longest free path between two scatterings.
const SPACING: f32 = 0.8;
/// Weight of a neighbor in the mean of a node's exiting light, if its normal is the same.
const NEIGHBOR: f32 = 0.5;

/// Transport of light from its entry into the wall to its exit.
pub struct Transport {
    tissue: Tissue,
    nodes: GatherPoints,
    /// Mean base color of the region that each node represents.
    color: Vec<Vec3>,
    rows: Vec<OnceBox<Row>>,
    /// Ratio of the smoothed exiting light to that of a node's own row, which is noisy.
    better: Vec<OnceBox<Vec3>>,
    cache: CachePool<frame::Lit>,
}

impl Transport {
    /// Prepares the transport in the tissue behind a wall at rest.
    pub fn new(wall: &Wall, scene: &SceneData, tissue: &Tissue) -> Self {
        let [r, g, b] = tissue.scattering;
        let spacing = SPACING / min(r, min(g, b));
        let nodes = GatherPoints::apart(wall, &vec![spacing; wall.vertices.len()]);
        let color = PatchAlbedo::mean(wall, scene, &nodes).albedo;
        let rows = nodes.vertex.iter().map(|_| OnceBox::new()).collect();
        let better = nodes.vertex.iter().map(|_| OnceBox::new()).collect();
        let cache = CachePool::new((2 * nodes.vertex.len(), wall.vertices.len()));
        Transport { tissue: tissue.clone(), nodes, color, rows, better, cache }
    }

    /// Transmittance of the interface at this cosine, relative to the mean over diffuse light.
    pub fn transmittance(&self, cosine: f32) -> f32 {
        self.tissue.transmittance(cosine)
    }

    /// Light that a vertex returns under diffuse light, relative to a flat wall.
    pub fn kept(&self, rest: &Wall, vertex: usize) -> Vec3 {
        let node = self.nodes.of_vertex[vertex] as usize;
        let (total, better) = (self.row(rest, node).total(), self.better(rest, node));
        [0, 1, 2].map(|k| total[k] * better[k])
    }

    /// Factor on a row that makes it sum to a mean over the neighboring nodes: the noise of their
    /// walks is independent, the effect of the wall's shape is not.
    fn better(&self, rest: &Wall, node: usize) -> Vec3 {
        *self.better[node].get_or_init(|| {
            let own = self.row(rest, node).total();
            let vertex = self.nodes.vertex[node] as usize;
            let (mut sum, mut weight) = (own, 1.0);
            // Each neighbor is a corner of two of the faces.
            let faces = rest.faces_around(vertex).iter().map(|&f| rest.faces[f as usize]);
            for v in faces.flatten().map(|v| v as usize).filter(|&v| v != vertex) {
                let facing = dot(rest.normals[v], rest.normals[vertex]);
                let part = 0.5 * NEIGHBOR * max(facing, 0.0);
                let total = self.row(rest, self.nodes.of_vertex[v] as usize).total();
                sum = add(sum, scale(total, part));
                weight += part;
            }
            Box::new([0, 1, 2].map(|k| sum[k] / (weight * max(own[k], 1e-6))))
        })
    }

    fn row(&self, rest: &Wall, node: usize) -> &Row {
        let trace = || trace_row(rest, &self.tissue, &self.nodes, (node, self.color[node]));
        self.rows[node].get_or_init(|| Box::new(trace()))
    }
}
