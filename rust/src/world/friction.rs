//! Friction and drag of one substep, implicit in the final velocity: backward Euler neither slides
//! back nor chatters, and has the full friction at speed.
//!
//! With the normal loads given, the change δ of twist minimizes a convex function,
//! `½ δ·A δ − b·δ + dt Σ ψ(slip)`, with ψ′ Coulomb's friction, which is linear up to `CREEP`. It is
//! minimized by Newton's method with line search (Hüeber, Stadler, Wohlmuth, SIAM J. Sci. Comput.
//! 30, 2008, for the same semismooth slopes), from the last substep's velocity: steady sticking or
//! sliding is solved in one iteration, however light the capsule.

use super::body::{Body, Motion};
use super::contact_patch::FacetLoad;
use super::laws::Laws;
use super::sliding::{CREEP, Grip};
use super::solve::{Symmetric6, System, Twist, dot};
use glam::{DMat3, DVec3};

/// Maximum number of Newton iterations; two or three are usual.
const ROUNDS: usize = 24;
/// Maximum number of trials of a line search.
const TRIALS: usize = 16;
/// Fraction of the initial slope at which a line search ends.
const FLAT: f64 = 0.1;
/// Tolerance of the velocity [m/s].
const TOLERANCE: f64 = 1e-3 * CREEP;

/// Change of twist, and its residual impulse.
#[derive(Clone, Copy)]
struct Guess {
    change: [f64; 6],
    lack: [f64; 6],
}

/// Forces that resist the capsule in one substep.
pub struct Resistance<'a> {
    pub laws: &'a Laws,
    pub body: &'a Body,
    pub motion: &'a Motion,
    /// Friction of the triangles in contact.
    pub grip: Grip,
    pub dt: f64,
}

impl<'a> Resistance<'a> {
    /// Resistance of triangles in contact over a time `dt` [s]; `None` without any.
    pub fn of(
        laws: &'a Laws,
        (body, motion): (&'a Body, &'a Motion),
        touched: &[FacetLoad],
        dt: f64,
    ) -> Option<Self> {
        let grip = || Grip::new(touched, laws.drag.friction(), motion.position);
        let resists = laws.resist() && !touched.is_empty();
        resists.then(|| Resistance { laws, body, motion, grip: grip(), dt })
    }
}

/// Change of twist under a system and a resistance, and the resistance at the center of mass.
pub fn solve(resistance: Option<&Resistance>, system: &System) -> (Twist, Twist) {
    match resistance {
        Some(resistance) => resistance.solve(system),
        None => (Twist::from_array(system.matrix.solve(system.impulse)), Twist::default()),
    }
}

impl Resistance<'_> {
    /// Change of twist under `system`, and the resistance at the center of mass.
    pub fn solve(&self, system: &System) -> (Twist, Twist) {
        let mut guess = self.guess(system, [0.0; 6]);
        for _ in 0..ROUNDS {
            let way = self.slope(system, &guess).solve(guess.lack);
            let next = self.along(system, &guess, &way);
            let moved: [f64; 6] = std::array::from_fn(|k| next.change[k] - guess.change[k]);
            guess = next;
            if self.is_done(&guess, Twist::from_array(moved)) {
                break;
            }
        }
        let moved = system.matrix.times(&guess.change);
        let force = std::array::from_fn(|k| (moved[k] - system.impulse[k]) / self.dt);
        (Twist::from_array(guess.change), Twist::from_array(force))
    }

    /// Minimum on the line from a guess along `way`; the full step if the function still falls
    /// there.
    fn along(&self, system: &System, from: &Guess, way: &[f64; 6]) -> Guess {
        let (mut low, mut high) = ((0.0, dot(&from.lack, way)), None::<(f64, f64)>);
        let enough = FLAT * low.1;
        let (mut share, mut found) = (1.0, *from);
        for _ in 0..TRIALS {
            let change = std::array::from_fn(|k| from.change[k] + share * way[k]);
            found = self.guess(system, change);
            let falls = dot(&found.lack, way);
            if falls.abs() <= enough || (falls > 0.0 && share == 1.0) {
                break;
            }
            // Illinois method: half the value of the end that stays, so that both ends move.
            if falls > 0.0 {
                high = high.map(|(at, slope)| (at, 0.5 * slope));
                low = (share, falls);
            } else {
                low.1 *= if high.is_some() { 0.5 } else { 1.0 };
                high = Some((share, falls));
            }
            if let Some((at, slope)) = high {
                share = low.0 + (at - low.0) * low.1 / (low.1 - slope);
            }
        }
        found
    }

    /// True if the change is below the tolerance: the system's inertia is at least the body's.
    fn is_done(&self, guess: &Guess, moved: Twist) -> bool {
        let (body, lack) = (self.body, Twist::from_array(guess.lack));
        let left = lack.linear.length() / body.mass;
        let turning = lack.angular.length() / body.moments.min_element();
        let size = |linear: f64, angular: f64| linear + body.radius * angular;
        size(left, turning) < TOLERANCE
            || size(moved.linear.length(), moved.angular.length()) < TOLERANCE
    }

    fn twist(&self, change: &[f64; 6]) -> Twist {
        let (m, change) = (self.motion, Twist::from_array(*change));
        Twist { linear: m.velocity + change.linear, angular: m.angular_velocity + change.angular }
    }

    fn guess(&self, system: &System, change: [f64; 6]) -> Guess {
        let force = self.force(&self.twist(&change)).to_array();
        let moved = system.matrix.times(&change);
        let lack = std::array::from_fn(|k| system.impulse[k] + self.dt * force[k] - moved[k]);
        Guess { change, lack }
    }

    /// Friction of all triangles and drag on the body, at the center of mass.
    fn force(&self, twist: &Twist) -> Twist {
        let (_, drag, turning) = self.drag(twist);
        let mut force = self.grip.force(twist);
        force += Twist { linear: -drag * twist.linear, angular: -turning * twist.angular };
        force
    }

    /// Jacobian of the residual impulse by the change of twist.
    fn slope(&self, system: &System, guess: &Guess) -> Symmetric6 {
        let (mut slope, twist) = (system.matrix, self.twist(&guess.change));
        let (speed, drag, turning) = self.drag(&twist);
        let way = twist.linear / speed.max(f64::MIN_POSITIVE);
        // Across the velocity, drag rotates with it; along it, drag grows by its law.
        let along =
            if speed > CREEP { self.laws.drag.slope(speed) + self.laws.viscosity } else { drag };
        let outer = DMat3::from_cols(way * way.x, way * way.y, way * way.z);
        let linear = DMat3::from_diagonal(DVec3::splat(drag)) + (along - drag) * outer;
        for row in 0..3 {
            for column in 0..=row {
                slope.0[row][column] += self.dt * linear.col(column)[row];
            }
            slope.0[3 + row][3 + row] += self.dt * turning;
        }
        self.grip.add_slope(&twist, self.dt, &mut slope);
        slope
    }

    /// Speed of the capsule, and its drag coefficients by velocity and by angular velocity.
    fn drag(&self, twist: &Twist) -> (f64, f64, f64) {
        let (laws, speed) = (self.laws, twist.linear.length());
        let by_speed = laws.drag.resistance(speed) / speed.max(CREEP) + laws.viscosity;
        (speed, by_speed, laws.viscosity * self.body.radius * self.body.radius)
    }
}

