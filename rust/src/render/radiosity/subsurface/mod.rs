//! Light through the tissue behind the wall, in real time.
//!
//! Light that leaves a point of the wall has entered around it. Random walks from that point, as in
//! path tracing, sample the entries: by reciprocity light takes the same paths back. They are
//! traced once, at rest, from *nodes*, vertices no closer than a free path. In each frame LEDs and
//! indirect light fall on the nodes that are needed, and each seen vertex takes their shares.

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

/// Least distance between nodes, over the longest free path between two scatterings.
const SPACING: f32 = 0.8;
/// Weight of a neighbor in what comes out at a node, if it faces the same way.
const NEIGHBOR: f32 = 0.5;

/// Transport of light from its entry into the wall to its exit.
pub struct Transport {
    tissue: Tissue,
    nodes: GatherPoints,
    /// Mean base color of what each node stands for.
    color: Vec<Vec3>,
    rows: Vec<OnceBox<Row>>,
    /// Ratio of the exiting light to that of a node's own row, which is noisy.
    better: Vec<OnceBox<Vec3>>,
    cache: CachePool<frame::Lit>,
}

impl Transport {
    /// Prepares for the tissue behind a wall at rest.
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

    /// Transmittance of the interface at this cosine, relative to the mean of diffuse light.
    pub fn transmittance(&self, cosine: f32) -> f32 {
        self.tissue.transmittance(cosine)
    }

    /// Light that a vertex gives back under diffuse light, over what a level wall would.
    pub fn kept(&self, rest: &Wall, vertex: usize) -> Vec3 {
        let node = self.nodes.of_vertex[vertex] as usize;
        let (total, better) = (self.row(rest, node).total(), self.better(rest, node));
        [0, 1, 2].map(|k| total[k] * better[k])
    }

    /// Factor of a row that makes it sum to a mean over the nodes around it: noise of walks is that
    /// of each, what the wall's shape does is not.
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
