//! Two-way coupling of a capsule and a wall of finite elements.
//!
//! The layer makes outer steps of implicit Euler, the capsule many substeps within each. Over an
//! outer step of length H the layer's velocities are `w = w₀ + B (f̄ − f₀)`, with f̄ the mean of
//! the forces on it, w₀ the velocities under the last forces f₀, and B its mobility. In each
//! substep the wall thus moves at `w₀ + B (f − f₀)`, with f the force of that substep: the mean
//! over the substeps is the layer's own step under f̄, and the wall that the capsule felt is the
//! layer. The work of the capsule, `Σ h f·w`, is never less than that on the layer, `H f̄·w̄`, as B
//! is positive definite: the coupling creates no energy.
//!
//! A substep's force depends on the wall's velocity that follows from it. Each triangle is solved
//! as if its own response were `b` times its own change of force, with b so large (row sums of |B|,
//! weighted by the triangles' stiffness) that by the theorem of Collatz and Wielandt these
//! iterations, one per substep, converge for any stiffness.

use super::condensed_layer::{CondensedLayer, largest_weights, rise};
use super::contact_patch::Samples;
use super::coupling_state::CouplingState;
use super::soft_wall::SoftWall;
use super::wall_load::{Stride, forces, shares};
use crate::simd::f64x8::LANES;
use crate::tissue::fem::Outcome;
use crate::tissue::fem::layer::FemLayer;
use crate::tissue::spring_wall::VertexMotion;
use glam::DVec3;

/// Change of node speed below which momentum is deferred to the next step of the layer [m/s]: over
/// a step it is less than a nanometer, and avoids a solution while the capsule rests.
const SLIGHT: f64 = 1e-7;

/// State from which a coupling and its layer continue.
pub struct Backup {
    state: CouplingState,
    displacement: Vec<DVec3>,
    velocity: Vec<DVec3>,
}

/// Coupling of one world; vectors over near nodes end with a zero for fixed ones.
pub struct FemCoupling {
    pub state: CouplingState,
    /// Tolerance of the solution of a nonlinear layer [m].
    tolerance: f64,
    /// Outer step, and time since its start [s].
    step: f64,
    since: f64,
    /// Displacements at its start [m].
    start: Vec<DVec3>,
    /// Velocities under the reference forces [m/s].
    drift: Vec<DVec3>,
    /// Velocities under the reference forces at the end of the outer step [m/s].
    predicted: Vec<DVec3>,
    /// Momentum in addition to that of the reference forces [N·s].
    gained: Vec<DVec3>,
    /// Reference forces: those of the last substep before this outer step [N].
    reference: Vec<DVec3>,
    near: CondensedLayer,
    displacement: Vec<DVec3>,
    velocity: Vec<DVec3>,
    /// Maximum sums of weights, of middles and of spans.
    weights: (f64, f64),
    /// Offset from the index of an inner node to that of the outer one above it.
    rise: u32,
    /// Upper bound of the vertices' speed under the reference forces [m/s].
    fastest: f64,
    /// True if vertices that are not near lag behind the layer.
    is_stale: bool,
}

impl From<(DVec3, DVec3)> for VertexMotion {
    fn from((displacement, velocity): (DVec3, DVec3)) -> Self {
        VertexMotion { displacement, velocity }
    }
}

impl FemCoupling {
    /// Coupling for a layer at rest.
    pub fn new(layer: &FemLayer, tolerance: f64) -> Self {
        let zero = vec![DVec3::ZERO; layer.displacement.len()];
        FemCoupling {
            state: CouplingState::at_rest(layer.displacement.len()),
            tolerance,
            step: 0.0,
            since: 0.0,
            start: zero.clone(),
            drift: zero.clone(),
            predicted: zero.clone(),
            gained: zero.clone(),
            reference: zero,
            near: CondensedLayer::default(),
            displacement: Vec::new(),
            velocity: Vec::new(),
            weights: largest_weights(&layer.embedding),
            rise: rise(layer),
            fastest: 0.0,
            is_stale: false,
        }
    }

    /// State for `restore`.
    pub fn backup(&self, layer: &FemLayer) -> Backup {
        let (displacement, velocity) = (layer.displacement.clone(), layer.velocity.clone());
        Backup { state: self.state.clone(), displacement, velocity }
    }

    /// Restores a state, including the wall's vertices.
    pub fn restore(&mut self, layer: &mut FemLayer, backup: Backup, soft: &mut SoftWall) {
        (layer.displacement, layer.velocity) = (backup.displacement, backup.velocity);
        self.state = backup.state;
        self.settle(layer, soft);
    }

    /// Prepares substep `number` of `dt` [s]: starts an outer step if it is a multiple of `each`.
    ///
    /// Every step of the world starts with a search. Times of other searches do not affect results.
    pub fn keep_up(
        &mut self,
        layer: &mut FemLayer,
        soft: &mut SoftWall,
        dt: f64,
        (number, each): (usize, usize),
    ) -> Outcome<()> {
        if number == 0 {
            soft.travel = f64::INFINITY;
        }
        if number > 0 && number.is_multiple_of(each) {
            self.end(layer)?;
        }
        if number.is_multiple_of(each) {
            self.begin(layer, soft, each as f64 * dt)?;
        }
        Ok(())
    }

