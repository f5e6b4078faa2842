//! Rim of a bubble, where light from liquid is totally reflected, and the shade inside it.

use super::bubble::Film;
use crate::simd::f32x64::{clamp, max, min};

/// Rim of a bubble; lengths are fractions of its radius.
pub struct Rim {
    width: f32,
    /// Inverse of the width.
    per_width: f32,
    /// Inverse of the width in the image.
    narrow: f32,
    /// Half the width of its inner edge.
    soft: f32,
    /// Inverse of the width of its inner edge.
    per_soft: f32,
    /// Maximum reflection.
    gleam: f32,
    /// Mean loss of light of the wall below the middle.
    shade: f32,
}

impl Rim {
    /// Rim of a bubble, given its part in liquid and half a pixel as a fraction of its radius.
    ///
    /// The rim of a bubble that emerges is the meniscus between its film and the wall. The width of
    /// a meniscus with a radius of curvature r around a sphere of radius R is of the order of √(r R).
    #[inline(always)]
    pub fn new(film: &Film, sunk: f32, blur: f32) -> Self {
        let width = film.border * sunk;
        let soft = max(0.25 * width, blur);
        Rim {
            width,
            per_width: 1.0 / width,
            narrow: 1.0 / (width + blur),
            soft,
            per_soft: 0.5 / soft,
            gleam: film.gleam * min(width / soft, 1.0),
            shade: film.shade * sunk,
        }
    }

    /// Reflection of the rim and relative radiance of the wall below at a distance from the edge.
    ///
    /// Width and reflection differ around a bubble, and the shade within it, with the waves of its
    /// ripple; at both edges of the rim, light is refracted elsewhere.
    #[inline(always)]
    pub fn at(&self, edge: f32, waves: [f32; 2]) -> (f32, f32) {
        let edge = edge * (1.0 + 0.3 * waves[0]);
        let inside = edge - self.width;
        let inner = smooth((inside + self.soft) * self.per_soft);
        let place = min(edge * self.per_width, 1.0);
        let ridge = 4.0 * place * (1.0 - place);
        let profile = (0.3 + 0.7 * ridge * ridge) * (0.75 + 0.25 * waves[1]);
        let (outline, near) = (bump(2.5 * edge * self.narrow), bump(1.1 * inside * self.narrow));
        let mottle = 0.3 * waves[0] * waves[1] * near;
        let shade = self.shade * (inner * (0.4 + 0.8 * near + mottle) + outline);
        (self.gleam * profile * (1.0 - inner), 1.0 - min(shade, 1.0))
    }
}

/// Smooth bump from 1 at 0 to 0 at ±1.
#[inline(always)]
fn bump(x: f32) -> f32 {
    let rest = max(1.0 - x * x, 0.0);
    rest * rest
}

/// Smooth step from 0 at 0 to 1 at 1.
#[inline(always)]
fn smooth(x: f32) -> f32 {
    let x = clamp(x, 0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}
