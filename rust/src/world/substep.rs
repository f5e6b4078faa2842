//! One substep: gather the patch, solve for the change of twist, move the capsule and the wall.

use super::barrier::keep_out;
use super::body::{Body, Motion};
use super::contact::{Facet, Indenter};
use super::contact_patch::{FacetLoad, Patch, Samples};
use super::solve::{Symmetric6, Twist};
use crate::simd::f64x8::{LANES, Lane, sum};
use crate::tissue::drag::Drag;
use crate::tissue::spring_wall::ContactForce;
use crate::tissue::winkler_foundation::WinklerFoundation;
use glam::{DMat3, DVec3};

/// Sliding slower than this counts as creep under friction that does not suffice to slide [m/s].
pub const CREEP: f64 = 1e-5;
/// Solutions for friction that depends on the velocity it leads to.
const FRICTION_ROUNDS: usize = 4;
/// Parts of the capsule's length that push the wall as one, each by eighths of its girth.
const PUSH_PARTS: usize = 5;
const EIGHTHS: usize = 8;

/// What acts on the capsule besides the wall.
#[derive(Clone, Copy)]
pub struct Load {
    /// Force at the center of mass and torque, in the wall's frame.
    pub wrench: Twist,
    /// Gravity [m/s²].
    pub gravity: DVec3,
}

/// What the wall did to the capsule in one substep.
#[derive(Clone, Copy, Default)]
pub struct Reaction {
    /// Normal and tangential forces of the wall, and their torque about the center of mass.
    pub wrench: Twist,
    /// Sum of normal forces' sizes [N].
    pub normal_force_total: f64,
    /// Energy lost to friction and drag [J].
    pub friction_work: f64,
}

/// Laws that hold between capsule and wall.
#[derive(Clone, Copy)]
pub struct Laws {
    /// Stiffness of the wall.
    pub foundation: WinklerFoundation,
    /// Law of resistance.
    pub drag: Drag,
    /// Viscous coefficient γ of the mucus [N·s/m].
    pub viscosity: f64,
}

/// Linear system of one substep: `matrix · change = impulse`.
struct System {
    matrix: Symmetric6,
    impulse: [f64; 6],
}

/// Fills `patch` with what the wall is pressed by.
pub fn press(body: &Body, laws: &Laws, facets: &[Facet], motion: &Motion, patch: &mut Patch) {
    Indenter::new(&laws.foundation, body, motion).press(facets, patch);
}

/// Moves the capsule on by `dt` under the forces of `patch`, and keeps `barred` triangles off its
/// axis; returns what the wall did.
pub fn substep(
    body: &Body,
    laws: &Laws,
    load: &Load,
    motion: &mut Motion,
    patch: &mut Patch,
    barred: &[Facet],
    dt: f64,
) -> Reaction {
    let system = elastic_system(body, load, motion, patch, dt);
    let (change, resistance) = solve_friction(&system, body, laws, motion, patch, dt);
    let (moving, facet_loads) = ((body, &*motion), &mut patch.facet_loads);
    let change = keep_out(moving, barred, &system.matrix, change, facet_loads, dt);
    let before = *motion;
    body.drift(motion, change, dt);
    reaction(body, load, &before, change, &resistance, patch, dt)
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
            matrix.0[row][column] += sum(&sums.matrix[row][column]);
        }
        impulse[row] -= sum(&sums.impulse[row]);
    }
    System { matrix, impulse }
}

/// Sums over samples, lane by lane.
#[derive(Default)]
struct Sums {
    matrix: [[Lane; 6]; 6],
    impulse: [Lane; 6],
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
            // Otherwise it lets go within this substep.
            let holds = pushed > 0.0;
            let slope = dt * (0.25 * dt * s.stiffness[i] + 0.5 * s.damping[i]);
            weight[i] = if holds { slope } else { 0.0 };
            push[i] = if holds { dt * pushed } else { 0.0 };
        }
        for row in 0..6 {
            for column in 0..=row {
                for i in 0..LANES {
                    sums.matrix[row][column][i] += weight[i] * s.lever[row][i] * s.lever[column][i];
                }
            }
            for i in 0..LANES {
                sums.impulse[row][i] += push[i] * s.lever[row][i];
            }
        }
    }
}

