//! Diffuse light of an LED's disc on surfaces near it, where an expansion about its center fails.

use crate::render::led::{Led, SAMPLES, disc_samples, sample_lane};
use crate::render::material::{Angles, Reflection, Surface, diffuse_lobe};
use crate::simd::f32x64::*;

/// Square of an LED's radius over that of its distance above which diffuse light is a sum over
/// samples of its disc; and the same where the disc reaches below the surface's horizon.
pub const NEAR: f32 = 0.1;
const NEAR_HORIZON: f32 = 0.002;

/// Sums the diffuse light of an LED whose disc is near a surface, or partly below its horizon, over
/// samples of the disc; returns the factor on it, given the visible fraction.
///
/// Rays from below the horizon are blocked by the surface itself, so the visible fraction counts
/// relative to the part of the disc above it.
#[inline(always)]
pub fn near_discs(surface: &Surface, led: &Led, out: &mut Reflection, visible: &Lane) -> Lane {
    let (mut is_near, mut share) = ([false; LANES], [1.0; LANES]);
    let square_radius = led.radius * led.radius;
    for i in 0..LANES {
        let offset = sub(led.position, at(&surface.position, i));
        let normal = at(&surface.normal, i);
        let (height, across) = (dot(normal, offset), dot(normal, led.direction));
        let crosses = height * height < square_radius * (1.0 - across * across);
        let limit = if crosses { NEAR_HORIZON } else { NEAR };
        is_near[i] = square_radius > limit * dot(offset, offset);
    }
    if !is_near.contains(&true) {
        return share;
    }
    let (sum, above) = sum_of_samples(surface, led);
    for i in 0..LANES {
        if is_near[i] {
            let lobe = led.lobe(max(out.lobe[i], 1e-6));
            out.diffuse[i] = sum[i] / lobe;
            share[i] = 1.0 / max(max(above[i], visible[i]), 1e-6);
        }
    }
    share
}

/// Diffuse reflection of an LED's disc, the lobe included, and the fraction of the disc above the
/// surface's horizon.
#[inline(always)]
fn sum_of_samples(surface: &Surface, led: &Led) -> (Lane, Lane) {
    const SHARE: f32 = 1.0 / SAMPLES as f32;
    let (starts, mut sum, mut above) = (disc_samples(led, 0), [0.0; LANES], [0.0; LANES]);
    for number in 0..SAMPLES {
        let start = add(led.position, at(&starts, sample_lane(number)));
        for i in 0..LANES {
            let offset = sub(start, at(&surface.position, i));
            let square = max(dot(offset, offset), 1e-10);
            let light = scale(offset, 1.0 / square.sqrt());
            let angles = Angles::new(at(&surface.normal, i), at(&surface.view, i), light);
            let lobe = led.lobe(clamp(-dot(light, led.direction), 0.0, 1.0));
            let reflected = diffuse_lobe(&angles, surface.roughness[i]) * lobe / square;
            let is_above = angles.light > 0.0;
            sum[i] += if is_above { SHARE * reflected } else { 0.0 };
            above[i] += if is_above { SHARE } else { 0.0 };
        }
    }
    (sum, above)
}
