//! Step of a world: substeps of capsule, wall and layer; the state is restored if it fails.

use super::body::{Body, Motion};
use super::fem_coupling::FemCoupling;
use super::laws::Laws;
use super::magnetic_coupling::MagneticCoupling;
use super::soft_wall::{MARGIN, Outcome, SoftWall};
use super::substep::{Load, Reaction, contact_forces, press, substep};
use super::wall_load::Stride;
use crate::simd::f32x64::Vec3;
use crate::tissue::fem::layer::FemLayer;
use crate::tissue::spring_wall::SpringWall;
use crate::wall::Wall;
use crate::wall::query;
use glam::DVec3;
use pyo3::{exceptions::PyValueError, prelude::*};

/// Maximum displacement of any point of the capsule in one substep [m].
const LONGEST_WAY: f64 = 1e-4;
/// Maximum distance of a capsule from the wall's center, as a factor of the wall's extent.
const FAR: f64 = 1000.0;
/// Error of a diverged motion.
const TOO_LARGE: &str = "The step is too large: the capsule's motion runs away.";
/// Maximum number of parts of a substep.
const MOST_PARTS: f64 = 512.0;
/// Layer of finite elements under the wall, and the coupling with it.
pub type Elastic<'a> = Option<(&'a mut FemLayer, &'a mut FemCoupling)>;

/// Sums over the substeps of a step.
#[derive(Clone, Copy, Default)]
pub struct StepTotals {
    /// Impulse of the wall on the capsule, or its mean force.
    pub force: DVec3,
    /// Impulse or mean of the torque about the center of mass.
    pub torque: DVec3,
    /// Impulse or mean of the sum of the magnitudes of normal forces.
    pub normal_force_total: f64,
    /// Energy lost to friction [J].
    pub friction_work: f64,
    /// Stored energy [J], contact area [m²] and maximum depth [m] at the end.
    pub patch: [f64; 3],
}

/// Upper bound of the speed of all points of the capsule between two motions [m/s].
pub fn fastest_point(body: &Body, before: &Motion, after: &Motion) -> f64 {
    let arm = body.center.length() + body.half_axis + body.radius;
    let speed = |m: &Motion| m.velocity.length() + m.angular_velocity.length() * arm;
    speed(before).max(speed(after))
}

/// Searches the wall near the capsule if either may have moved too far since the last search.
fn look_around(
    soft: &mut SoftWall,
    wall: &mut Wall,
    elastic: &mut Elastic,
    (body, motion): (&Body, &Motion),
) -> Outcome {
    if soft.travel <= MARGIN {
        return Ok(());
    }
    if let Some((layer, coupling)) = elastic {
        coupling.carry(layer, soft);
    }
    soft.search(wall, body, motion)?;
    if let Some((layer, coupling)) = elastic {
        coupling.find(layer, soft)?;
    }
    Ok(())
}

impl StepTotals {
    fn add(&mut self, reaction: &Reaction, dt: f64) {
        self.force += dt * reaction.wrench.linear;
        self.torque += dt * reaction.wrench.angular;
        self.normal_force_total += dt * reaction.normal_force_total;
        self.friction_work += reaction.friction_work;
    }

    /// Mean forces over a time `duration` from impulses.
    pub fn mean(self, duration: f64) -> Self {
        StepTotals {
            force: self.force / duration,
            torque: self.torque / duration,
            normal_force_total: self.normal_force_total / duration,
            ..self
        }
    }
}

/// Equations of the capsule's motion.
#[derive(Clone, Copy, PartialEq)]
pub enum Dynamics {
    /// Newton-Euler equations, in substeps.
    Physics,
    /// Balance without inertia, see `quasi_static`.
    QuasiStatic,
}

