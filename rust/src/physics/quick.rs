//! Quick deformation: vertices near a contact are pushed, sprung back and damped
//! (Incetan et al., Med. Image Anal. 70, 2021, Deformation).

use glam::DVec3;

/// Parameters of the quick model.
#[derive(Clone, Copy)]
pub struct Quick {
    /// Length d₀ at which the push has fallen to a half [m].
    pub length: f64,
    /// Distance from a contact beyond which nothing is pushed [m].
    pub reach: f64,
    /// Mass of a vertex [kg].
    pub mass: f64,
    /// Spring that brings a vertex back [N/m].
    pub spring: f64,
    /// Damping μ of a vertex's velocity [1/s].
    pub damping: f64,
}

/// A contact as the quick model sees it.
#[derive(Clone, Copy)]
pub struct Push {
    /// Where [m].
    pub center: DVec3,
    /// Force on the wall [N].
    pub force: DVec3,
}

/// Displacement and velocity of one vertex.
#[derive(Clone, Copy, Default, PartialEq)]
pub struct Yield {
    /// From where the vertex would be untouched [m].
    pub displacement: DVec3,
    /// [m/s].
    pub velocity: DVec3,
}

/// Below these a vertex with no push on it counts as back at rest [m], [m/s].
const STILL: (f64, f64) = (1e-8, 1e-7);

impl Quick {
    /// Force on a vertex: each push, attenuated as `F / (1 + (d/d₀)²)`.
    #[inline(always)]
    pub fn attenuated(&self, place: DVec3, pushes: &[Push]) -> DVec3 {
        let (scale, reach) = (1.0 / (self.length * self.length), self.reach * self.reach);
        let mut force = DVec3::ZERO;
        for push in pushes {
            let square = (place - push.center).length_squared();
            let weight = if square < reach { 1.0 / (1.0 + square * scale) } else { 0.0 };
            force += weight * push.force;
        }
        force
    }

    /// One step of a vertex: push, spring back, damp, move.
    #[inline(always)]
    pub fn advance(&self, vertex: &mut Yield, force: DVec3, dt: f64) {
        let spring = self.spring * vertex.displacement;
        vertex.velocity += (force - spring) * (dt / self.mass);
        vertex.velocity *= 1.0 - self.damping * dt;
        vertex.displacement += vertex.velocity * dt;
    }
}

impl Yield {
    /// Whether the vertex is back at rest, to a hundredth of a micrometre.
    pub fn is_still(&self) -> bool {
        self.displacement.abs().max_element() < STILL.0
            && self.velocity.abs().max_element() < STILL.1
    }
}
