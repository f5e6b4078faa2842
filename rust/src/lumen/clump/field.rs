//! Field around each particle of a clump.

use crate::lumen::spheres::Sphere;
use crate::mucosa::noise::uniform;
use crate::simd::f32x64::*;

/// Distance beyond its radius at which a particle of a clump shapes the surface, in radii: κ.
const BLEND: f32 = 0.5;
/// Reach of a particle of a clump, in radii.
pub const REACH: f32 = 1.0 + BLEND;
/// Value of the field at the center of a particle: α, for a field of 1 at its radius.
pub const PEAK: f32 = 1.0 / (1.0 - 1.0 / (REACH * REACH));
/// Relative amplitude of the bumps of the field: b.
const BUMP: f32 = 0.28;
/// Directions of the waves whose mean forms the bumps, times their periods per reach.
const WAVES: [Vec3; 3] = [[0.94, 0.47, -0.46], [-0.44, 1.08, 0.41], [0.39, -0.41, 1.29]];

/// Phases of the bumps of a particle or of the ripple of a bubble, by its index.
pub fn phases(number: u32) -> Vec3 {
    [0, 1, 2].map(|k| uniform(0x57_00_11, number, k))
}

/// A smoothed triangle wave, with period 1 and values from −1 to 1, and its slope.
#[inline(always)]
pub fn wave(x: f32) -> (f32, f32) {
    // Adding 1.5 · 2²³ rounds to an integer.
    let u = x - ((x + 12_582_912.0) - 12_582_912.0);
    (8.0 * u * (1.0 - 2.0 * u.abs()), 8.0 * (1.0 - 4.0 * u.abs()))
}

/// The field of one particle.
pub struct Field {
    center: Vec3,
    /// Inverse of the reach [1/m].
    pub inverse: f32,
    phases: Vec3,
}

impl Field {
    /// Field of a particle.
    #[inline(always)]
    pub fn of(sphere: &Sphere) -> Self {
        Field { center: sphere.center, inverse: 1.0 / sphere.reach, phases: sphere.phases }
    }

    /// Value at a point.
    #[inline(always)]
    pub fn at(&self, point: Vec3) -> f32 {
        let offset = scale(sub(point, self.center), self.inverse);
        let bumps = [0, 1, 2].map(|k| wave(dot(offset, WAVES[k]) + self.phases[k]).0);
        let inside = max(1.0 - dot(offset, offset), 0.0);
        PEAK * inside * (1.0 + BUMP / 3.0 * (bumps[0] + bumps[1] + bumps[2]))
    }

    /// The field and its gradient [1/m].
    #[inline(always)]
    pub fn gradient(&self, point: Vec3) -> (f32, Vec3) {
        let offset = scale(sub(point, self.center), self.inverse);
        let inside = max(1.0 - dot(offset, offset), 0.0);
        let (mut bumps, mut slope) = (1.0, [0.0; 3]);
        for k in 0..3 {
            let (value, rise) = wave(dot(offset, WAVES[k]) + self.phases[k]);
            bumps += BUMP / 3.0 * value;
            slope = add(slope, scale(WAVES[k], BUMP / 3.0 * rise));
        }
        let along = sub(scale(slope, inside), scale(offset, 2.0 * bumps));
        (PEAK * inside * bumps, scale(along, PEAK * self.inverse))
    }
}