/// Capsule, wall and the forces on them: all state that a step changes, except the layer.
pub struct Stepper {
    /// Equations of motion.
    pub dynamics: Dynamics,
    /// Mass and shape of the capsule.
    pub body: Body,
    /// Pressure and drag of the wall.
    pub laws: Laws,
    /// Springs at vertices near a contact; `None` for a rigid wall or one with an elastic layer.
    pub spring_wall: Option<SpringWall>,
    /// Coupling with a layer of finite elements under the wall.
    pub coupling: Option<FemCoupling>,
    /// External sources, and the magnets in the capsule.
    pub magnets: Option<MagneticCoupling>,
    /// Motion of the capsule.
    pub motion: Motion,
    /// State of the wall.
    pub soft: SoftWall,
    /// Means over the last step.
    pub last: StepTotals,
}

impl Stepper {
    /// Advances by `strides.0` steps of `dt`, in `strides.1` steps of the layer; an error changes
    /// nothing except search results.
    pub fn run(
        &mut self,
        wall: &mut Wall,
        mut layer: Option<&mut FemLayer>,
        load: &Load,
        dt: f64,
        strides: (usize, usize),
    ) -> Outcome {
        let backup = (self.motion, self.soft.awake_displacements(), self.last);
        let elastic = layer.as_deref().zip(self.coupling.as_ref()).map(|(l, x)| x.backup(l));
        let result = match self.dynamics {
            Dynamics::Physics => self.substeps(wall, layer.as_deref_mut(), load, dt, strides),
            Dynamics::QuasiStatic => self.relax(wall, load, dt * strides.0 as f64),
        };
        let result = result.and_then(|()| self.check(wall));
        if result.is_ok() {
            self.soft.land();
            self.last.patch = self.soft.patch.extent();
            return Ok(());
        }
        (self.motion, self.last) = (backup.0, backup.2);
        self.soft.restore_displacements(backup.1);
        if let (Some(layer), Some(coupling), Some(elastic)) =
            (layer, self.coupling.as_mut(), elastic)
        {
            coupling.restore(layer, elastic, &mut self.soft);
        }
        self.soft.stay();
        result
    }

    /// Checks that the motion after a step is finite and that the capsule has not passed through a
    /// layer of finite elements.
    fn check(&mut self, wall: &mut Wall) -> Outcome {
        if !self.motion.is_finite() {
            return Err(TOO_LARGE);
        }
        if self.coupling.is_some() {
            self.soft.settle(wall)?;
            if !self.is_inside(wall) {
                return Err("The capsule breaks through the elastic wall. Allowed: a smaller \
                            force_world, or a deformation that holds more: neo-hookean with a \
                            stiffening_strain, a larger youngs_modulus or support.");
            }
        }
        let is_near = self.motion.position.length() < FAR * f64::from(wall.extent);
        if is_near { Ok(()) } else { Err(TOO_LARGE) }
    }

    fn substeps(
        &mut self,
        wall: &mut Wall,
        layer: Option<&mut FemLayer>,
        load: &Load,
        dt: f64,
        strides: (usize, usize),
    ) -> Outcome {
        let mut coupling = self.coupling.take();
        let mut elastic = layer.zip(coupling.as_mut());
        let result = self.advance(wall, &mut elastic, load, dt, strides);
        self.coupling = coupling;
        result
    }

    fn advance(
        &mut self,
        wall: &mut Wall,
        elastic: &mut Elastic,
        load: &Load,
        dt: f64,
        (count, outer): (usize, usize),
    ) -> Outcome {
        let mut totals = StepTotals::default();
        for number in 0..count {
            if let Some((layer, coupling)) = elastic {
                coupling.keep_up(layer, &mut self.soft, dt, (number, count / outer))?;
            }
            // Fast capsules take shorter substeps, so that none penetrates the wall far.
            let way = dt * fastest_point(&self.body, &self.motion, &self.motion);
            let swing = self.magnets.as_ref().map_or(1.0, |magnets| magnets.parts(&self.body, dt));
            let parts = (way / LONGEST_WAY).ceil().max(swing).clamp(1.0, MOST_PARTS);
            for _ in 0..parts as usize {
                self.substep(wall, elastic, load, dt / parts, &mut totals)?;
            }
        }
        if let Some((layer, coupling)) = elastic {
            coupling.end(layer)?;
            coupling.settle(layer, &mut self.soft);
        }
        self.last = totals.mean(count as f64 * dt);
        Ok(())
    }

