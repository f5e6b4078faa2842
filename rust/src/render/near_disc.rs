//! Light of an LED's disc where means over the whole disc fail: diffuse light on nearby surfaces,
//! and highlights of an obliquely visible disc.

use crate::render::led::{Led, SAMPLES, disc_samples, sample_lane};
use crate::render::material::{
    Angles, Clearcoat, Material, Reflection, Surface, diffuse_lobe, scatter,
};
use crate::simd::f32x64::*;

/// Squared ratio of an LED's radius to its distance above which diffuse light is a sum over samples
/// of its disc; and the same if the disc extends below the surface's horizon.
pub const NEAR: f32 = 0.1;
const NEAR_HORIZON: f32 = 0.002;

/// Product of the cosine of the LED's angle and that between view and half vector below which a
/// highlight is stretched.
const ROUND: f32 = 0.8;
/// Radius of a highlight summed over parts of the disc, in radii of the disc's half vectors.
const HIGHLIGHT: f32 = 2.0;
/// Spread of a disc's half vectors, in widths of the lobe, below which a circle is accurate.
const WIDE: f32 = 0.3;
/// Factor on samples so that their parts of the disc together have its second moment: each part
/// itself has a sixteenth of it.
const PARTS: f32 = 0.968;

/// True if the mean of a lobe over the half vectors of a disc, taken as a circle, fails: they fill
/// an ellipse, are wider than the lobe of width `alpha`, and are near the normal.
///
/// `ratio` is the squared ratio of the disc's radius to its distance, `cosine` that of the angle to
/// the LED's axis.
#[inline(always)]
pub fn is_stretched(angles: &Angles, ratio: f32, cosine: f32, alpha: f32) -> bool {
    let difference = max(angles.difference, 0.1);
    let reach = 0.5 * ratio.sqrt() / difference;
    let limit = HIGHLIGHT * reach + alpha;
    let square_sine = 1.0 - angles.half * angles.half;
    (angles.light > 0.0)
        & (cosine * difference < ROUND)
        & (reach > WIDE * alpha)
        & (square_sine < limit * limit)
}

/// Sums stretched highlights over parts of the LED's disc, whose means are those of circles.
#[inline(always)]
pub fn stretched_highlights(
    surface: &Surface,
    material: &Material,
    led: &Led,
    out: &mut Reflection,
) {
    if !out.is_stretched.contains(&true) {
        return;
    }
    let (starts, clearcoat) = (disc_samples(led, 0), Clearcoat::new(material));
    let places: [Vec3; SAMPLES] = std::array::from_fn(|number| {
        add(led.position, scale(at(&starts, sample_lane(number)), PARTS))
    });
    for i in 0..LANES {
        if !out.is_stretched[i] {
            continue;
        }
        let (position, normal) = (at(&surface.position, i), at(&surface.normal, i));
        let (view, roughness) = (at(&surface.view, i), surface.roughness[i]);
        let mut parts = [0.0; SAMPLES];
        for (part, place) in parts.iter_mut().zip(&places) {
            let offset = sub(*place, position);
            let square = max(dot(offset, offset), 1e-10);
            let light = scale(offset, 1.0 / square.sqrt());
            let angles = Angles::new(normal, view, light);
            let cosine = clamp(-dot(light, led.direction), 0.0, 1.0);
            let spread = led.half_vectors(square, cosine, angles.difference) / SAMPLES as f32;
            let (_, gloss) = scatter::<true>(&angles, spread, roughness, material, &clearcoat);
            let is_above = angles.light > 0.0;
            *part = if is_above { gloss * led.lobe(cosine) / square } else { 0.0 };
        }
        let sum: f32 = parts.iter().sum();
        out.specular[i] = sum / (SAMPLES as f32 * led.lobe(max(out.lobe[i], 1e-6)));
    }
}

/// Sums the diffuse light of an LED whose disc is near a surface, or partly below its horizon, over
/// samples of the disc; returns the factor on it, given the visible fraction.
///
/// The surface itself blocks rays from below the horizon, so the visible fraction is relative to
/// the part of the disc above it.
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

/// Diffuse reflection of an LED's disc, including the lobe, and the fraction of the disc above the
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
