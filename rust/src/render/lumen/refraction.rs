//! Intersection of a ray with a liquid's level surface; refraction (Snell's law) or reflection.

use crate::render::material::fresnel;
use crate::simd::f32x64::*;

/// `Turn::kind` of a ray that continues straight.
pub const STRAIGHT: u8 = 0;
/// `Turn::kind` of a ray that is refracted.
pub const REFRACTED: u8 = 1;
/// `Turn::kind` of a ray that is totally reflected.
pub const REFLECTED: u8 = 2;

/// Turns of a tile's rays in level surfaces.
pub struct Turn {
    /// Continuation of each lane.
    pub kind: [u8; LANES],
    /// Distance to the surface [m]; infinite without a hit.
    pub distance: Lane,
    /// Intersection [m].
    pub place: Lane3,
    /// Unit direction in which the ray continues.
    pub heading: Lane3,
    /// Fraction of light that the surface reflects.
    pub reflectance: Lane,
}

impl Turn {
    /// No lane hits a surface.
    pub fn none() -> Self {
        let zero = [0.0; LANES];
        Turn {
            kind: [STRAIGHT; LANES],
            distance: [f32::INFINITY; LANES],
            place: [zero; 3],
            heading: [zero; 3],
            reflectance: zero,
        }
    }

    /// Turns lane `i` at a level; `ior` is the index beyond the surface relative to that before it.
    #[inline(always)]
    pub fn set(&mut self, i: usize, origin: Vec3, direction: Vec3, level: f32, ior: f32) {
        let distance = (level - origin[2]) / direction[2];
        let [x, y, z] = direction;
        let inverse = 1.0 / ior;
        // The squared cosine beyond the surface, by Snell's law; negative for total reflection.
        let square = 1.0 - (1.0 - z * z) * inverse * inverse;
        let is_through = square > 0.0;
        let heading = if is_through {
            normalize([x * inverse, y * inverse, square.sqrt().copysign(z)])
        } else {
            [x, y, -z]
        };
        self.kind[i] = if is_through { REFRACTED } else { REFLECTED };
        self.reflectance[i] = if is_through { fresnel(z.abs(), ior) } else { 1.0 };
        self.distance[i] = distance;
        for k in 0..3 {
            self.place[k][i] = origin[k] + distance * direction[k];
            self.heading[k][i] = heading[k];
        }
        // Exactly level, regardless of the rounding of the distance.
        self.place[2][i] = level;
    }

    /// Lanes that hit a surface.
    #[inline(always)]
    pub fn lanes(&self) -> [bool; LANES] {
        let mut lanes = [false; LANES];
        for i in 0..LANES {
            lanes[i] = self.kind[i] != STRAIGHT;
        }
        lanes
    }

    /// Lanes of one kind.
    #[inline(always)]
    pub fn are(&self, kind: u8) -> [bool; LANES] {
        let mut lanes = [false; LANES];
        for i in 0..LANES {
            lanes[i] = self.kind[i] == kind;
        }
        lanes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn turned(direction: Vec3, ior: f32) -> Turn {
        let mut turn = Turn::none();
        turn.set(0, [0.01, -0.02, 0.0], normalize(direction), -0.3 * direction[2].signum(), ior);
        turn
    }

    #[test]
    fn sines_are_as_the_indices() {
        for slant in [0.0f32, 0.2, 0.7, 1.5, 4.0] {
            for ior in [1.333f32, 1.0 / 1.333] {
                for side in [1.0, -1.0] {
                    let direction = normalize([0.6 * slant, 0.8 * slant, side]);
                    let turn = turned(direction, ior);
                    let [x, y, z] = at(&turn.heading, 0);
                    let sine = (1.0 - direction[2] * direction[2]).max(0.0).sqrt();
                    if sine / ior > 1.0 {
                        assert_eq!(turn.kind[0], REFLECTED);
                        let [u, v, w] = direction;
                        assert!((x - u).abs().max((y - v).abs()).max((z + w).abs()) < 1e-6);
                        continue;
                    }
                    assert_eq!(turn.kind[0], REFRACTED);
                    assert!(((x * x + y * y).sqrt() * ior - sine).abs() < 1e-6);
                    assert!((x * x + y * y + z * z - 1.0).abs() < 1e-6);
                    assert!(z * side > 0.0);
                }
            }
        }
    }
}
