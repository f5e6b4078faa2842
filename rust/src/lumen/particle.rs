//! One sphere in the lumen: its constant properties and its state.

use glam::DVec3;

/// Fraction of the speed of approach after a bounce.
pub const BOUNCE: f64 = 0.3;

/// Constant properties of a sphere.
pub struct Kind {
    /// Radius [m].
    pub radius: f64,
    /// True for a bubble, false for a piece of chyme.
    pub is_bubble: bool,
    /// Initial position, at which a new one forms after it bursts [m].
    pub home: DVec3,
    /// Arc length of the initial position along the gut [m].
    pub home_arc: f64,
    /// Height of its center above the wall while it adheres [m].
    pub height: f64,
}

/// Position and motion of a sphere.
#[derive(Clone, Copy)]
pub struct ParticleState {
    /// Center [m].
    pub position: DVec3,
    /// Velocity [m/s].
    pub velocity: DVec3,
    /// Arc length along the gut [m].
    pub arc_length: f64,
    /// Position on the capsule to which it is attached, in its frame about its center of mass [m];
    /// 0 if it is not attached.
    pub site: DVec3,
}

#[cfg(test)]
impl Kind {
    /// A sphere at an initial position.
    pub fn new(radius: f64, is_bubble: bool, home: DVec3) -> Self {
        Kind { radius, is_bubble, home, home_arc: 0.0, height: radius }
    }
}

impl ParticleState {
    /// State at rest at the initial position.
    pub fn at_home(kind: &Kind) -> Self {
        let (velocity, site) = (DVec3::ZERO, DVec3::ZERO);
        ParticleState { position: kind.home, velocity, arc_length: kind.home_arc, site }
    }

    /// True if it is attached to the capsule.
    pub fn sits(&self) -> bool {
        self.site != DVec3::ZERO
    }
}
