//! Quasi-static motion: the capsule moves at the velocity at which all forces on it are in balance.
//!
//! A step is divided into parts, in which no point of the capsule moves farther than `LONGEST_WAY`.
//! In each the twist ξ at its end is solved for (backward Euler), from the pose at its start:
//!
//! `M ξ/τ + Σ j P(u + h s, s) + friction(ξ) = F − h K ξ`
//!
//! with F the wrench of sources (at the end of the part), gravity and commands, K the part of the
//! sources' stiffness that holds the capsule back, and P the load of each piece of the wall, linear
//! about the last twist and never below 0. There is no inertia: the mass appears only in the drag
//! M/τ of the lumen contents, by which momentum is lost within τ.

use super::barrier::keep_out;
use super::body::Motion;
use super::friction::{Resistance, solve};
use super::soft_wall::{Outcome, SoftWall};
use super::solve::{Symmetric6, System, Twist};
use super::substep::{Load, contact_forces};
use super::time_stepping::{StepTotals, Stepper, fastest_point};
use crate::wall::Wall;
use glam::DQuat;

/// Maximum displacement of any point of the capsule in one part [m].
const LONGEST_WAY: f64 = 5e-4;
/// Maximum duration of a part [s].
const LONGEST_PART: f64 = 1.0 / 60.0;
/// Maximum number of parts per second: a capsule that would need more is slowed down.
const MOST_PARTS: f64 = 1500.0;
/// Upper limit of the duration of a step [s].
const LONGEST_STEP: f64 = 1000.0;
/// Maximum number of iterations in which pieces of the wall lose and regain contact.
const ROUNDS: usize = 4;
/// Change of displacement that ends the iterations, as a fraction of the maximum displacement.
const SETTLED: f64 = 0.02;

/// Forces on the capsule except those of the wall, linear in its twist.
struct Pull {
    /// Wrench at the current pose, without drag [N, N·m].
    wrench: Twist,
    /// Decrease of the wrench by a twist [N·s/m, …].
    resistance: Symmetric6,
}

/// Solution of one part.
struct Part {
    /// Duration [s].
    h: f64,
    pull: Pull,
    /// Resistance to a change of twist, except friction.
    matrix: Symmetric6,
    change: Twist,
    /// Friction and drag of the wall at the center of mass.
    resistance: Twist,
    /// Number of triangles in contact, except those of the barrier.
    num_pressed: usize,
}

impl Part {
    /// Twist at the end of the part.
    fn twist(&self, m: &Motion) -> Twist {
        let (linear, angular) = (self.change.linear, self.change.angular);
        Twist { linear: m.velocity + linear, angular: m.angular_velocity + angular }
    }
}

impl Stepper {
    /// Advances by a `duration` [s] in parts.
    pub fn relax(&mut self, wall: &mut Wall, load: &Load, duration: f64) -> Outcome {
        if !(duration > 0.0 && duration < LONGEST_STEP) {
            return Err("Quasi-static motion requires steps of above 0 to 1000 s.");
        }
        let (mut totals, mut left) = (StepTotals::default(), duration);
        let most = (MOST_PARTS * duration).ceil() as usize;
        for number in 1..=most {
            left -= self.part(wall, load, left, number == most, &mut totals)?;
            if left <= 1e-9 * duration {
                break;
            }
        }
        self.last = totals.mean(duration);
        Ok(())
    }

