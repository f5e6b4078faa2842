//! Rim of a bubble, where light from liquid is totally reflected, and the shade inside it.

use super::bubble::Film;
use crate::lumen::clump::wave;
use crate::lumen::spheres::Sphere;
use crate::simd::f32x64::{clamp, max, min};

/// Loss of light of the wall below the middle of a bubble, relative to that next to its rim; chosen
/// by eye.
const MIDDLE: f32 = 0.35;

/// Width of the dark part of a bubble within its rim, as a fraction of the radius.
const DARK: f32 = 0.5;

/// Ripple at which variations around a bubble have their full amplitude.
const TYPICAL: f32 = 0.22;

/// Radius of a bubble that takes half as much light from the wall below as a large one [m].
///
/// Small bubbles are bright in capsule images; chosen by eye.
const BRIGHT: f32 = 0.15e-3;

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
    /// Scale of the loss of light of the wall below.
    shade: f32,
    /// Part of the outline that pixels resolve.
    outline: f32,
    /// Amplitude of variations around the bubble.
    uneven: f32,
}

impl Rim {
    /// Rim of a bubble, given half a pixel as a fraction of its radius.
    ///
    /// The rim of a bubble that emerges is the meniscus between its film and the wall. The width of
    /// a meniscus with a radius of curvature r around a sphere of radius R is of the order of √(r R).
    #[inline(always)]
    pub fn new(film: &Film, sphere: &Sphere, blur: f32) -> Self {
        let (radius, sunk) = (sphere.radius, film.sunk(sphere));
        let uneven = min(film.ripple / TYPICAL, 1.0);
        let width = film.border * sunk;
        let soft = max(0.25 * width, blur);
        let seen = min(width / soft, 1.0);
        // Some bubbles darken the wall below less than others.
        let clear = 0.3 * uneven * (1.0 - wave(sphere.phases[2]).0);
        Rim {
            width,
            per_width: 1.0 / width,
            narrow: 1.0 / (width + blur),
            soft,
            per_soft: 0.5 / soft,
            gleam: film.gleam * seen,
            outline: seen,
            shade: film.shade * sunk * (1.0 - clear) * radius / (radius + BRIGHT),
            uneven,
        }
    }

    /// Reflection of the rim and relative radiance of the wall below at a distance from the edge.
    ///
    /// Width and reflection differ around a bubble, and the shade within it, with the waves of its
    /// ripple; at both edges of the rim, light is refracted elsewhere.
    #[inline(always)]
    pub fn at(&self, edge: f32, waves: [f32; 2]) -> (f32, f32) {
        let waves = waves.map(|wave| self.uneven * wave);
        let edge = edge * (1.0 + 0.6 * waves[0]);
        let inside = edge - self.width;
        let inner = smooth((inside + self.soft) * self.per_soft);
        let place = min(edge * self.per_width, 1.0);
        let ridge = 4.0 * place * (1.0 - place);
        let profile = (0.3 + 0.7 * ridge * ridge) * (0.7 + 0.6 * waves[1]);
        let near = bump(inside / DARK);
        let outline = self.outline * bump(2.5 * edge * self.narrow);
        let loss = (MIDDLE + (1.0 - MIDDLE) * near) * (1.0 + 0.55 * waves[1]);
        let shade = self.shade * (inner * loss + outline);
        (self.gleam * min(profile, 1.0) * (1.0 - inner), 1.0 - min(shade, 1.0))
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
