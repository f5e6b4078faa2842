//! What leads a capsule on: `vrcaps.actuation.magnet_controller`.

use super::handle::{pose_rows, read_pose, rows};
use super::turn::{towards, turned};
use glam::{DMat3, DVec3};
use numpy::{PyArray1, PyArray2, PyReadonlyArray2, ndarray::arr2};
use pyo3::prelude::*;

/// Time in which it comes after the capsule where that is not controlled, and after the wall [s].
const AFTER: f64 = 0.5;
/// Sine of an angle below which a direction along the wall's normal cannot be made level.
const STEEP: f64 = 0.1;
/// Force of the wall that counts as a touch [N].
const TOUCH: f64 = 0.01;
/// A sine below this says no axis.
const PARALLEL: f64 = 1e-12;

/// `vrcaps.actuation.capsule_target.Goal`.
#[derive(FromPyObject)]
pub struct Goal {
    position: [f64; 3],
    direction: Option<[f64; 3]>,
    along: Option<[f64; 3]>,
    press: [f64; 3],
    level: bool,
    mapped: bool,
}

/// Of `vrcaps.actuation.magnet_controller.Steering`: speeds [m/s, rad/s], and how far ahead it goes [m, rad].
#[derive(FromPyObject)]
pub struct Steering {
    speed: f64,
    turn_speed: f64,
    lead: f64,
    turn_lead: f64,
}

/// What leads the capsule.
struct Leader {
    /// Where it is to be [m].
    place: DVec3,
    /// Where it is to look.
    look: DVec3,
    /// To the wall that it lies on, square to that.
    side: DVec3,
}

impl Goal {
    /// The part of a vector in the directions in which the place counts.
    fn controlled(&self, v: DVec3) -> DVec3 {
        let part = |axis: DVec3| axis * axis.dot(v);
        self.along.map_or_else(|| v - part(self.press.into()), |along| part(along.into()))
    }
}

impl Leader {
    /// The place a time `dt` [s] later: not too fast, and never far ahead of the capsule at `at`.
    fn moved(&self, at: DVec3, goal: &Goal, s: &Steering, dt: f64) -> DVec3 {
        let off = self.place - at;
        let lag = goal.controlled(off);
        // Elsewhere it comes after the capsule, slowly: at once would undo the field's own hold.
        let across = (off - lag) * if goal.mapped { 1.0 } else { 1.0 - (dt / AFTER).min(1.0) };
        // From a capsule that slides away it does not follow at once: the field brings that back.
        let most = s.speed * dt;
        let back = (lag - lag.clamp_length_max(s.lead)).clamp_length_max(most);
        let place = at + lag - back + across;
        let way = DVec3::from(goal.position) - place;
        place + if goal.mapped { way } else { goal.controlled(way) }.clamp_length_max(most)
    }

    /// The direction a time `dt` [s] later, of a capsule that looks along `axis`.
    fn turned(&self, axis: DVec3, goal: &Goal, s: &Steering, dt: f64) -> DVec3 {
        let ahead = goal.direction.map_or(axis, DVec3::from);
        let flat = ahead - self.side * self.side.dot(ahead);
        let is_flat = goal.level && flat.length() > STEEP;
        let ahead = if is_flat { flat.normalize() } else { ahead };
        let about = goal.press.into();
        let led = towards(axis, self.look, s.turn_lead, about);
        towards(led, ahead, s.turn_speed * dt, about)
    }

    /// The side a time `dt` [s] later: where the wall pushes from, without a touch the goal's.
    fn leant(&self, contact: DVec3, goal: &Goal, dt: f64) -> DVec3 {
        let felt = contact.length() > TOUCH && !goal.mapped;
        let touched = if felt { -contact.normalize() } else { goal.press.into() };
        let side = self.side.lerp(touched, (dt / AFTER).min(1.0));
        side / side.length().max(1e-9)
    }
}

/// The leader [3 3]; the pose [4 4] of a capsule that is where it leads; from the capsule to there
/// the way that counts [m], the turn's axis by its sine and its angle [rad]; whether the wall pushes
/// the way that the magnet is to press.
type Led<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    f64,
    bool,
);

/// Moves a leader, rows of place [m], direction and side, on by `dt` [s], ahead of a capsule at a
/// pose [4 4] that the wall pushes with a force [N].
#[pyfunction]
pub fn lead_on<'py>(
    py: Python<'py>,
    leader: PyReadonlyArray2<'py, f64>,
    capsule: PyReadonlyArray2<'py, f64>,
    contact: [f64; 3],
    goal: Goal,
    steering: Steering,
    dt: f64,
) -> PyResult<Led<'py>> {
    let now = DMat3::from_cols_slice(&rows(&leader, 3)?);
    let now = Leader { place: now.x_axis, look: now.y_axis, side: now.z_axis };
    let ((rotation, at), contact) = (read_pose(&capsule)?, DVec3::from(contact));
    let axis = rotation.z_axis;
    let next = Leader {
        place: now.moved(at, &goal, &steering, dt),
        look: now.turned(axis, &goal, &steering, dt),
        side: now.leant(contact, &goal, dt),
    };
    let bend = axis.cross(next.look);
    let angle = bend.length().atan2(axis.dot(next.look));
    let turn = if bend.length() > PARALLEL { angle * bend.normalize() } else { DVec3::ZERO };
    let led = DMat3::from_cols(next.place, next.look, next.side).to_cols_array_2d();
    let flat = pose_rows(&turned(turn, rotation), next.place);
    let pose = [0, 4, 8, 12].map(|k| [flat[k], flat[k + 1], flat[k + 2], flat[k + 3]]);
    let error = goal.controlled(next.place - at);
    Ok((
        PyArray2::from_owned_array(py, arr2(&led)),
        PyArray2::from_owned_array(py, arr2(&pose)),
        PyArray1::from_slice(py, &error.to_array()),
        PyArray1::from_slice(py, &bend.to_array()),
        angle,
        contact.dot(goal.press.into()) > TOUCH,
    ))
}
