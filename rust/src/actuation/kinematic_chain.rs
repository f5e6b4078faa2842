//! Chain of revolute joints by Denavit-Hartenberg parameters, in Craig's convention.

use crate::poses::pose_rows;
use glam::{DMat3, DVec3};

/// Rigid pose: p ↦ rotation p + position.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    /// Rotation to the outer frame.
    pub rotation: DMat3,
    /// Origin in the outer frame [m].
    pub position: DVec3,
}

impl Pose {
    /// Composition with a pose in this frame.
    #[inline]
    pub fn then(&self, inner: &Pose) -> Pose {
        Pose {
            rotation: self.rotation * inner.rotation,
            position: self.rotation * inner.position + self.position,
        }
    }

    /// Rows of the 4 × 4 matrix.
    pub fn rows(&self) -> [f64; 16] {
        pose_rows(&self.rotation, self.position)
    }

    /// Inverse pose.
    pub fn inverse(&self) -> Pose {
        let rotation = self.rotation.transpose();
        Pose { rotation, position: -(rotation * self.position) }
    }
}

/// Joint: `T = Rot_x(α) Trans_x(a) Rot_z(θ) Trans_z(d)` from the previous frame, or from a fixed
/// pose in that frame.
#[derive(Clone, Copy, Debug)]
pub struct Joint {
    /// Length of the previous link [m].
    pub a: f64,
    /// Offset along the joint's axis [m].
    pub d: f64,
    /// Twist of the previous link [rad].
    pub alpha: f64,
    /// Angle offset of the joint [rad].
    pub theta: f64,
    /// Minimum and maximum angle [rad].
    pub limits: (f64, f64),
    /// Fixed pose in the previous frame from which these parameters start, if any.
    pub placement: Option<Pose>,
    sin_alpha: f64,
    cos_alpha: f64,
}

/// Sine and cosine, exact at multiples of a right angle.
fn sin_cos(angle: f64) -> (f64, f64) {
    let turns = angle / std::f64::consts::FRAC_PI_2;
    if (turns - turns.round()).abs() < 1e-12 {
        let table = [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)];
        return table[(turns.round() as i64).rem_euclid(4) as usize];
    }
    angle.sin_cos()
}

impl Joint {
    /// Joint with its parameters.
    pub fn new(a: f64, d: f64, alpha: f64, theta: f64, limits: (f64, f64)) -> Self {
        let (sin_alpha, cos_alpha) = sin_cos(alpha);
        Joint { a, d, alpha, theta, limits, placement: None, sin_alpha, cos_alpha }
    }

    /// Pose of the joint's frame in the previous frame.
    #[inline]
    pub fn pose(&self, angle: f64) -> Pose {
        let (s, c) = (angle + self.theta).sin_cos();
        let (sa, ca) = (self.sin_alpha, self.cos_alpha);
        let pose = Pose {
            rotation: DMat3::from_cols(
                DVec3::new(c, s * ca, s * sa),
                DVec3::new(-s, c * ca, c * sa),
                DVec3::new(0.0, -sa, ca),
            ),
            position: DVec3::new(self.a, -sa * self.d, ca * self.d),
        };
        self.placement.map_or(pose, |placement| placement.then(&pose))
    }
}

/// Arm: its joints, then the flange.
#[derive(Clone, Debug)]
pub struct Chain {
    /// Joints, from the base.
    pub joints: Vec<Joint>,
    /// Pose of the flange in the last joint's frame.
    pub flange: Pose,
}

impl Chain {
    /// Writes the poses of all joint frames and of the flange in the base to `out`.
    pub fn frames(&self, angles: &[f64], out: &mut Vec<Pose>) {
        out.clear();
        let mut pose = Pose { rotation: DMat3::IDENTITY, position: DVec3::ZERO };
        for (joint, &angle) in self.joints.iter().zip(angles) {
            pose = pose.then(&joint.pose(angle));
            out.push(pose);
        }
        out.push(pose.then(&self.flange));
    }

    /// Jacobian in the base: velocity of the flange's origin and angular velocity per joint
    /// velocity; six rows, one column per joint, stored by columns.
    pub fn jacobian(&self, frames: &[Pose], out: &mut Vec<[f64; 6]>) {
        out.clear();
        let end = frames[frames.len() - 1].position;
        for frame in &frames[..frames.len() - 1] {
            let axis = frame.rotation.z_axis;
            let v = axis.cross(end - frame.position);
            out.push([v.x, v.y, v.z, axis.x, axis.y, axis.z]);
        }
    }
}
