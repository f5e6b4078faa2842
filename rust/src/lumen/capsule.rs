//! Contact of the capsule with particles: it pushes spheres away, and bubbles settle on its ends.

use super::particle::{BOUNCE, Kind, ParticleState};
use glam::{DQuat, DVec3};

/// Pose and velocity of the capsule, and the impulses on it in a step.
pub struct Capsule {
    /// Centers of the round ends [m].
    pub ends: [DVec3; 2],
    /// Radius of cylinder and ends [m].
    pub radius: f64,
    /// Mass [kg].
    pub mass: f64,
    /// Center of mass [m].
    pub center: DVec3,
    /// Rotation from the capsule's frame.
    pub rotation: DQuat,
    /// Velocity of the center of mass [m/s].
    pub velocity: DVec3,
    /// Angular velocity [rad/s].
    pub spin: DVec3,
    /// Accumulated impulse [N·s].
    pub impulse: DVec3,
    /// Its moment about the center of mass [N·m·s].
    pub moment: DVec3,
}

impl Capsule {
    /// Vector from the nearest point of the axis to `p` [m].
    pub fn offset(&self, p: DVec3) -> DVec3 {
        p - self.foot(p).1
    }

    /// Parameter along the axis of the point nearest to `p`, 0 to 1, and that point.
    fn foot(&self, p: DVec3) -> (f64, DVec3) {
        let [start, end] = self.ends;
        let span = end - start;
        let square = span.length_squared();
        let along =
            if square > 0.0 { ((p - start).dot(span) / square).clamp(0.0, 1.0) } else { 0.0 };
        (along, start + along * span)
    }

    /// Velocity of a point fixed to the capsule [m/s].
    pub fn velocity_at(&self, p: DVec3) -> DVec3 {
        self.velocity + self.spin.cross(p - self.center)
    }

    /// Position of a site in the capsule's frame [m].
    pub fn place(&self, site: DVec3) -> DVec3 {
        self.center + self.rotation * site
    }

    /// Site of a position; inverse of `place`.
    pub fn site(&self, p: DVec3) -> DVec3 {
        self.rotation.inverse() * (p - self.center)
    }

    /// Pushes a sphere out of the capsule, which gets the opposite impulse. Returns true if a
    /// bubble that touches a round end settles there, as decided by `lands`.
    ///
    /// The impulse along the normal n that leaves the fraction e of the speed of approach, J = (1 +
    /// e) n·(v_c − v) m M / (m + M), with the capsule's whole mass M; one that settles cancels the
    /// whole difference, J = (v_c − v) m M / (m + M).
    pub fn meet(
        &mut self,
        kind: &Kind,
        state: &mut ParticleState,
        mass: f64,
        lands: impl Fn() -> bool,
    ) -> bool {
        let (along, foot) = self.foot(state.position);
        let away = state.position - foot;
        let (distance, reach) = (away.length(), self.radius + kind.radius);
        if distance >= reach || distance == 0.0 {
            return false;
        }
        let normal = away / distance;
        state.position = foot + reach * normal;
        let place = foot + self.radius * normal;
        let relative = self.velocity_at(place) - state.velocity;
        let reduced = mass * self.mass / (mass + self.mass);
        let is_end = along == 0.0 || along == 1.0;
        if kind.is_bubble && is_end && lands() {
            self.push(state, mass, place, reduced * relative);
            return true;
        }
        let approach = relative.dot(normal);
        if approach > 0.0 {
            self.push(state, mass, place, (1.0 + BOUNCE) * approach * reduced * normal);
        }
        false
    }

    /// Applies an impulse [N·s] to a sphere at a position, and its opposite to the capsule.
    fn push(&mut self, state: &mut ParticleState, mass: f64, place: DVec3, impulse: DVec3) {
        state.velocity += impulse / mass;
        self.velocity -= impulse / self.mass;
        self.impulse -= impulse;
        self.moment -= (place - self.center).cross(impulse);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MASS: f64 = 1e-6;

    fn capsule() -> Capsule {
        Capsule {
            ends: [DVec3::new(-4e-3, 0.0, 0.0), DVec3::new(4e-3, 0.0, 0.0)],
            radius: 5e-3,
            mass: 3e-3,
            center: DVec3::new(1e-3, 0.0, 0.0),
            rotation: DQuat::from_rotation_z(0.3),
            velocity: DVec3::new(0.05, 0.0, 0.0),
            spin: DVec3::new(0.0, 1.0, 2.0),
            impulse: DVec3::ZERO,
            moment: DVec3::ZERO,
        }
    }

    fn bubble(position: DVec3) -> (Kind, ParticleState) {
        let kind = Kind::new(1e-3, true, position);
        let state = ParticleState::at_home(&kind);
        (kind, state)
    }

    #[test]
    fn a_bubble_settles_on_an_end_only_and_momentum_is_kept() {
        for (place, settles) in
            [(DVec3::new(9.5e-3, 1e-3, 0.0), true), (DVec3::new(0.0, 5.5e-3, 0.0), false)]
        {
            let (mut capsule, (kind, mut state)) = (capsule(), bubble(place));
            assert_eq!(capsule.meet(&kind, &mut state, MASS, || true), settles);
            let sum = capsule.impulse + MASS * state.velocity;
            assert!(sum.length() <= 1e-15 * capsule.impulse.length().max(1.0));
            assert!((capsule.offset(state.position).length() - 6e-3).abs() < 1e-15);
        }
    }

    #[test]
    fn a_seat_is_where_it_was_taken() {
        let (capsule, p) = (capsule(), DVec3::new(9e-3, 2e-3, -1e-3));
        assert!((capsule.place(capsule.site(p)) - p).length() < 1e-17);
    }
}