    /// Starts an outer step of `dt` [s].
    fn begin(&mut self, layer: &mut FemLayer, soft: &mut SoftWall, dt: f64) -> Outcome<()> {
        if dt != self.step {
            self.near = CondensedLayer::default();
            soft.travel = f64::INFINITY;
        }
        (self.step, self.since) = (dt, 0.0);
        self.reference.clone_from(&self.state.force);
        let owed = self.reference.iter().zip(&self.state.owed);
        let load: Vec<DVec3> = owed.map(|(f, p)| *f + *p / dt).collect();
        self.predicted = layer.predict(&load, dt, self.tolerance)?;
        let offset = &self.state.offset;
        let moved = layer.displacement.iter().zip(offset);
        self.start = moved.map(|(u, o)| *u + *o).collect();
        self.drift = self.predicted.iter().zip(offset).map(|(w, o)| *w - *o / dt).collect();
        self.gained.fill(DVec3::ZERO);
        self.fastest = self.bound_of_drift();
        if soft.travel.is_finite() {
            self.place(soft);
        }
        Ok(())
    }

    /// Ends the outer step: advances the layer under the mean forces.
    pub fn end(&mut self, layer: &mut FemLayer) -> Outcome<()> {
        let (step, gained) = (self.step, self.gained.clone());
        let mean: Vec<DVec3> =
            self.reference.iter().zip(&gained).map(|(f, p)| *f + *p / step).collect();
        let predicted = std::mem::take(&mut self.predicted);
        if layer.is_linear() && self.fastest_change() < SLIGHT {
            self.state.owed = gained;
            layer.advance(predicted, step);
            return Ok(());
        }
        self.state.owed.fill(DVec3::ZERO);
        let before = (!layer.is_linear()).then(|| predicted.clone());
        let velocity = if layer.is_linear() && self.near.knows(&gained, layer) {
            self.near.correct(predicted, &gained, step)
        } else {
            layer.correct(predicted, &mean, gained, step, self.tolerance)?
        };
        if let Some(before) = before {
            let (mut answer, gained) = (self.local(&before), self.local(&self.gained));
            let momenta: Vec<DVec3> = gained.iter().map(|p| *p / step).collect();
            self.near.answer(&momenta, &mut answer);
            self.state.offset.fill(DVec3::ZERO);
            for (&n, felt) in self.near.nodes.iter().zip(answer) {
                self.state.offset[n as usize] = step * (felt - velocity[n as usize]);
            }
        }
        layer.advance(velocity, step);
        Ok(())
    }

    /// Maximum change of speed of near nodes by the momentum gained [m/s].
    fn fastest_change(&mut self) -> f64 {
        let momenta: Vec<DVec3> = self.local(&self.gained).iter().map(|p| *p / self.step).collect();
        let mut answer = vec![DVec3::ZERO; momenta.len()];
        self.near.answer(&momenta, &mut answer);
        answer.iter().map(|v| v.length()).fold(0.0, f64::max)
    }

    /// Selects the nodes of the near vertices.
    pub fn find(&mut self, layer: &mut FemLayer, soft: &mut SoftWall) -> Outcome<()> {
        let loads = self.state.force.iter().zip(&self.reference).zip(&self.gained).enumerate();
        let loaded = |load: &((&DVec3, &DVec3), &DVec3)| {
            [load.0.0, load.0.1, load.1].iter().any(|v| **v != DVec3::ZERO)
        };
        let others = loads.filter(|(_, load)| loaded(load)).map(|(n, _)| n as u32);
        self.near.find(layer, &soft.near, self.rise, others, self.step)?;
        self.place(soft);
        Ok(())
    }

    /// Moves all vertices to the current layer, without the latest forces for those that are not
    /// near; called before every search.
    pub fn carry(&mut self, layer: &FemLayer, soft: &mut SoftWall) {
        if self.is_stale {
            let now = self.start.iter().zip(&self.drift).map(|(u, v)| *u + self.since * *v);
            layer.embedding.carry(
                &now.collect::<Vec<_>>(),
                &self.drift,
                &mut soft.wall_displacement,
            );
            self.write(soft);
            self.is_stale = false;
        }
    }

    /// Moves all vertices to the layer between outer steps.
    pub fn settle(&mut self, layer: &FemLayer, soft: &mut SoftWall) {
        self.is_stale = false;
        let now: Vec<DVec3> =
            layer.displacement.iter().zip(&self.state.offset).map(|(u, o)| *u + *o).collect();
        layer.embedding.carry(&now, &layer.velocity, &mut soft.wall_displacement);
    }

