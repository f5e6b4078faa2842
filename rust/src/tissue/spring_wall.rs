//! Spring wall (per-vertex spring and damper): vertices near a contact are pushed, sprung back and damped
//! (Incetan et al., Med. Image Anal. 70, 2021, Deformation).

use crate::simd::f64x8::{LANES, Lane3};
use glam::DVec3;

/// Parameters of the spring wall.
#[derive(Clone, Copy)]
pub struct SpringWall {
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

/// A contact as the spring wall sees it.
#[derive(Clone, Copy)]
pub struct ContactForce {
    /// Where [m].
    pub center: DVec3,
    /// Force on the wall [N].
    pub force: DVec3,
}

/// Displacement and velocity of one vertex.
#[derive(Clone, Copy, Default, PartialEq)]
pub struct VertexMotion {
    /// From where the vertex would be untouched [m].
    pub displacement: DVec3,
    /// [m/s].
    pub velocity: DVec3,
}

/// Below these a vertex with no push on it counts as back at rest [m], [m/s].
const STILL: (f64, f64) = (1e-8, 1e-7);

impl SpringWall {
    /// How far a newton moves a vertex in a time `h` [s] without inertia, backward in time [m/N].
    pub fn give(&self, h: f64) -> f64 {
        h / (self.mass * self.damping + h * self.spring)
    }

    /// One step of a vertex: push, spring back, damp, move.
    #[inline(always)]
    pub fn advance(&self, vertex: &mut VertexMotion, force: DVec3, dt: f64) {
        let spring = self.spring * vertex.displacement;
        vertex.velocity += (force - spring) * (dt / self.mass);
        vertex.velocity *= 1.0 - self.damping * dt;
        vertex.displacement += vertex.velocity * dt;
    }
}

/// Force on eight vertices at each of `places`: of each push, `F / (1 + (d/d₀)²)`.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
pub fn attenuate(
    spring_wall: &SpringWall,
    places: &[Lane3],
    contact_forces: &[ContactForce],
    forces: &mut Vec<Lane3>,
) {
    let (scale, reach) =
        (1.0 / (spring_wall.length * spring_wall.length), spring_wall.reach * spring_wall.reach);
    forces.clear();
    for place in places {
        let mut force = [[0.0; LANES]; 3];
        for push in contact_forces {
            let (c, f) = (push.center.to_array(), push.force.to_array());
            for i in 0..LANES {
                let way = [place[0][i] - c[0], place[1][i] - c[1], place[2][i] - c[2]];
                let square = way[0] * way[0] + way[1] * way[1] + way[2] * way[2];
                let share = 1.0 / (1.0 + square * scale);
                let share = if square < reach { share } else { 0.0 };
                for d in 0..3 {
                    force[d][i] += share * f[d];
                }
            }
        }
        forces.push(force);
    }
}

impl VertexMotion {
    /// Whether the vertex is back at rest, to a hundredth of a micrometer.
    pub fn is_still(&self) -> bool {
        self.displacement.abs().max_element() < STILL.0
            && self.velocity.abs().max_element() < STILL.1
    }
}