#[cfg(test)]
mod tests {
    use super::super::contact_patch::FacetLoad;
    use super::*;
    use crate::tissue::drag::Drag;
    use crate::tissue::winkler_foundation::WinklerFoundation;
    use glam::DQuat;

    fn numbers() -> impl FnMut() -> DVec3 {
        let mut state = 7u64;
        let mut next = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        move || DVec3::new(next(), next(), next())
    }

    /// Solves for a capsule of 3 g in a few hundred random grips of 0.1 N in total, at up to 20
    /// mm/s, pulled below, about and above their limit: the residual is below the tolerance.
    #[test]
    fn newton_converges_whatever_the_grips() {
        let foundation = WinklerFoundation::new([1e6, 1e-3, 0.1, 1e-3], 5.5e-3);
        let body = Body {
            mass: 3e-3,
            moments: DVec3::new(1.5e-7, 1.5e-7, 4.5e-8),
            principal: DQuat::IDENTITY,
            center: DVec3::ZERO,
            half_axis: 7.5e-3,
            radius: 5.5e-3,
        };
        let drag = Drag::Physical { friction: 0.5 };
        let laws = Laws { foundation, drag, viscosity: 0.01, relaxation_rate: 0.0 };
        let mut vector = numbers();
        for case in 0..300 {
            let (pull, dt) = (0.01 * f64::from(case % 30), [5e-5, 2e-4, 1e-3][case as usize % 3]);
            let facet_loads: Vec<FacetLoad> = (0..1 + case)
                .map(|place| FacetLoad {
                    place,
                    center: 0.02 * vector(),
                    normal: vector().normalize(),
                    load: 0.4 / f64::from(1 + case) * (0.5 + vector().x),
                    velocity: f64::from(case % 4) * 2e-3 * vector(),
                    mobility: 0.0,
                })
                .collect();
            let motion = Motion {
                velocity: f64::from(case % 5) * 1e-2 * vector(),
                angular_velocity: f64::from(case % 7) * vector(),
                ..Motion::default()
            };
            let impulse = Twist { linear: dt * pull * vector(), angular: DVec3::ZERO }.to_array();
            let system = System { matrix: body.mass_matrix(DQuat::IDENTITY), impulse };
            let grip = Grip::new(&facet_loads, laws.drag.friction(), DVec3::ZERO);
            let resists = Resistance { laws: &laws, body: &body, motion: &motion, grip, dt };
            let (change, force) = resists.solve(&system);
            let left = Twist::from_array(resists.guess(&system, change.to_array()).lack);
            assert!(left.linear.length() < 2.0 * TOLERANCE * body.mass, "{case} {}", left.linear);
            assert!(left.angular.length() < 2e-3 * TOLERANCE, "{case} {}", left.angular);
            let held = resists.force(&resists.twist(&change.to_array()));
            assert!((held.linear - force.linear).length() * dt < 2.0 * TOLERANCE * body.mass);
        }
    }
}