    /// Advances capsule and wall by one substep.
    fn substep(
        &mut self,
        wall: &mut Wall,
        elastic: &mut Elastic,
        load: &Load,
        dt: f64,
        totals: &mut StepTotals,
    ) -> Outcome {
        self.touch(wall, elastic)?;
        let (body, motion, soft) = (&self.body, &mut self.motion, &mut self.soft);
        if let Some((_, coupling)) = elastic {
            coupling.soften(soft, dt);
        }
        let mut load = *load;
        if let Some(magnets) = &mut self.magnets {
            load.wrench += magnets.pull(body, motion, dt)?;
        }
        let before = *motion;
        // No barrier on a layer: breaking through it is an error, see `check`.
        let barred = if elastic.is_some() { &[] } else { &soft.facets[..] };
        let reaction = substep(body, &self.laws, &load, motion, &mut soft.patch, barred, dt);
        totals.add(&reaction, dt);
        if let Some((_, coupling)) = elastic {
            let (after, friction, reaction) = (&*motion, self.laws.drag.friction(), &reaction);
            coupling.push(soft, &Stride { body, before: &before, after, reaction, friction, dt });
        }
        soft.pass(dt, dt * fastest_point(body, &before, motion));
        if let Some(spring_wall) = &self.spring_wall {
            contact_forces(body, motion, &soft.patch.facet_loads, &mut soft.contact_forces);
            soft.give_way(wall, spring_wall, dt);
        }
        Ok(())
    }

    /// Computes the contact of the capsule and the wall at the current pose.
    pub fn touch(&mut self, wall: &mut Wall, elastic: &mut Elastic) -> Outcome {
        let (body, motion, soft) = (&self.body, &self.motion, &mut self.soft);
        look_around(soft, wall, elastic, (body, motion))?;
        soft.update_facets(&body.axis(motion), body.radius);
        press(body, &self.laws, &soft.facets, motion, &mut soft.patch);
        Ok(())
    }

    /// Sets the prescribed motion of the wall, from `lumen_scale` at the start and end of a step.
    pub fn aim(&mut self, lumen_scales: &[f64], duration: f64) -> PyResult<()> {
        let (from, to) = lumen_scales.split_at(lumen_scales.len() / 2);
        if self.soft.drive.is_none() || from.is_empty() || from.len() != to.len() {
            let what = "lumen_scale needs two rows of samples, and set_lumen_drive before.";
            return Err(PyValueError::new_err(what));
        }
        self.soft.aim(from, to, duration);
        Ok(())
    }

    /// True if the axis of the capsule is in the lumen, by the hierarchy as last refitted.
    pub fn is_inside(&self, wall: &Wall) -> bool {
        self.looks().iter().all(|&p| query::is_inside(&wall.bvh, p))
    }

    /// True if the axis is in the lumen now; refits the hierarchy if its error may exceed the
    /// axis's distance from it.
    pub fn is_inside_now(&mut self, wall: &mut Wall) -> Result<bool, &'static str> {
        let off = self.soft.wall_travel;
        let is_clear =
            |&p: &Vec3| off == 0.0 || f64::from(query::nearest(&wall.bvh, p).distance) > off;
        if !self.looks().iter().all(is_clear) {
            self.soft.settle(wall)?;
        }
        Ok(self.is_inside(wall))
    }

    /// Points of the axis that must be in the lumen.
    fn looks(&self) -> [Vec3; 3] {
        let axis = self.body.axis(&self.motion);
        [0.0, 0.5, 1.0].map(|share| (axis.start + share * axis.span).to_array().map(|x| x as f32))
    }
}
