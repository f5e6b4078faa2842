//! Robot arm that moves its magnet to a pose within the limits of its joints:
//! `vrcaps.actuation.magnet_actuator`.

use super::arm_chain::{array, pose};
use super::arm_with_payload::ArmWithPayload;
use super::kinematic_chain::Pose;
use super::rotation::{rotate, rotation_vector};
use crate::poses::{rows, square};
use glam::DVec3;
use numpy::{PyArrayDyn, PyReadonlyArray2};
use pyo3::{exceptions::PyValueError, prelude::*};

/// Sine of the angle to the magnet's axis below which a direction defines no rotation about it.
const UPRIGHT: f64 = 0.2;
/// Maximum displacement in one step of the arm along the path to a pose [m].
const MAX_STEP: f64 = 0.03;
/// Maximum rotation in one step of the arm [rad].
const MAX_ROTATION: f64 = 0.3;
/// Shorter steps [m, rad] that are tried if a pose ahead is unreachable.
const SHORT_STEPS: [(f64, f64); 2] = [(8e-3, 0.08), (2e-3, 0.02)];
/// Maximum distance of the magnet from the workspace between two poses in it [m].
const SLACK: f64 = 5e-3;
/// Change of an angle [rad] beyond which a solution is on another branch.
const JUMP: f64 = 0.5;
/// Distance of a joint from its target [rad] beyond which its speed was limited.
const LATE: f64 = 1e-3;

/// Maximum speed [rad/s], acceleration and jerk of a joint.
struct Limits {
    speed: f64,
    acceleration: f64,
    jerk: f64,
}

/// Python handle of the actuator.
#[pyclass(module = "vrcaps._core")]
pub struct RobotActuator {
    robot: ArmWithPayload,
    home: Vec<f64>,
    limits: Vec<Limits>,
    /// Corners of the box for the magnet's center [m].
    low: DVec3,
    high: DVec3,
    /// Target direction of the flange in the world.
    along: DVec3,
    /// Maximum speeds of the magnet [m/s, rad/s].
    speeds: (f64, f64),
}

/// State of magnet and joints.
struct State {
    magnet: Pose,
    velocity: Vec<f64>,
    angles: Vec<f64>,
}

/// Goal, or the first part of the path to a distant goal.
fn step_towards(start: &Pose, goal: &Pose) -> Pose {
    let step = (goal.position - start.position).clamp_length_max(MAX_STEP);
    let turn = rotation_vector(goal.rotation * start.rotation.transpose());
    let is_far = turn.length() > MAX_ROTATION;
    let part = || rotate(turn.clamp_length_max(MAX_ROTATION), start.rotation);
    Pose { position: start.position + step, rotation: if is_far { part() } else { goal.rotation } }
}

/// Pose towards a goal: the magnet moved and its axis rotated by at most `most` [m, rad].
fn short_step(start: &Pose, goal: &Pose, most: (f64, f64)) -> Pose {
    let step = (goal.position - start.position).clamp_length_max(most.0);
    let (from, to) = (start.rotation.z_axis, goal.rotation.z_axis);
    let axis = from.cross(to);
    let sine = axis.length();
    let angle = sine.atan2(from.dot(to)).min(most.1);
    let rotation = rotate(axis * (angle / sine.max(1e-12)), start.rotation);
    Pose { position: start.position + step, rotation }
}

impl RobotActuator {
    /// Pose rotated about the magnet's axis so that the flange points in its target direction; if
    /// that is along the axis, the flange keeps its direction.
    fn align(&self, goal: &Pose, now: &Pose) -> Pose {
        let (axis, flange) = (goal.rotation.z_axis, self.robot.flange_along());
        let across = |v: DVec3| v - axis * axis.dot(v);
        let (from, mut to) = (across(goal.rotation * flange), across(self.along));
        if to.length() < UPRIGHT {
            to = across(now.rotation * flange);
        }
        if from.length().min(to.length()) < 1e-9 {
            return *goal;
        }
        let angle = axis.dot(from.cross(to)).atan2(from.dot(to));
        Pose { rotation: rotate(angle * axis, goal.rotation), ..*goal }
    }