    /// Advances by one part of `left` [s], or by all of it if `is_last`; returns its duration.
    fn part(
        &mut self,
        wall: &mut Wall,
        load: &Load,
        left: f64,
        is_last: bool,
        totals: &mut StepTotals,
    ) -> Result<f64, &'static str> {
        self.touch(wall, &mut None)?;
        let (body, soft) = (&self.body, &mut self.soft);
        let loads = &soft.patch.facet_loads;
        contact_forces(body, &self.motion, loads, &mut soft.contact_forces);
        let longest_way = LONGEST_WAY.max(soft.free_way());
        let speed = fastest_point(body, &self.motion, &self.motion);
        let longest = LONGEST_PART.min(longest_way / speed.max(f64::MIN_POSITIVE));
        let h = if is_last { left } else { left / (left / longest).ceil() };
        let mut part = self.solve(load, h)?;
        self.bar(&mut part);
        let twist = part.twist(&self.motion);
        let after =
            Motion { velocity: twist.linear, angular_velocity: twist.angular, ..self.motion };
        let speed = fastest_point(&self.body, &after, &after);
        let way = (h * speed).min(longest_way);
        let share = if h * speed > way { way / (h * speed) } else { 1.0 };
        let taken = if is_last { h } else { share * h };
        self.soft.load_facets(part.num_pressed, &part.change.to_array());
        self.reckon(&part, &twist, taken, totals);
        self.yield_wall(wall, h, share);
        self.motion = go(&after, share * h, taken);
        self.soft.pass(taken, way);
        Ok(taken)
    }

    /// Solves for the change of twist in a part of `h` [s], without the barrier.
    fn solve(&mut self, load: &Load, h: f64) -> Result<Part, &'static str> {
        let pull = self.pull(load, h)?;
        self.soft.find_answers(self.spring_wall.as_ref(), h);
        let (body, motion) = (&self.body, &self.motion);
        let facet_loads = &self.soft.patch.facet_loads;
        let (mut matrix, mut resistance) = (Symmetric6::default(), Twist::default());
        let mut change = Twist::default();
        let resists = Resistance::of(&self.laws, (body, motion), facet_loads, h);
        for _ in 0..ROUNDS {
            let (system, before) = (self.system(&pull, &change, h), change);
            (change, resistance) = solve(resists.as_ref(), &system);
            matrix = system.matrix;
            let moved = (change.linear - before.linear).length()
                + body.radius * (change.angular - before.angular).length();
            if facet_loads.is_empty() || h * moved < SETTLED * LONGEST_WAY {
                break;
            }
        }
        Ok(Part { h, pull, matrix, change, resistance, num_pressed: facet_loads.len() })
    }

    /// Wrench of sources, gravity and commands, and its decrease by a twist.
    fn pull(&mut self, load: &Load, h: f64) -> Result<Pull, &'static str> {
        let (body, motion) = (&self.body, &self.motion);
        let mut wrench = load.wrench;
        wrench.linear += body.mass * load.gravity;
        let mut resistance = body.mass_matrix(motion.rotation).scaled(self.laws.relaxation_rate);
        for k in 0..3 {
            resistance.0[k][k] += load.damping;
        }
        if let Some(magnets) = &mut self.magnets {
            let (pulled, stiffness) = magnets.hold_back(body, motion, h)?;
            wrench += pulled;
            resistance.add(&stiffness.scaled(h));
        }
        Ok(Pull { wrench, resistance })
    }

    /// Linear system of a part, for the pieces of wall in contact after a `change` of twist.
    fn system(&self, pull: &Pull, change: &Twist, h: f64) -> System {
        let now = Twist { linear: self.motion.velocity, angular: self.motion.angular_velocity };
        let lost = pull.resistance.times(&now.to_array());
        let answer = self.soft.force_after(&change.to_array());
        let (mut matrix, wrench) = (pull.resistance, pull.wrench.to_array());
        for row in 0..6 {
            for column in 0..=row {
                let slope = matrix.0[row][column] + answer.slope[row][column];
                matrix.0[row][column] = h * slope;
            }
        }
        let impulse = std::array::from_fn(|row| h * (wrench[row] - lost[row] - answer.force[row]));
        System { matrix, impulse }
    }

    /// Keeps the triangles out of the barrier.
    fn bar(&mut self, part: &mut Part) {
        let (moving, SoftWall { patch, facets, .. }) = ((&self.body, &self.motion), &mut self.soft);
        let loads = &mut patch.facet_loads;
        part.change = keep_out(moving, facets, &part.matrix, part.change, loads, part.h);
    }

    /// Adds the impulses and work of a part over the time `taken` [s].
    fn reckon(&mut self, part: &Part, twist: &Twist, taken: f64, totals: &mut StepTotals) {
        let lost = Twist::from_array(part.pull.resistance.times(&twist.to_array()));
        let loads = self.soft.patch.facet_loads.iter().map(|on_facet| on_facet.load);
        totals.force += taken * (lost.linear - part.pull.wrench.linear);
        totals.torque += taken * (lost.angular - part.pull.wrench.angular);
        totals.normal_force_total += taken * loads.sum::<f64>();
        let held = &part.resistance;
        let power = held.linear.dot(twist.linear) + held.angular.dot(twist.angular);
        totals.friction_work -= taken * power;
        if let Some(magnets) = &mut self.magnets {
            magnets.pass(taken, part.h, twist);
        }
    }

    /// Displaces a spring wall by a fraction of a part of `h` [s].
    fn yield_wall(&mut self, wall: &Wall, h: f64, share: f64) {
        if let Some(spring_wall) = &self.spring_wall {
            let (soft, motion) = (&mut self.soft, &self.motion);
            contact_forces(&self.body, motion, &soft.patch.facet_loads, &mut soft.contact_forces);
            soft.relax(wall, spring_wall, h, share);
        }
    }
}

/// Motion after a `time` [s] at a twist, over which the duration `taken` [s] passes.
fn go(m: &Motion, time: f64, taken: f64) -> Motion {
    let speed = m.angular_velocity.length();
    let turn = if speed > 0.0 {
        let (sine, cosine) = libm::sincos(0.5 * time * speed);
        DQuat::from_vec4((m.angular_velocity * (sine / speed)).extend(cosine))
    } else {
        DQuat::IDENTITY
    };
    Motion {
        position: m.position + time * m.velocity,
        rotation: (turn * m.rotation).normalize(),
        velocity: m.velocity * (time / taken),
        angular_velocity: m.angular_velocity * (time / taken),
    }
}
