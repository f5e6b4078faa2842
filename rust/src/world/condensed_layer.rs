//! Condensation of a layer of finite elements onto the nodes near the capsule.
//!
//! Within a step of the layer the velocities of its nodes are linear in the forces on them, with a
//! constant mobility. It is condensed onto the few nodes near the capsule, so that the response of
//! the wall is available in every substep of the capsule.

use super::broad_phase::NearbyWall;
use crate::tissue::fem::Outcome;
use crate::tissue::fem::embedding::{CARRIERS, Embedding};
use crate::tissue::fem::layer::FemLayer;
use glam::{DMat3, DVec3};
use std::collections::{BTreeMap, BTreeSet, btree_map::Entry};

/// Inner nodes of a vertex; as many outer nodes lie above them.
const PAIRS: usize = CARRIERS / 2;

/// Nodes near the capsule: inner ones, ascending, then the outer ones above them, in the same
/// order. Vectors over them end with one more entry, always zero, for fixed nodes.
#[derive(Default)]
pub struct CondensedLayer {
    /// Indices in the layer.
    pub nodes: Vec<u32>,
    /// For each near vertex: the indices of its nodes in `nodes`, and their weights.
    carriers: Vec<([u32; CARRIERS], [f64; CARRIERS])>,
    /// Mobility [m/s per N]: for each node and axis, the responses of all nodes along x, y and z.
    answers: Vec<f64>,
    /// Norms of the mobility between middles and spans of pairs of nodes, by columns [m/s per N].
    sizes: Vec<f64>,
    /// Full columns of the mobility, by node.
    columns: BTreeMap<u32, Vec<DMat3>>,
    /// Result of the last `answer`, along x, y and z.
    sums: Vec<f64>,
}

/// Adds the response to one force.
#[multiversion::multiversion(targets("x86_64+avx2", "aarch64+neon"))]
fn add_answer(answers: &[f64], force: DVec3, sums: &mut [f64]) {
    let (x, rest) = answers.split_at(sums.len());
    let (y, z) = rest.split_at(sums.len());
    for (((sum, x), y), z) in sums.iter_mut().zip(x).zip(y).zip(z) {
        *sum += force.x * x + force.y * y + force.z * z;
    }
}

/// Adds `scale` times a column.
#[multiversion::multiversion(targets("x86_64+avx2", "aarch64+neon"))]
fn add_column(column: &[f64], scale: f64, sums: &mut [f64]) {
    sums.iter_mut().zip(column).for_each(|(sum, x)| *sum += scale * x);
}

/// Frobenius norm, an upper bound of the spectral norm.
fn size(m: DMat3) -> f64 {
    let square = |v: DVec3| v.length_squared();
    (square(m.x_axis) + square(m.y_axis) + square(m.z_axis)).sqrt()
}

/// Weights of the middles and spans of pairs of nodes, from the weights of the nodes.
fn middles_and_spans(weights: &[f64; CARRIERS]) -> [(f64, f64); PAIRS] {
    std::array::from_fn(|k| {
        let (inner, outer) = (weights[k], weights[k + PAIRS]);
        (inner + outer, 0.5 * (outer - inner))
    })
}

/// Offset from the index of a free inner node to that of the outer one above it: the levels of
/// nodes are numbered alike, so it is the same for all.
pub fn rise(layer: &FemLayer) -> u32 {
    let free = layer.displacement.len() as u32;
    let inner = |nodes: &[u32; CARRIERS]| (0..PAIRS).find(|&k| nodes[k] < free);
    let found = layer.embedding.nodes.iter().find_map(|n| inner(n).map(|k| n[k + PAIRS] - n[k]));
    found.unwrap_or(free)
}

/// Maximum sum of absolute weights of any vertex, of middles and of spans.
pub fn largest_weights(embedding: &Embedding) -> (f64, f64) {
    embedding.weights.iter().fold((0.0f64, 0.0f64), |most, weights| {
        let pairs = middles_and_spans(weights);
        let sums = pairs.iter().fold((0.0, 0.0), |s, p| (s.0 + p.0.abs(), s.1 + p.1.abs()));
        (most.0.max(sums.0), most.1.max(sums.1))
    })
}

impl CondensedLayer {
    /// Selects the nodes of the near vertices and those in `others`.
    pub fn find(
        &mut self,
        layer: &mut FemLayer,
        near: &NearbyWall,
        rise: u32,
        others: impl Iterator<Item = u32>,
        dt: f64,
    ) -> Outcome<()> {
        let free = layer.displacement.len() as u32;
        let carriers = || near.vertices.iter().map(|&v| &layer.embedding.nodes[v as usize]);
        let all = carriers().flatten().copied().filter(|&n| n < free).chain(others);
        let inner: BTreeSet<u32> = all.map(|n| if n < rise { n } else { n - rise }).collect();
        let nodes: Vec<u32> = inner.iter().copied().chain(inner.iter().map(|n| n + rise)).collect();
        let place: BTreeMap<u32, u32> = nodes.iter().copied().zip(0..).collect();
        let held = nodes.len() as u32;
        self.carriers = near
            .vertices
            .iter()
            .map(|&v| {
                let (nodes, weights) =
                    (layer.embedding.nodes[v as usize], layer.embedding.weights[v as usize]);
                (nodes.map(|n| place.get(&n).copied().unwrap_or(held)), weights)
            })
            .collect();
        if nodes != self.nodes {
            self.nodes = nodes;
            self.condense(layer, dt)?;
        }
        Ok(())
    }