    /// Distance of a position from the workspace [m].
    fn outside(&self, place: DVec3) -> f64 {
        (place - place.clamp(self.low, self.high)).length()
    }

    /// Maximum acceleration of a joint that respects its jerk even if reversed after `dt` [s].
    fn acceleration(limits: &Limits, dt: f64) -> f64 {
        limits.acceleration.min(0.5 * limits.jerk * dt)
    }

    /// Joint velocities of the next step: joints move in proportion and can stop at their targets;
    /// `max_rate` is the maximum fraction of the path per second.
    fn velocity(&self, error: &[f64], velocity: &[f64], dt: f64, max_rate: f64) -> Vec<f64> {
        let rate =
            error.iter().zip(&self.limits).fold(max_rate.min(1.0 / dt), |rate, (error, l)| {
                let a = Self::acceleration(l, dt);
                // Stop at the end of the path: v dt + v²/2a = path.
                let stopping = (a * a * dt * dt + 2.0 * a * error.abs()).sqrt() - a * dt;
                rate.min(l.speed.min(stopping) / error.abs().max(1e-12))
            });
        let joints = error.iter().zip(velocity).zip(&self.limits);
        let next = joints.map(|((error, velocity), l)| {
            let most = dt * Self::acceleration(l, dt);
            velocity + (rate * error - velocity).max(-most).min(most)
        });
        next.collect()
    }

    /// Maximum fraction of the path per second within the magnet's speed limits [1/s].
    fn rate(&self, now: &Pose, goal: &Pose) -> f64 {
        let distance = now.position.distance(goal.position);
        let turn = rotation_vector(goal.rotation * now.rotation.transpose()).length();
        (self.speeds.0 / distance.max(1e-9)).min(self.speeds.1 / turn.max(1e-9))
    }

    /// Constraint that angles violate; `out` is the magnet's distance from the workspace now [m].
    fn blocked(&self, frames: &[Pose], out: f64) -> Option<&'static str> {
        let (own, table) = self.robot.gaps(frames);
        // Between two poses in the workspace, the joints may move the magnet slightly out of it.
        let next = self.outside(self.robot.magnet(frames).position);
        match own.min(table) < 0.0 {
            true => Some("collision"),
            false => (next > SLACK && next > out).then_some("workspace"),
        }
    }

    /// State after a time `dt` [s] at given joint velocities.
    fn at(&self, state: &State, velocity: Vec<f64>, dt: f64, frames: &mut Vec<Pose>) -> State {
        let angles: Vec<f64> =
            state.angles.iter().zip(&velocity).map(|(q, v)| q + dt * v).collect();
        self.robot.arm.chain.frames(&angles, frames);
        State { magnet: self.robot.magnet(frames), velocity, angles }
    }

    /// State after a time `dt` [s] on the path to a pose, and the constraint that limited it.
    fn step(&self, state: &State, goal: &Pose, dt: f64) -> (State, &'static str) {
        let place = goal.position.clamp(self.low, self.high);
        let mut limit = if place == goal.position { "" } else { "workspace" };
        let rolled = self.align(&Pose { position: place, ..*goal }, &state.magnet);
        let goal = step_towards(&state.magnet, &rolled);
        let found = self.robot.solve(&goal, &state.angles, &self.home);
        let far = |(a, b): (&f64, &f64)| (a - b).abs() > JUMP;
        let near = found.filter(|found| !found.iter().zip(&state.angles).any(far));
        limit = if near.is_some() { limit } else { "unreachable" };
        let wanted = near.unwrap_or_else(|| state.angles.clone());
        let error: Vec<f64> = wanted.iter().zip(&state.angles).map(|(w, q)| w - q).collect();
        let velocity = self.velocity(&error, &state.velocity, dt, self.rate(&state.magnet, &goal));
        let (mut frames, out) = (Vec::new(), self.outside(state.magnet.position));
        let next = self.at(state, velocity, dt, &mut frames);
        let blocked = self.blocked(&frames, out).or_else(|| {
            let joints = next.angles.iter().zip(&next.velocity).zip(&self.limits);
            let stop = joints.map(|((q, v), l)| q + 0.5 * v * v.abs() / Self::acceleration(l, dt));
            self.robot.arm.chain.frames(&stop.collect::<Vec<_>>(), &mut frames);
            self.blocked(&frames, out)
        });
        if let Some(blocked) = blocked {
            let brake = self.velocity(&vec![0.0; error.len()], &state.velocity, dt, f64::INFINITY);
            return (self.at(state, brake, dt, &mut frames), blocked);
        }
        let is_late = wanted.iter().zip(&next.angles).any(|(w, q)| (w - q).abs() > LATE);
        (next, if limit.is_empty() && is_late { "speed" } else { limit })
    }

    /// Advances as `step`, in shorter steps if necessary: near a joint limit, other joints move far
    /// for a short path of the magnet, and a distant pose may be unreachable when a near one is
    /// not.
    fn go(&self, state: &State, goal: &Pose, dt: f64) -> (State, &'static str) {
        let mut moved = self.step(state, goal, dt);
        for most in SHORT_STEPS {
            if moved.1 != "unreachable" {
                break;
            }
            moved = self.step(state, &short_step(&state.magnet, goal, most), dt);
        }
        moved
    }
}

