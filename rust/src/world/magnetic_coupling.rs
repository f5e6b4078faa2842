//! Action of external sources on the capsule's magnets, substep by substep.

use super::body::{Body, Motion};
use super::parameters::principal_axes;
use super::soft_wall::Outcome;
use super::solve::{Symmetric6, Twist};
use crate::magnet::sources::{InternalMagnet, Place, Source, Wrench, field, wrench};
use glam::{DMat3, DQuat, DVec3};

/// Maximum phase of an oscillation per substep [rad]: a leapfrog is stable below 2.
const LONGEST_SWING: f64 = 0.5;
/// Count of numbers in a row of a source: position, quaternion wxyz, strength.
pub const SOURCE_ROW: usize = 8;

/// Step of the finite difference of the force [m].
const PROBE: f64 = 1e-4;

/// Result of `MagneticCoupling::report` for Python.
pub type Report = ([f64; 3], [f64; 3], [f64; 3], [f64; 9], u8, [f64; 3], f64);

/// Trajectory of one source during a step.
struct Way {
    start: DVec3,
    span: DVec3,
    rotation: DQuat,
    axis: DVec3,
    angle: f64,
    strength: (f64, f64),
}

/// External sources and magnets in the capsule.
#[derive(Default)]
pub struct MagneticCoupling {
    sources: Vec<Source>,
    inside: Vec<InternalMagnet>,
    ways: Vec<Way>,
    /// Rotation from the wall's frame to the world's.
    rotation: DQuat,
    offset: DVec3,
    /// Time since the start of the step, and its duration [s].
    clock: f64,
    duration: f64,
    /// Impulse since the start of the step, in the world.
    impulse: Twist,
    /// Worst region of the field since the start of the step.
    place: Place,
    /// Maximum torque of the field on the magnets in any orientation [N·m].
    hold: f64,
    /// Wrench and stiffness of the last `hold_back`.
    pulled: Twist,
    stiffness: Symmetric6,
}

impl Way {
    fn new(begin: &[f64], end: &[f64]) -> Self {
        let place = |row: &[f64]| DVec3::new(row[0], row[1], row[2]);
        let turned = |row: &[f64]| DQuat::from_xyzw(row[4], row[5], row[6], row[3]);
        let rotation = turned(begin);
        let turn = turned(end) * rotation.conjugate();
        let turn = if turn.w < 0.0 { -turn } else { turn };
        let sine = turn.xyz().length();
        let axis = if sine > 0.0 { turn.xyz() / sine } else { DVec3::Z };
        Way {
            start: place(begin),
            span: place(end) - place(begin),
            rotation,
            axis,
            angle: if begin[3..7] == end[3..7] { 0.0 } else { 2.0 * libm::atan2(sine, turn.w) },
            strength: (begin[7], end[7]),
        }
    }

    /// Moves a source to a fraction of the step: along a line, by the shortest rotation.
    fn put(&self, source: &mut Source, share: f64) {
        source.position = self.start + share * self.span;
        source.strength = self.strength.0 + share * (self.strength.1 - self.strength.0);
        if self.angle != 0.0 {
            let turn = quaternion(self.axis, share * self.angle) * self.rotation;
            source.rotation = DMat3::from_quat(turn);
        }
    }

    fn is_still(&self) -> bool {
        self.span == DVec3::ZERO && self.angle == 0.0 && self.strength.0 == self.strength.1
    }
}

fn quaternion(axis: DVec3, angle: f64) -> DQuat {
    let (sine, cosine) = libm::sincos(0.5 * angle);
    DQuat::from_vec4((axis * sine).extend(cosine))
}

impl MagneticCoupling {
    /// Coupling of sources, at any pose, and the capsule's magnets.
    pub fn new(sources: Vec<Source>, inside: Vec<InternalMagnet>) -> Self {
        MagneticCoupling { sources, inside, ..MagneticCoupling::default() }
    }

    /// Number of rows that `aim` requires.
    pub fn count(&self) -> usize {
        self.sources.len()
    }