    /// Condenses the mobility onto the nodes.
    fn condense(&mut self, layer: &mut FemLayer, dt: f64) -> Outcome<()> {
        for &node in &self.nodes {
            if let Entry::Vacant(column) = self.columns.entry(node) {
                column.insert(layer.mobility(node, dt)?);
            }
        }
        if self.columns.len() > 2 * self.nodes.len() {
            self.columns.retain(|node, _| self.nodes.contains(node));
        }
        let count = self.nodes.len();
        self.answers.clear();
        for node in &self.nodes {
            let column = &self.columns[node];
            for axis in 0..3 {
                for row in 0..3 {
                    let to = self.nodes.iter().map(|&n| column[n as usize].col(axis)[row]);
                    self.answers.extend(to);
                }
            }
        }
        self.sums = vec![0.0; 3 * count];
        self.sizes = vec![0.0; count * count];
        let half = count / 2;
        for (j, from) in self.nodes[..half].iter().enumerate() {
            let (below, above) = (&self.columns[from], &self.columns[&self.nodes[j + half]]);
            for i in 0..half {
                let (low, high) = (self.nodes[i] as usize, self.nodes[i + half] as usize);
                let [[a, b], [c, d]] = [[below[low], above[low]], [below[high], above[high]]];
                let (column, last) = (j * count, (j + half) * count);
                self.sizes[column + i] = 0.25 * size(a + b + c + d);
                self.sizes[column + i + half] = 0.5 * size(c + d - a - b);
                self.sizes[last + i] = 0.5 * size(b + d - a - c);
                self.sizes[last + i + half] = size(a + d - b - c);
            }
        }
        Ok(())
    }

    /// Value interpolated at near vertex `v` from `values` at the nodes.
    #[inline(always)]
    pub fn carry(&self, v: usize, values: &[DVec3]) -> DVec3 {
        let (nodes, weights) = &self.carriers[v];
        nodes.iter().zip(weights).map(|(&n, &weight)| weight * values[n as usize]).sum()
    }

    /// Distributes a force on near vertex `v` to its nodes, with the same work.
    #[inline(always)]
    pub fn gather(&self, v: usize, force: DVec3, out: &mut [DVec3]) {
        let (nodes, weights) = &self.carriers[v];
        for (&n, &weight) in nodes.iter().zip(weights) {
            out[n as usize] += weight * force;
        }
    }

    /// Adds to the velocities of the nodes their response to forces, or to displacements the
    /// response to momenta; the entry of fixed nodes stays zero.
    pub fn answer(&mut self, forces: &[DVec3], out: &mut [DVec3]) {
        let count = self.nodes.len();
        if count == 0 {
            return;
        }
        self.sums.fill(0.0);
        for (answers, force) in self.answers.chunks_exact(9 * count).zip(forces) {
            if *force != DVec3::ZERO {
                add_answer(answers, *force, &mut self.sums);
            }
        }
        for (k, out) in out[..count].iter_mut().enumerate() {
            *out += DVec3::new(self.sums[k], self.sums[count + k], self.sums[2 * count + k]);
        }
    }

    /// True if the response of all nodes to momenta is cheaper to sum from the stored columns than
    /// to solve for, which reads the factor twice.
    pub fn knows(&self, momenta: &[DVec3], layer: &FemLayer) -> bool {
        let given = momenta.iter().filter(|p| **p != DVec3::ZERO).count();
        9 * given * momenta.len() < 2 * layer.fill()
    }

    /// Velocities of all nodes after a step of `dt` [s] with momentum [N·s] on near ones in
    /// addition to the loads of the prediction.
    pub fn correct(&self, mut predicted: Vec<DVec3>, momenta: &[DVec3], dt: f64) -> Vec<DVec3> {
        for node in &self.nodes {
            let force = momenta[*node as usize] / dt;
            if force != DVec3::ZERO {
                let answers = self.columns[node].iter().zip(&mut predicted);
                answers.for_each(|(answer, velocity)| *velocity += *answer * force);
            }
        }
        predicted
    }

    /// Upper bound of the speed of near vertices in response to forces of given magnitudes and any
    /// directions [m/s]: `Σ |mobility| · size`.
    pub fn bound(&mut self, sizes: &[f64]) -> Vec<f64> {
        let (count, half) = (self.nodes.len(), self.nodes.len() / 2);
        let held = count as u32;
        if count == 0 {
            return vec![0.0; sizes.len()];
        }
        let mut amounts = vec![0.0; count];
        for ((nodes, weights), size) in self.carriers.iter().zip(sizes).filter(|row| *row.1 > 0.0) {
            for (k, (middle, span)) in middles_and_spans(weights).into_iter().enumerate() {
                if nodes[k] != held {
                    amounts[nodes[k] as usize] += size * middle.abs();
                    amounts[nodes[k] as usize + half] += size * span.abs();
                }
            }
        }
        let reach = &mut self.sums[..count];
        reach.fill(0.0);
        for (column, amount) in self.sizes.chunks_exact(count).zip(amounts) {
            if amount > 0.0 {
                add_column(column, amount, reach);
            }
        }
        let of = |(nodes, weights): &([u32; CARRIERS], [f64; CARRIERS])| {
            let pairs = nodes[..PAIRS].iter().zip(middles_and_spans(weights));
            let free = pairs.filter(|(n, _)| **n != held);
            free.map(|(&n, (middle, span))| {
                middle.abs() * reach[n as usize] + span.abs() * reach[n as usize + half]
            })
            .sum()
        };
        let rows = self.carriers.iter().zip(sizes);
        rows.map(|(row, size)| if *size > 0.0 { of(row) } else { 0.0 }).collect()
    }
}