/// Pose [4 4] of the magnet, joint velocities and angles [n], and the constraint that limited them.
type Moved<'py> = (
    Bound<'py, PyArrayDyn<f64>>,
    Bound<'py, PyArrayDyn<f64>>,
    Bound<'py, PyArrayDyn<f64>>,
    &'static str,
);

#[pymethods]
impl RobotActuator {
    /// Actuator from joints, as rows of home angle, maximum speed, acceleration and jerk; corners
    /// of the workspace [m]; target direction of the flange; maximum magnet speeds [m/s, rad/s].
    #[new]
    fn new(
        robot: PyRef<'_, ArmWithPayload>,
        joints: PyReadonlyArray2<'_, f64>,
        workspace: ([f64; 3], [f64; 3]),
        along: [f64; 3],
        speeds: (f64, f64),
    ) -> PyResult<Self> {
        let joints = rows(&joints, 4)?;
        let limits = |j: &[f64]| Limits { speed: j[1], acceleration: j[2], jerk: j[3] };
        Ok(RobotActuator {
            robot: robot.clone(),
            home: joints.chunks_exact(4).map(|j| j[0]).collect(),
            limits: joints.chunks_exact(4).map(limits).collect(),
            low: workspace.0.into(),
            high: workspace.1.into(),
            along: along.into(),
            speeds,
        })
    }

    /// Pose [4 4] rotated about the magnet's axis until the flange points in its target direction.
    fn align_flange<'py>(
        &self,
        py: Python<'py>,
        goal: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let goal = pose(&square(&goal, 4)?);
        array(py, &[4, 4], self.align(&goal, &goal).rows().to_vec())
    }

    /// State of the magnet after a time `dt` [s], on the path from a pose [4 4] to another.
    fn move_towards<'py>(
        &self,
        py: Python<'py>,
        magnet: PyReadonlyArray2<'py, f64>,
        velocity: Vec<f64>,
        angles: Vec<f64>,
        goal: PyReadonlyArray2<'py, f64>,
        dt: f64,
    ) -> PyResult<Moved<'py>> {
        if angles.len() != self.limits.len() || velocity.len() != self.limits.len() {
            return Err(PyValueError::new_err("One angle and one speed per joint are needed."));
        }
        let state = State { magnet: pose(&square(&magnet, 4)?), velocity, angles };
        let (next, limit) = self.go(&state, &pose(&square(&goal, 4)?), dt);
        let n = next.angles.len();
        Ok((
            array(py, &[4, 4], next.magnet.rows().to_vec())?,
            array(py, &[n], next.velocity)?,
            array(py, &[n], next.angles)?,
            limit,
        ))
    }
}
