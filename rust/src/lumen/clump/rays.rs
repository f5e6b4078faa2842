//! Rays among particles and their hits.

use crate::lumen::spheres::Sphere;
use crate::simd::f32x64::*;
use crate::wall::packet::MISS;

/// Rays with individual origins.
pub struct Beams<'a, const N: usize> {
    /// Origins [m].
    pub starts: &'a [[f32; N]; 3],
    /// Unit directions.
    pub headings: &'a [[f32; N]; 3],
    /// Minimum distance of hits [m].
    pub from: &'a [f32; N],
}

/// Hits of rays on particles.
#[derive(Clone)]
pub struct Met<const N: usize> {
    /// Index in `Spheres::all` of the particle that contributes most to the surface at the hit;
    /// `MISS` without a hit.
    pub owner: [u32; N],
    /// Unit normals, outwards.
    pub normal: [[f32; N]; 3],
    /// Linear base color: the weighted mean over the particles that form the surface.
    pub color: [[f32; N]; 3],
}

impl<const N: usize> Met<N> {
    /// No hits.
    #[inline(always)]
    pub fn nothing() -> Self {
        Met { owner: [MISS; N], normal: [[0.0; N]; 3], color: [[0.0; N]; 3] }
    }

    /// Sets a lane to a point of a sphere.
    #[inline(always)]
    pub fn put_ball(&mut self, lane: usize, sphere: &Sphere, index: u32, point: Vec3) {
        self.owner[lane] = index;
        for k in 0..3 {
            self.normal[k][lane] = (point[k] - sphere.center[k]) / sphere.radius;
            self.color[k][lane] = sphere.color[k];
        }
    }

    /// Copies a lane of other hits to a lane.
    #[inline(always)]
    pub fn take<const M: usize>(&mut self, lane: usize, (other, theirs): (&Met<M>, usize)) {
        self.owner[lane] = other.owner[theirs];
        for k in 0..3 {
            self.normal[k][lane] = other.normal[k][theirs];
            self.color[k][lane] = other.color[k][theirs];
        }
    }
}

/// Distances at which rays enter and leave the reach of a particle [m]; −1 for rays that miss it.
#[inline(always)]
pub fn reached<const N: usize>(sphere: &Sphere, beams: &Beams<'_, N>) -> [[f32; N]; 2] {
    let (square, mut ways) = (sphere.reach * sphere.reach, [[-1.0; N]; 2]);
    for i in 0..N {
        let heading = at(beams.headings, i);
        let offset = sub(sphere.center, at(beams.starts, i));
        let along = dot(offset, heading);
        // The foot of the perpendicular: exact also for a small sphere far away.
        let foot = sub(offset, scale(heading, along));
        let apart = dot(foot, foot);
        let half = max(square - apart, 0.0).sqrt();
        ways[0][i] = if apart < square { along - half } else { -1.0 };
        ways[1][i] = if apart < square { along + half } else { -1.0 };
    }
    ways
}
