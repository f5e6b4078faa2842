//! Embedding of a finer surface in the layer: interpolation from its nodes.

use glam::DVec3;
use rayon::prelude::*;

/// Number of nodes from which one vertex of the surface is interpolated.
pub const CARRIERS: usize = 12;

/// Vertices as weighted sums of nodes.
pub struct Embedding {
    /// Nodes of each vertex; indices beyond the free ones are fixed nodes.
    pub nodes: Vec<[u32; CARRIERS]>,
    /// Weights of the nodes; those of each vertex sum to 1.
    pub weights: Vec<[f64; CARRIERS]>,
}

impl Embedding {
    /// Interpolates nodal values `a` and `b` of the free nodes at the vertices.
    pub fn carry<T: From<(DVec3, DVec3)> + Send>(&self, a: &[DVec3], b: &[DVec3], out: &mut [T]) {
        let vertices = self.nodes.par_iter().zip(&self.weights).zip(out).with_min_len(4096);
        vertices.for_each(|((nodes, weights), out)| {
            let (mut first, mut second) = (DVec3::ZERO, DVec3::ZERO);
            for (n, weight) in nodes.iter().zip(weights) {
                let n = *n as usize;
                if n < a.len() {
                    first += *weight * a[n];
                    second += *weight * b[n];
                }
            }
            *out = T::from((first, second));
        });
    }

    /// Distributes forces of vertices to the free nodes they are interpolated from, with equal
    /// work.
    pub fn gather(&self, force: impl Fn(usize) -> DVec3, out: &mut [DVec3]) {
        for (v, (nodes, weights)) in self.nodes.iter().zip(&self.weights).enumerate() {
            let force = force(v);
            if force == DVec3::ZERO {
                continue;
            }
            for (n, weight) in nodes.iter().zip(weights) {
                if let Some(out) = out.get_mut(*n as usize) {
                    *out += *weight * force;
                }
            }
        }
    }
}
