//! Quasi-static motion: the capsule goes at the velocity at which all that acts on it is in balance.
//!
//! A time is cut into parts, in which no point of the capsule goes farther than `LONGEST_WAY`. In
//! each the twist ξ at its end is solved for (backward Euler), from the pose at its beginning:
//!
//! `M ξ/τ + Σ j P(u + h s, s) + friction(ξ) = F − h K ξ`
//!
//! with the wrench F of sources (at the end of the part), gravity and commands, K the part of their
//! stiffness that holds the capsule back, and P the load of each piece of the wall, linear about the
//! last twist and never below 0. There is no inertia: what is left of the mass is the drag M/τ of
//! what fills the lumen, by which momentum is lost within τ.

use super::barrier::keep_out;
use super::body::Motion;
use super::friction::{Resistance, solve};
use super::soft_wall::{Outcome, SoftWall};
use super::solve::{Symmetric6, System, Twist};
use super::substep::{Load, contact_forces};
use super::time_stepping::{StepTotals, Stepper, fastest_point};
use crate::wall::Wall;
use glam::DQuat;

/// Farthest that any point of the capsule goes in one part [m].
const LONGEST_WAY: f64 = 5e-4;
/// Longest part [s].
const LONGEST_PART: f64 = 1.0 / 60.0;
/// Most parts a second: a capsule that would need more is slower.
const MOST_PARTS: f64 = 1500.0;
/// No step is longer [s].
const LONGEST_STEP: f64 = 1000.0;
/// Most rounds in which pieces of the wall let go and hold again.
const ROUNDS: usize = 4;
/// Share of the longest way by which a round may still change the way.
const SETTLED: f64 = 0.02;

/// What acts on the capsule besides the wall, linear in its twist.
struct Pull {
    /// At the pose now and without the drag [N, N·m].
    wrench: Twist,
    /// What a twist takes away of it [N·s/m, …].
    resistance: Symmetric6,
}

/// What one part is solved for.
struct Part {
    /// How long it is [s].
    h: f64,
    pull: Pull,
    /// What resists a change of twist, but for friction.
    matrix: Symmetric6,
    change: Twist,
    /// Friction and drag of the wall at the center of mass.
    resistance: Twist,
    /// Touched triangles without those that only the barrier holds.
    num_pressed: usize,
}

impl Part {
    /// The twist at its end.
    fn twist(&self, m: &Motion) -> Twist {
        let (linear, angular) = (self.change.linear, self.change.angular);
        Twist { linear: m.velocity + linear, angular: m.angular_velocity + angular }
    }
}

impl Stepper {
    /// Moves on by a `duration` [s] in parts.
    pub fn relax(&mut self, wall: &mut Wall, load: &Load, duration: f64) -> Outcome {
        if !(duration > 0.0 && duration < LONGEST_STEP) {
            return Err("Quasi-static motion takes steps of above 0 to 1000 s.");
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

    /// One part of what is `left` [s], all of it where it must be the last; returns its length.
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

    /// The change of twist in a part of `h` [s], but for the barrier.
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

    /// Wrench of sources, gravity and commands, and what a twist takes away of it.
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

    /// Linear system of a part, of the pieces of wall that hold after a `change` of twist.
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

    /// Adds what a part did in the time that it took [s].
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

    /// Lets a spring wall give way by a share of a part of `h` [s].
    fn yield_wall(&mut self, wall: &Wall, h: f64, share: f64) {
        if let Some(spring_wall) = &self.spring_wall {
            let (soft, motion) = (&mut self.soft, &self.motion);
            contact_forces(&self.body, motion, &soft.patch.facet_loads, &mut soft.contact_forces);
            soft.relax(wall, spring_wall, h, share);
        }
    }
}

/// Where a twist brings the capsule in a `time` [s], of which it takes so much.
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
