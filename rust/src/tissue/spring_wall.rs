//! Spring wall: a spring and a damper at each vertex near a contact (Incetan et al., Med. Image
//! Anal. 70, 2021, Deformation).

use crate::simd::f64x8::{LANES, Lane3};
use glam::DVec3;

/// Parameters of the spring wall.
#[derive(Clone, Copy)]
pub struct SpringWall {
    /// Distance d₀ at which the force has decreased to a half [m].
    pub length: f64,
    /// Distance from a contact beyond which the force is zero [m].
    pub reach: f64,
    /// Mass of a vertex [kg].
    pub mass: f64,
    /// Stiffness of the spring of a vertex [N/m].
    pub spring: f64,
    /// Damping μ of a vertex's velocity [1/s].
    pub damping: f64,
}

/// Contact force on the spring wall.
#[derive(Clone, Copy)]
pub struct ContactForce {
    /// Point of application [m].
    pub center: DVec3,
    /// Force on the wall [N].
    pub force: DVec3,
}

/// Displacement and velocity of one vertex.
#[derive(Clone, Copy, Default, PartialEq)]
pub struct VertexMotion {
    /// Displacement from the position without contact [m].
    pub displacement: DVec3,
    /// Velocity [m/s].
    pub velocity: DVec3,
}

/// Displacement [m] and velocity [m/s] below which a vertex without load is at rest.
const STILL: (f64, f64) = (1e-8, 1e-7);

impl SpringWall {
    /// Compliance of a vertex over a time `h` [s] without inertia, by backward Euler [m/N].
    pub fn give(&self, h: f64) -> f64 {
        h / (self.mass * self.damping + h * self.spring)
    }

    /// Advances a vertex by one step: force, spring, damping, then motion.
    #[inline(always)]
    pub fn advance(&self, vertex: &mut VertexMotion, force: DVec3, dt: f64) {
        let spring = self.spring * vertex.displacement;
        vertex.velocity += (force - spring) * (dt / self.mass);
        vertex.velocity *= 1.0 - self.damping * dt;
        vertex.displacement += vertex.velocity * dt;
    }
}

/// Forces on eight vertices at each of `places`: for each contact, `F / (1 + (d/d₀)²)`.
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
    /// True if the vertex is at rest, to a hundredth of a micrometer.
    pub fn is_still(&self) -> bool {
        self.displacement.abs().max_element() < STILL.0
            && self.velocity.abs().max_element() < STILL.1
    }
}
