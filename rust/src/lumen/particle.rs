//! One sphere in the lumen: what does not change about it, and its state.

use glam::DVec3;

/// Share of the speed of approach that is left after a bounce.
pub const BOUNCE: f64 = 0.3;

/// What does not change about a sphere.
pub struct Kind {
    /// [m].
    pub radius: f64,
    /// Whether it is a bubble; else a piece of chyme.
    pub is_bubble: bool,
    /// Where it was put at first, and where another one forms when it bursts [m].
    pub home: DVec3,
    /// Arc length of that place along the gut [m].
    pub home_arc: f64,
    /// Height of its center over the wall while it clings [m].
    pub height: f64,
}

/// Where a sphere is and how it moves.
#[derive(Clone, Copy)]
pub struct ParticleState {
    /// Center [m].
    pub position: DVec3,
    /// [m/s].
    pub velocity: DVec3,
    /// Along the gut [m].
    pub arc_length: f64,
    /// Where it sits on the capsule, in its frame about its center of mass [m]; 0 for one that
    /// does not.
    pub site: DVec3,
}

#[cfg(test)]
impl Kind {
    /// A sphere at a place.
    pub fn new(radius: f64, is_bubble: bool, home: DVec3) -> Self {
        Kind { radius, is_bubble, home, home_arc: 0.0, height: radius }
    }
}

impl ParticleState {
    /// At rest where it was put at first.
    pub fn at_home(kind: &Kind) -> Self {
        let (velocity, site) = (DVec3::ZERO, DVec3::ZERO);
        ParticleState { position: kind.home, velocity, arc_length: kind.home_arc, site }
    }

    /// Whether it sits on the capsule.
    pub fn sits(&self) -> bool {
        self.site != DVec3::ZERO
    }
}
