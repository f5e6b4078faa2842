//! How a finer surface hangs on the layer's nodes.

use glam::DVec3;
use rayon::prelude::*;

/// Nodes that carry one vertex of the surface.
pub const CARRIERS: usize = 12;

/// Vertices as weighted sums of nodes.
pub struct Embedding {
    /// Nodes of each vertex; beyond the free ones they are held.
    pub nodes: Vec<[u32; CARRIERS]>,
    /// Their weights; each vertex's sum to 1.
    pub weights: Vec<[f64; CARRIERS]>,
}

impl Embedding {
    /// What the vertices have where the free nodes have `a` and `b`.
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

    /// Adds the forces of vertices to the free nodes that carry them; the work stays the same.
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