/// Adds friction, implicit in the velocity it leads to: the backward rule neither slides back nor
/// chatters, and at speed it has the full friction. Returns the change and the resistance at the
/// center of mass.
fn solve_friction(
    system: &System,
    body: &Body,
    laws: &Laws,
    m: &Motion,
    patch: &Patch,
    dt: f64,
) -> (Twist, Twist) {
    let mut change = Twist::from_array(system.matrix.solve(system.impulse));
    let friction = laws.drag.friction();
    let touches = !patch.facet_loads.is_empty();
    if !touches || (friction == 0.0 && laws.viscosity == 0.0 && !laws.drag.is_logarithmic()) {
        return (change, Twist::default());
    }
    let mut resistance = Twist::default();
    for _ in 0..FRICTION_ROUNDS {
        let guess = Twist {
            linear: m.velocity + change.linear,
            angular: m.angular_velocity + change.angular,
        };
        let mut terms = Resistance::new(m);
        terms.add_drag(laws, body, &guess);
        for on_facet in &patch.facet_loads {
            terms.add_facet_load(on_facet, friction, &guess);
        }
        let next = Twist::from_array(terms.solve(system, m, dt));
        let moved = (next.linear - change.linear).length()
            + body.radius * (next.angular - change.angular).length();
        change = next;
        resistance = terms.force(m, change);
        if moved < 1e-3 * CREEP {
            break;
        }
    }
    (change, resistance)
}

/// Resistances that are linear in velocity for one guess: `−D (v − wall)`.
struct Resistance {
    position: DVec3,
    /// D, both rows and columns linear, then angular.
    linear: DMat3,
    mixed: DMat3,
    angular: DMat3,
    /// D times the wall's velocity.
    wall: Twist,
}

impl Resistance {
    fn new(m: &Motion) -> Self {
        let zero = DMat3::ZERO;
        Resistance {
            position: m.position,
            linear: zero,
            mixed: zero,
            angular: zero,
            wall: Twist::default(),
        }
    }

    /// Drag on the capsule as a whole.
    fn add_drag(&mut self, laws: &Laws, body: &Body, guess: &Twist) {
        let speed = guess.linear.length();
        let by_speed = laws.drag.resistance(speed) / speed.max(CREEP) + laws.viscosity;
        self.linear += DMat3::from_diagonal(DVec3::splat(by_speed));
        let turning = laws.viscosity * body.radius * body.radius;
        self.angular += DMat3::from_diagonal(DVec3::splat(turning));
    }

    /// Coulomb friction of one triangle.
    fn add_facet_load(&mut self, on_facet: &FacetLoad, friction: f64, guess: &Twist) {
        let arm = on_facet.center - self.position;
        let slip = guess.linear + guess.angular.cross(arm) - on_facet.velocity;
        let slip = slip - on_facet.normal * slip.dot(on_facet.normal);
        let most = friction * on_facet.load;
        let by_speed = most / slip.length().max(CREEP + on_facet.mobility * most);
        let n = on_facet.normal;
        let across = DMat3::from_cols(n * n.x, n * n.y, n * n.z);
        let block = (DMat3::IDENTITY - across) * by_speed;
        let lever = skew(arm);
        self.linear += block;
        self.mixed += lever * block;
        self.angular -= lever * block * lever;
        let dragged = block * on_facet.velocity;
        self.wall.linear += dragged;
        self.wall.angular += arm.cross(dragged);
    }

    /// `(A + dt D) δ = b − dt D v + dt D wall`.
    fn solve(&self, system: &System, m: &Motion, dt: f64) -> [f64; 6] {
        let mut matrix = system.matrix;
        for row in 0..3 {
            for column in 0..3 {
                if column <= row {
                    matrix.0[row][column] += dt * self.linear.col(column)[row];
                    matrix.0[3 + row][3 + column] += dt * self.angular.col(column)[row];
                }
                matrix.0[3 + row][column] += dt * self.mixed.col(column)[row];
            }
        }
        let held = self.force(m, Twist::default()).to_array();
        let mut impulse = system.impulse;
        impulse.iter_mut().zip(held).for_each(|(i, f)| *i += dt * f);
        matrix.solve(impulse)
    }

    /// Force and torque after a change of twist.
    fn force(&self, m: &Motion, change: Twist) -> Twist {
        let (v, w) = (m.velocity + change.linear, m.angular_velocity + change.angular);
        Twist {
            linear: self.wall.linear - self.linear * v - self.mixed.transpose() * w,
            angular: self.wall.angular - self.mixed * v - self.angular * w,
        }
    }
}

fn skew(a: DVec3) -> DMat3 {
    DMat3::from_cols(
        DVec3::new(0.0, a.z, -a.y),
        DVec3::new(-a.z, 0.0, a.x),
        DVec3::new(a.y, -a.x, 0.0),
    )
}

/// The wall's part in the change of momentum, and the work of friction over the way gone.
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

/// Collects the patch's loads on the wall into a few contact forces, by part of the capsule's surface.
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

/// Which eighth of a turn a direction lies in; by comparisons, the same on every processor.
fn eighth(x: f64, y: f64) -> usize {
    usize::from(x < 0.0) + 2 * usize::from(y < 0.0) + 4 * usize::from(y.abs() > x.abs())
}
