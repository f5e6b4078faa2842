//! Substep: collect the patch, solve for the change of twist, move the capsule and the wall.

use super::barrier::keep_out;
use super::body::{Body, Motion};
use super::contact::{Facet, Indenter};
use super::contact_patch::{FacetLoad, Patch, Samples};
use super::friction::{Resistance, solve};
use super::laws::Laws;
use super::solve::{Symmetric6, System, Twist};
use crate::simd::f64x8::{LANES, Lane, sum};
use crate::tissue::spring_wall::ContactForce;
use glam::DVec3;

/// Number of sections of the capsule's length, each with eight sectors, that group contact forces.
const PUSH_PARTS: usize = 5;
const EIGHTHS: usize = 8;

/// External load on the capsule.
#[derive(Clone, Copy)]
pub struct Load {
    /// Force at the center of mass and torque, in the wall's frame.
    pub wrench: Twist,
    /// Gravity [m/s²].
    pub gravity: DVec3,
    /// Coefficient of drag on the center of mass [N·s/m]; only in quasi-static motion.
    pub damping: f64,
}

/// Action of the wall on the capsule in one substep.
#[derive(Clone, Copy, Default)]
pub struct Reaction {
    /// Normal and tangential forces of the wall, and their torque about the center of mass.
    pub wrench: Twist,
    /// Sum of the magnitudes of normal forces [N].
    pub normal_force_total: f64,
    /// Energy lost to friction and drag [J].
    pub friction_work: f64,
}

/// Fills `patch` with the contact of the capsule and the wall.
pub fn press(body: &Body, laws: &Laws, facets: &[Facet], motion: &Motion, patch: &mut Patch) {
    Indenter::new(&laws.foundation, body, motion).press(facets, patch);
}

/// Advances the capsule by `dt` under the forces of `patch`, and keeps `barred` triangles off its
/// axis; returns the action of the wall.
pub fn substep(
    body: &Body,
    laws: &Laws,
    load: &Load,
    motion: &mut Motion,
    patch: &mut Patch,
    barred: &[Facet],
    dt: f64,
) -> Reaction {
    let mut system = elastic_system(body, load, motion, patch, dt);
    let lumen_drag = slow_down(body, laws, motion, &mut system, dt);
    let resists = Resistance::of(laws, (body, motion), &patch.facet_loads, dt);
    let (change, resistance) = solve(resists.as_ref(), &system);
    let (moving, facet_loads) = ((body, &*motion), &mut patch.facet_loads);
    let change = keep_out(moving, barred, &system.matrix, change, facet_loads, dt);
    let before = *motion;
    body.drift(motion, change, dt);
    let mut told = reaction(body, load, &before, change, &resistance, patch, dt);
    if let Some(drag) = lumen_drag {
        told.wrench += drag.mean_force(&before, change);
    }
    told
}

/// Drag of the lumen contents, `M ξ/τ`.
struct LumenDrag(Symmetric6);

impl LumenDrag {
    /// Force and torque over a substep with a change of twist, at the velocity in its middle.
    fn mean_force(&self, before: &Motion, change: Twist) -> Twist {
        let linear = before.velocity + 0.5 * change.linear;
        let angular = before.angular_velocity + 0.5 * change.angular;
        Twist::from_array(self.0.times(&Twist { linear, angular }.to_array()))
    }
}

/// Adds the drag of the lumen contents to a system, by the implicit midpoint rule:
/// `(M + dt/2 M/τ) δ = dt (F − M ξ/τ)`.
fn slow_down(
    body: &Body,
    laws: &Laws,
    m: &Motion,
    system: &mut System,
    dt: f64,
) -> Option<LumenDrag> {
    if laws.relaxation_rate == 0.0 {
        return None;
    }
    let drag = LumenDrag(body.mass_matrix(m.rotation).scaled(laws.relaxation_rate));
    let now = drag.mean_force(m, Twist::default()).to_array();
    system.matrix.add(&drag.0.scaled(0.5 * dt));
    system.impulse.iter_mut().zip(now).for_each(|(impulse, force)| *impulse -= dt * force);
    Some(drag)
}

