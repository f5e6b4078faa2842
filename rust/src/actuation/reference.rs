//! Reference that a capsule follows: `vrcaps.actuation.magnet_controller`.

use super::rotation::{rotate, towards};
use crate::poses::{pose_rows, read_pose, three_rows};
use glam::{DMat3, DVec3};
use numpy::{PyArray1, PyArray2, PyReadonlyArray2, ndarray::arr2};
use pyo3::prelude::*;

/// Time constant at which it follows the capsule in uncontrolled directions, and the wall [s].
const TIME_CONSTANT: f64 = 0.5;
/// Sine of an angle below which a direction along the wall's normal cannot be made parallel to it.
const STEEP: f64 = 0.1;
/// Force of the wall that counts as contact [N].
const CONTACT_FORCE: f64 = 0.01;
/// Sine below which an axis is undefined.
const PARALLEL: f64 = 1e-12;

/// Target of the capsule: `vrcaps.actuation.capsule_target.CapsuleTarget`.
#[derive(FromPyObject)]
pub struct CapsuleTarget {
    position: [f64; 3],
    direction: Option<[f64; 3]>,
    tangent: Option<[f64; 3]>,
    wall_normal: [f64; 3],
    parallel_to_wall: bool,
    on_planned_wall: bool,
}

/// Limits of `vrcaps.actuation.magnet_controller.ControllerGains`: maximum speeds [m/s, rad/s] of
/// the reference and its maximum distances [m, rad] from the capsule.
#[derive(FromPyObject)]
pub struct ReferenceLimits {
    speed: f64,
    angular_speed: f64,
    lookahead: f64,
    lookahead_angle: f64,
}

/// Pose that the capsule is to follow.
struct Reference {
    /// Position [m].
    position: DVec3,
    /// Viewing direction.
    direction: DVec3,
    /// Outward normal of the wall under the capsule.
    wall_normal: DVec3,
}

impl CapsuleTarget {
    /// Component of a vector in the directions in which the position is controlled.
    fn along_controlled_axes(&self, v: DVec3) -> DVec3 {
        let part = |axis: DVec3| axis * axis.dot(v);
        self.tangent
            .map_or_else(|| v - part(self.wall_normal.into()), |tangent| part(tangent.into()))
    }
}

impl Reference {
    /// Position after `dt` [s], limited by its speed and by its lookahead of the capsule at `at`.
    fn position_after(
        &self,
        at: DVec3,
        target: &CapsuleTarget,
        s: &ReferenceLimits,
        dt: f64,
    ) -> DVec3 {
        let off = self.position - at;
        let lag = target.along_controlled_axes(off);
        // Slow in other directions: to follow at once would cancel the field's stiffness.
        let across = (off - lag)
            * if target.on_planned_wall { 1.0 } else { 1.0 - (dt / TIME_CONSTANT).min(1.0) };
        // It follows a sliding capsule at its own speed only: the field moves the capsule back.
        let most = s.speed * dt;
        let back = (lag - lag.clamp_length_max(s.lookahead)).clamp_length_max(most);
        let place = at + lag - back + across;
        let offset = DVec3::from(target.position) - place;
        place
            + if target.on_planned_wall { offset } else { target.along_controlled_axes(offset) }
                .clamp_length_max(most)
    }

    /// Direction after a time `dt` [s], for a capsule that looks along `axis`.
    fn direction_after(
        &self,
        axis: DVec3,
        target: &CapsuleTarget,
        s: &ReferenceLimits,
        dt: f64,
    ) -> DVec3 {
        let ahead = target.direction.map_or(axis, DVec3::from);
        let flat = ahead - self.wall_normal * self.wall_normal.dot(ahead);
        let is_flat = target.parallel_to_wall && flat.length() > STEEP;
        let ahead = if is_flat { flat.normalize() } else { ahead };
        let about = target.wall_normal.into();
        let led = towards(axis, self.direction, s.lookahead_angle, about);
        towards(led, ahead, s.angular_speed * dt, about)
    }

    /// Wall normal after a time `dt` [s]: that of the contact, or the target's without contact.
    fn wall_normal_after(&self, contact: DVec3, target: &CapsuleTarget, dt: f64) -> DVec3 {
        let felt = contact.length() > CONTACT_FORCE && !target.on_planned_wall;
        let contact_normal = if felt { -contact.normalize() } else { target.wall_normal.into() };
        let side = self.wall_normal.lerp(contact_normal, (dt / TIME_CONSTANT).min(1.0));
        side / side.length().max(1e-9)
    }
}

/// Reference [3 3]; pose [4 4] of a capsule at the reference; position error in the controlled
/// directions [m]; rotation axis times its sine and angle [rad] to the reference; true if the
/// contact force is on the wrong wall.
type Advanced<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    f64,
    bool,
);

/// Advances a reference, rows of position [m], direction and wall normal, by `dt` [s], for a
/// capsule at a pose [4 4] with a contact force [N].
#[pyfunction]
pub fn advance_reference<'py>(
    py: Python<'py>,
    reference: PyReadonlyArray2<'py, f64>,
    capsule: PyReadonlyArray2<'py, f64>,
    contact: [f64; 3],
    target: CapsuleTarget,
    gains: ReferenceLimits,
    dt: f64,
) -> PyResult<Advanced<'py>> {
    let now = three_rows(&reference)?;
    let now = Reference { position: now.x_axis, direction: now.y_axis, wall_normal: now.z_axis };
    let ((rotation, at), contact) = (read_pose(&capsule)?, DVec3::from(contact));
    let axis = rotation.z_axis;
    let next = Reference {
        position: now.position_after(at, &target, &gains, dt),
        direction: now.direction_after(axis, &target, &gains, dt),
        wall_normal: now.wall_normal_after(contact, &target, dt),
    };
    let bend = axis.cross(next.direction);
    let angle = bend.length().atan2(axis.dot(next.direction));
    let turn = if bend.length() > PARALLEL { angle * bend.normalize() } else { DVec3::ZERO };
    let led = DMat3::from_cols(next.position, next.direction, next.wall_normal).to_cols_array_2d();
    let flat = pose_rows(&rotate(turn, rotation), next.position);
    let pose = [0, 4, 8, 12].map(|k| [flat[k], flat[k + 1], flat[k + 2], flat[k + 3]]);
    let error = target.along_controlled_axes(next.position - at);
    Ok((
        PyArray2::from_owned_array(py, arr2(&led)),
        PyArray2::from_owned_array(py, arr2(&pose)),
        PyArray1::from_slice(py, &error.to_array()),
        PyArray1::from_slice(py, &bend.to_array()),
        angle,
        contact.dot(target.wall_normal.into()) > CONTACT_FORCE,
    ))
}
