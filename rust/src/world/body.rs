//! Capsule as a rigid body: a cylinder with hemispherical ends, of any mass and inertia.

use super::solve::{Symmetric6, Twist};
use crate::simd::f64x8::{max, min};
use glam::{DMat3, DQuat, DVec3};

/// Constant properties of the capsule. The origin of the capsule frame is the center of mass.
#[derive(Clone)]
pub struct Body {
    /// Mass [kg].
    pub mass: f64,
    /// Principal moments of inertia about the center of mass [kg·m²].
    pub moments: DVec3,
    /// Rotation from the principal frame to the capsule frame.
    pub principal: DQuat,
    /// Middle of the cylinder in the capsule frame [m].
    pub center: DVec3,
    /// Half the length of the cylinder's straight part [m].
    pub half_axis: f64,
    /// Radius of cylinder and ends [m].
    pub radius: f64,
}

/// Pose and velocity of the capsule.
#[derive(Clone, Copy, Default)]
pub struct Motion {
    /// Center of mass [m].
    pub position: DVec3,
    /// Rotation from the capsule frame to the wall's.
    pub rotation: DQuat,
    /// Velocity of the center of mass [m/s].
    pub velocity: DVec3,
    /// Angular velocity, in the wall's frame [rad/s].
    pub angular_velocity: DVec3,
}

impl Motion {
    /// True if all components are finite.
    pub fn is_finite(&self) -> bool {
        let (linear, angular) = (self.velocity, self.angular_velocity);
        self.position.is_finite()
            && self.rotation.is_finite()
            && linear.is_finite()
            && angular.is_finite()
    }
}

/// Segment between the centers of the hemispherical ends.
#[derive(Clone, Copy)]
pub struct Axis {
    /// First end [m].
    pub start: DVec3,
    /// Vector from the first end to the other [m].
    pub span: DVec3,
    /// One over the squared length of `span`; 0 for a sphere.
    pub inverse_square: f64,
}

impl Axis {
    /// Segment from one end and the vector to the other [m].
    pub fn new(start: DVec3, span: DVec3) -> Self {
        let square = span.length_squared();
        Axis { start, span, inverse_square: if square > 0.0 { 1.0 / square } else { 0.0 } }
    }

    /// Vector from the nearest point of the axis to `p`.
    #[inline(always)]
    pub fn offset(&self, p: [f64; 3]) -> [f64; 3] {
        let (start, span) = (self.start.to_array(), self.span.to_array());
        let q = [p[0] - start[0], p[1] - start[1], p[2] - start[2]];
        let along = (q[0] * span[0] + q[1] * span[1] + q[2] * span[2]) * self.inverse_square;
        let along = min(max(along, 0.0), 1.0);
        [q[0] - along * span[0], q[1] - along * span[1], q[2] - along * span[2]]
    }

    /// Point of the axis nearest to `p`.
    #[inline(always)]
    pub fn nearest(&self, p: DVec3) -> DVec3 {
        let along = ((p - self.start).dot(self.span) * self.inverse_square).clamp(0.0, 1.0);
        self.start + self.span * along
    }
}

impl Body {
    /// Axis of the body in motion `m`.
    pub fn axis(&self, m: &Motion) -> Axis {
        let span = m.rotation * DVec3::new(0.0, 0.0, 2.0 * self.half_axis);
        Axis::new(m.position + m.rotation * self.center - 0.5 * span, span)
    }

    /// Inertia about the center of mass, in the wall's frame [kg·m²].
    pub fn inertia(&self, rotation: DQuat) -> DMat3 {
        let axes = DMat3::from_quat(rotation * self.principal);
        axes * DMat3::from_diagonal(self.moments) * axes.transpose()
    }

    /// Mass and inertia as one matrix.
    pub fn mass_matrix(&self, rotation: DQuat) -> Symmetric6 {
        let inertia = self.inertia(rotation);
        let mut matrix = Symmetric6::default();
        for row in 0..3 {
            matrix.0[row][row] = self.mass;
            for column in 0..=row {
                matrix.0[3 + row][3 + column] = inertia.col(column)[row];
            }
        }
        matrix
    }

    /// Kinetic energy [J].
    pub fn kinetic_energy(&self, m: &Motion) -> f64 {
        let spin = (m.rotation * self.principal).inverse() * m.angular_velocity;
        0.5 * (self.mass * m.velocity.length_squared() + (self.moments * spin).dot(spin))
    }

    /// Integrates the motion over a time `dt` after a change of twist.
    ///
    /// The center of mass moves at the mean of old and new velocity, so that a constant force gives
    /// its exact parabola and its work equals the gain of kinetic energy. The free rotation
    /// conserves angular momentum: it is split into rotations about the principal axes (Dullweber,
    /// Leimkuhler, McLachlan, J. Chem. Phys. 107, 1997).
    pub fn drift(&self, m: &mut Motion, change: Twist, dt: f64) {
        m.position += dt * (m.velocity + 0.5 * change.linear);
        m.velocity += change.linear;
        let inertia = self.inertia(m.rotation);
        let before = inertia * m.angular_velocity;
        let after = before + inertia * change.angular;
        let mut frame = m.rotation * self.principal;
        let mut momentum = frame.inverse() * (0.5 * (before + after));
        for (axis, share) in [(0, 0.5), (1, 0.5), (2, 1.0), (1, 0.5), (0, 0.5)] {
            let angle = share * dt * momentum[axis] / self.moments[axis];
            let (sine, cosine) = libm::sincos(0.5 * angle);
            let turn = DQuat::from_vec4((DVec3::AXES[axis] * sine).extend(cosine));
            frame *= turn;
            momentum = turn.inverse() * momentum;
        }
        frame = frame.normalize();
        m.rotation = (frame * self.principal.inverse()).normalize();
        m.angular_velocity = frame * ((frame.inverse() * after) / self.moments);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn body() -> Body {
        Body {
            mass: 3e-3,
            moments: DVec3::new(2.1e-7, 1.9e-7, 5e-8),
            principal: DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 0.3),
            center: DVec3::new(0.0, 0.0, 1e-3),
            half_axis: 7e-3,
            radius: 5.5e-3,
        }
    }

    #[test]
    fn free_flight_keeps_momentum_and_energy() {
        let body = body();
        let mut m = Motion {
            position: DVec3::ZERO,
            rotation: DQuat::from_rotation_y(0.4),
            velocity: DVec3::new(0.1, -0.2, 0.05),
            angular_velocity: DVec3::new(8.0, -5.0, 11.0),
        };
        let energy = body.kinetic_energy(&m);
        let momentum = body.inertia(m.rotation) * m.angular_velocity;
        for _ in 0..20_000 {
            body.drift(&mut m, Twist::default(), 5e-5);
        }
        assert!((body.kinetic_energy(&m) / energy - 1.0).abs() < 1e-6);
        let now = body.inertia(m.rotation) * m.angular_velocity;
        assert!((now - momentum).length() < 1e-9 * momentum.length());
        assert!((m.position - DVec3::new(0.1, -0.2, 0.05)).length() < 1e-12);
    }
}