/// Elastic and viscoelastic loads by the implicit midpoint rule, linearized about the start.
///
/// With `P` the load of a piece, `j` its lever, `k` and `c` its slopes and `s` its speed:
/// `(M + Σ (dt²/4 k + dt/2 c) j jᵀ) δ = dt (F − Σ j (P + dt/2 k s))`.
fn elastic_system(body: &Body, load: &Load, m: &Motion, patch: &Patch, dt: f64) -> System {
    let mut matrix = body.mass_matrix(m.rotation);
    let weight = body.mass * load.gravity;
    let outside = Twist { linear: load.wrench.linear + weight, angular: load.wrench.angular };
    let mut impulse = outside.to_array().map(|f| f * dt);
    let mut sums = Sums::default();
    add_samples(&mut sums, &patch.samples, dt);
    for row in 0..6 {
        for column in 0..=row {
            matrix.0[row][column] += sum(&sums.slope[row][column]);
        }
        impulse[row] -= sum(&sums.force[row]);
    }
    System { matrix, impulse }
}

/// Sums of forces and their slopes over samples, lane by lane.
#[derive(Default)]
pub struct Sums {
    pub force: [Lane; 6],
    pub slope: [[Lane; 6]; 6],
}

impl Sums {
    /// Adds forces and slopes of samples by their levers.
    #[inline(always)]
    pub fn add(&mut self, lever: &[Lane; 6], force: &Lane, slope: &Lane) {
        for row in 0..6 {
            for column in 0..=row {
                for i in 0..LANES {
                    self.slope[row][column][i] += slope[i] * lever[row][i] * lever[column][i];
                }
            }
            for i in 0..LANES {
                self.force[row][i] += force[i] * lever[row][i];
            }
        }
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn add_samples(sums: &mut Sums, samples: &[Samples], dt: f64) {
    for s in samples {
        let (mut weight, mut push) = ([0.0; LANES], [0.0; LANES]);
        for i in 0..LANES {
            let pushed = s.load[i] + 0.5 * dt * s.stiffness[i] * s.speed[i];
            // Otherwise contact ends within this substep.
            let holds = pushed > 0.0;
            let slope = dt * (0.25 * dt * s.stiffness[i] + 0.5 * s.damping[i]);
            weight[i] = if holds { slope } else { 0.0 };
            push[i] = if holds { dt * pushed } else { 0.0 };
        }
        sums.add(&s.lever, &push, &weight);
    }
}

/// Wrench of the wall from the change of momentum, and work of friction over the displacement.
fn reaction(
    body: &Body,
    load: &Load,
    before: &Motion,
    change: Twist,
    resistance: &Twist,
    patch: &Patch,
    dt: f64,
) -> Reaction {
    let linear = body.mass * (change.linear / dt - load.gravity) - load.wrench.linear;
    let angular = body.inertia(before.rotation) * change.angular / dt - load.wrench.angular;
    let velocity = before.velocity + 0.5 * change.linear;
    let spin = before.angular_velocity + 0.5 * change.angular;
    Reaction {
        wrench: Twist { linear, angular },
        normal_force_total: patch.facet_loads.iter().map(|g| g.load).sum(),
        friction_work: -dt * (resistance.linear.dot(velocity) + resistance.angular.dot(spin)),
    }
}

/// Collects the loads on the wall into a few contact forces, by section of the capsule's surface.
pub fn contact_forces(
    body: &Body,
    m: &Motion,
    facet_loads: &[FacetLoad],
    out: &mut Vec<ContactForce>,
) {
    let mut sums = [(0.0, DVec3::ZERO, DVec3::ZERO); PUSH_PARTS * EIGHTHS];
    let to_capsule = m.rotation.inverse();
    let half = body.half_axis + body.radius;
    for on_facet in facet_loads {
        let place = to_capsule * (on_facet.center - m.position) - body.center;
        let along =
            ((place.z / half * 0.5 + 0.5) * PUSH_PARTS as f64).clamp(0.0, PUSH_PARTS as f64 - 0.5);
        let part = along as usize * EIGHTHS + eighth(place.x, place.y);
        let sum = &mut sums[part];
        sum.0 += on_facet.load;
        sum.1 += on_facet.load * on_facet.center;
        sum.2 += on_facet.load * on_facet.normal;
    }
    out.clear();
    let loaded = sums.iter().filter(|sum| sum.0 > 0.0);
    out.extend(
        loaded.map(|(load, moment, force)| ContactForce { center: *moment / *load, force: *force }),
    );
}

/// Octant of a direction in the plane; by comparisons, the same on every processor.
fn eighth(x: f64, y: f64) -> usize {
    usize::from(x < 0.0) + 2 * usize::from(y < 0.0) + 4 * usize::from(y.abs() > x.abs())
}