    /// Sets the trajectories of the sources from rows to rows within `duration` [s]; `pose` is that
    /// of the wall in the world.
    pub fn aim(
        &mut self,
        (begin, end): (&[f64], &[f64]),
        duration: f64,
        pose: (DMat3, DVec3),
        motion: &Motion,
    ) {
        let rows = begin.chunks_exact(SOURCE_ROW).zip(end.chunks_exact(SOURCE_ROW));
        self.ways = rows.map(|(begin, end)| Way::new(begin, end)).collect();
        (self.rotation, self.offset) = (DQuat::from_mat3(&pose.0).normalize(), pose.1);
        (self.clock, self.duration) = (0.0, duration);
        (self.impulse, self.place) = (Twist::default(), Place::Regular);
        for (way, source) in self.ways.iter().zip(&mut self.sources) {
            source.rotation = DMat3::from_quat(way.rotation);
            way.put(source, 0.0);
        }
        self.hold = self.wrench(motion).hold;
    }

    fn wrench(&self, motion: &Motion) -> Wrench {
        let position = self.rotation * motion.position + self.offset;
        wrench(&self.sources, &self.inside, position, self.rotation * motion.rotation)
    }

    /// Number of parts of a substep of `dt` [s] that resolve the oscillation in the field.
    pub fn parts(&self, body: &Body, dt: f64) -> f64 {
        (dt * (self.hold / body.moments.min_element()).sqrt() / LONGEST_SWING).ceil()
    }