    /// Softens the patch by the wall's response: the force of each triangle becomes that of its
    /// foundation in series with the layer. With A the derivative of a triangle's force by the
    /// wall's velocity and θ = 1/(1 + A b), the solution of `F = F(w) − A b (F − F₀)`, w and F₀ of
    /// the last substep, is `θ F(w) + (1 − θ) F₀`.
    pub fn soften(&mut self, soft: &mut SoftWall, dt: f64) {
        let slope = |s: &Samples, i: usize| 0.5 * dt * s.stiffness[i] + s.damping[i];
        let mut slopes = vec![0.0; soft.near.corners.len()];
        for (places, s) in soft.patch.lanes() {
            (0..LANES).for_each(|i| slopes[places[i] as usize] += slope(s, i));
        }
        let mut by_vertex = vec![0.0; soft.near.vertices.len()];
        for on_facet in &soft.patch.facet_loads {
            for (v, share) in shares(soft, on_facet) {
                by_vertex[v] += share * slopes[on_facet.place as usize];
            }
        }
        let bounds = self.near.bound(&by_vertex);
        let mut blends = vec![(1.0, 0.0); soft.near.corners.len()];
        let mut touched = self.state.touched.iter().peekable();
        let mut facet_loads = std::mem::take(&mut soft.patch.facet_loads);
        for on_facet in &mut facet_loads {
            let (place, face) = (on_facet.place as usize, soft.near.faces[on_facet.place as usize]);
            while touched.next_if(|t| t.face < face).is_some() {}
            let last = touched.next_if(|t| t.face == face).copied().unwrap_or_default();
            let bound: f64 = shares(soft, on_facet).map(|(v, share)| share * bounds[v]).sum();
            let theta = 1.0 / (1.0 + bound);
            blends[place] = (theta, (1.0 - theta) * last.normal / slopes[place]);
            on_facet.load = theta * on_facet.load + (1.0 - theta) * last.normal;
            on_facet.mobility = bound / slopes[place];
            on_facet.velocity -= on_facet.mobility * last.tangent;
        }
        soft.patch.facet_loads = facet_loads;
        for (places, s) in soft.patch.lanes() {
            for i in 0..LANES {
                let (theta, kept) = blends[places[i] as usize];
                s.load[i] = theta * s.load[i] + kept * slope(s, i);
                s.stiffness[i] *= theta;
                s.damping[i] *= theta;
            }
        }
    }

    /// Applies the contact forces to the layer, and moves the near vertices.
    pub fn push(&mut self, soft: &mut SoftWall, stride: &Stride) {
        let forces = forces(soft, stride, &mut self.state.touched);
        let count = self.near.nodes.len();
        let mut nodal = vec![DVec3::ZERO; count + 1];
        for (v, force) in forces.iter().enumerate() {
            if *force != DVec3::ZERO {
                self.near.gather(v, *force, &mut nodal);
            }
        }
        for (&n, force) in self.near.nodes.iter().zip(&nodal) {
            let n = n as usize;
            self.state.force[n] = *force;
            self.gained[n] += stride.dt * (*force - self.reference[n]);
        }
        self.since += stride.dt;
        self.is_stale = true;
        let fastest = self.place(soft).max(self.fastest);
        soft.travel += stride.dt * fastest;
        soft.wall_travel += stride.dt * fastest;
    }

    /// Updates displacement and velocity of near nodes from the whole layer; returns the maximum
    /// speed of near vertices [m/s].
    fn place(&mut self, soft: &mut SoftWall) -> f64 {
        self.displacement = self.local(&self.start);
        let drift = self.local(&self.drift);
        for (u, v) in self.displacement.iter_mut().zip(drift) {
            *u += self.since * v;
        }
        let gained = self.local(&self.gained);
        self.near.answer(&gained, &mut self.displacement);
        self.accelerate();
        self.write(soft)
    }

    /// Computes velocities of near nodes under the current forces.
    fn accelerate(&mut self) {
        self.velocity = self.local(&self.drift);
        let mut beyond = self.local(&self.state.force);
        let reference = self.local(&self.reference);
        beyond.iter_mut().zip(reference).for_each(|(f, last)| *f -= last);
        self.near.answer(&beyond, &mut self.velocity);
    }

    /// Writes near vertices into the wall; returns their maximum speed [m/s].
    fn write(&self, soft: &mut SoftWall) -> f64 {
        let mut fastest = 0.0f64;
        for (k, &v) in soft.near.vertices.iter().enumerate() {
            let velocity = self.near.carry(k, &self.velocity);
            fastest = fastest.max(velocity.length_squared());
            let displacement = self.near.carry(k, &self.displacement);
            soft.wall_displacement[v as usize] = VertexMotion { displacement, velocity };
        }
        fastest.sqrt()
    }

    /// Near entries of a vector over nodes, and a zero for fixed ones.
    fn local(&self, values: &[DVec3]) -> Vec<DVec3> {
        let near = self.near.nodes.iter().map(|&n| values[n as usize]);
        near.chain([DVec3::ZERO]).collect()
    }

    fn bound_of_drift(&self) -> f64 {
        let longest = |most: f64, v: DVec3| most.max(v.length_squared());
        let (middle, span) = self.drift.iter().zip(&self.drift[self.rise as usize..]).fold(
            (0.0, 0.0),
            |most, (below, above)| {
                (longest(most.0, 0.5 * (*below + *above)), longest(most.1, *above - *below))
            },
        );
        self.weights.0 * f64::sqrt(middle) + self.weights.1 * f64::sqrt(span)
    }
}