    /// Wrench over the next substep of `dt` [s], in the wall's frame.
    ///
    /// It is evaluated at the middle of the substep, for sources and the freely moving capsule.
    /// With the drift of the capsule this is the leapfrog, which conserves the energy of an
    /// oscillation; the wrench of the start would increase it.
    pub fn pull(&mut self, body: &Body, motion: &Motion, dt: f64) -> Result<Twist, &'static str> {
        let share = (self.clock + 0.5 * dt) / self.duration;
        self.clock += dt;
        let pulled = self.wrench_at(share, body, &halfway(motion, dt))?;
        self.impulse.linear += dt * pulled.force;
        self.impulse.angular += dt * pulled.torque;
        Ok(self.in_wall(&pulled))
    }

    /// Wrench at a pose, with the sources at a fraction of the step.
    fn wrench_at(
        &mut self,
        share: f64,
        body: &Body,
        motion: &Motion,
    ) -> Result<Wrench, &'static str> {
        for (way, source) in self.ways.iter().zip(&mut self.sources) {
            if !way.is_still() {
                way.put(source, share);
            }
        }
        let pulled = self.wrench(motion);
        (self.place, self.hold) = (self.place.max(pulled.place), pulled.hold);
        if pulled.place == Place::Singular {
            return Err(
                "A magnet of the capsule comes into a dipole, on a wire or on the rim of a \
                        magnet. Allowed: Ts_world_magnet farther away.",
            );
        }
        self.require_apart(body, motion)?;
        Ok(pulled)
    }

    fn in_wall(&self, pulled: &Wrench) -> Twist {
        let back = self.rotation.conjugate();
        Twist { linear: back * pulled.force, angular: back * pulled.torque }
    }

    /// Wrench at the current pose with the sources after an interval `h` [s], and the stiffness
    /// with which they hold the capsule there, in the wall's frame.
    ///
    /// The stiffness of the force is the positive part of −∂F/∂x; that of the torque is
    /// `hold · (I − m̂ m̂ᵀ)`, exact for an aligned moment m and an upper bound elsewhere.
    pub fn hold_back(
        &mut self,
        body: &Body,
        motion: &Motion,
        h: f64,
    ) -> Result<(Twist, Symmetric6), &'static str> {
        let share = ((self.clock + h) / self.duration).min(1.0);
        let pulled = self.wrench_at(share, body, motion)?;
        let slope = |axis: DVec3| {
            let position = motion.position + PROBE * axis;
            let there = self.wrench(&Motion { position, ..*motion });
            self.rotation.conjugate() * (pulled.force - there.force) / PROBE
        };
        let slopes = DMat3::from_cols(slope(DVec3::X), slope(DVec3::Y), slope(DVec3::Z));
        let (slopes, axes) = principal_axes(0.5 * (slopes + slopes.transpose()));
        let held = axes * DMat3::from_diagonal(slopes.max(DVec3::ZERO)) * axes.transpose();
        let moment: DVec3 = self.inside.iter().map(|m| m.moment).sum();
        let along = motion.rotation * moment.normalize_or_zero();
        let mut stiffness = Symmetric6::default();
        for row in 0..3 {
            for column in 0..=row {
                stiffness.0[row][column] = held.col(column)[row];
                stiffness.0[3 + row][3 + column] = -pulled.hold * along[row] * along[column];
            }
            stiffness.0[3 + row][3 + row] += pulled.hold;
        }
        (self.pulled, self.stiffness) = (self.in_wall(&pulled), stiffness);
        Ok((self.pulled, stiffness))
    }

    /// Advances by `taken` of an interval `h` [s], at a twist in the wall's frame.
    pub fn pass(&mut self, taken: f64, h: f64, twist: &Twist) {
        let lost = Twist::from_array(self.stiffness.times(&twist.to_array()));
        let (force, torque) = (self.pulled.linear, self.pulled.angular);
        self.clock += taken;
        self.impulse.linear += taken * (self.rotation * (force - h * lost.linear));
        self.impulse.angular += taken * (self.rotation * (torque - h * lost.angular));
    }

    fn require_apart(&self, body: &Body, motion: &Motion) -> Outcome {
        let axis = body.axis(motion);
        for share in [0.0, 0.5, 1.0] {
            let point = self.rotation * (axis.start + share * axis.span) + self.offset;
            if self.sources.iter().any(|source| source.cuts(point, body.radius)) {
                return Err("A magnet outside cuts the capsule. Allowed: Ts_world_magnet farther \
                            away.");
            }
        }
        Ok(())
    }

    /// Moves the sources to the end of their trajectories.
    pub fn finish(&mut self) {
        for (way, source) in self.ways.iter().zip(&mut self.sources) {
            way.put(source, 1.0);
        }
    }

    /// Mean force [N] and torque [N·m] since the start of the step, flux density [T] and its
    /// gradient by rows [T/m] at the center of the magnets of a capsule at a pose, worst region
    /// since the start, center [m], angle between moment and field [rad]; all in the world.
    pub fn report(&self, (rotation, position): (DMat3, DVec3)) -> Report {
        let over = if self.clock > 0.0 { 1.0 / self.clock } else { 0.0 };
        let total: f64 = self.inside.iter().map(|m| m.moment.length()).sum();
        let middle: DVec3 = self.inside.iter().map(|m| m.moment.length() * m.position).sum();
        let middle = position + rotation * (middle / total.max(f64::MIN_POSITIVE));
        let moment = rotation * self.inside.iter().map(|m| m.moment).sum::<DVec3>();
        let at = field(&self.sources, middle);
        (
            (over * self.impulse.linear).to_array(),
            (over * self.impulse.angular).to_array(),
            at.flux.to_array(),
            at.gradient.transpose().to_cols_array(),
            self.place as u8,
            middle.to_array(),
            moment.cross(at.flux).length().atan2(moment.dot(at.flux)),
        )
    }
}

/// Pose of the capsule after free motion over half of `dt` [s].
fn halfway(motion: &Motion, dt: f64) -> Motion {
    let speed = motion.angular_velocity.length();
    let rotation = if speed > 0.0 {
        quaternion(motion.angular_velocity / speed, 0.5 * dt * speed) * motion.rotation
    } else {
        motion.rotation
    };
    Motion { position: motion.position + 0.5 * dt * motion.velocity, rotation, ..*motion }
}
