//! BSDF sampling: directions drawn from the lobes of the reflectance, with values and densities.

use crate::render::material::{
    Angles, Clearcoat, Material, Surface, clearcoat_fresnel, fresnel, ggx, gloss_alpha, scatter,
    smith,
};
use crate::simd::f32x64::*;
use std::f32::consts::PI;

/// Random numbers 0 ≤ x < 1 that choose a lobe and a direction in it, for each lane.
pub struct BsdfRandom {
    /// Chooses the lobe.
    pub lobe: Lane,
    /// Choose the direction.
    pub direction: [Lane; 2],
}

/// A BSDF sample for each lane.
pub struct BsdfSample {
    /// Unit directions away from the surface.
    pub direction: Lane3,
    /// Reflectance times cosine over the density of the direction; 0 below the horizon.
    pub weight: Lane3,
    /// Part of the weight that comes from the gloss lobes.
    pub gloss: Lane,
    /// Density of the direction [1/sr].
    pub pdf: Lane,
}

/// Probabilities of the lobes.
struct LobeProbabilities {
    gloss: f32,
    clearcoat_lobe: f32,
}

impl LobeProbabilities {
    /// Approximately in proportion to the light that each lobe reflects.
    #[inline(always)]
    fn new(albedo: Vec3, cos_view: f32, material: &Material) -> Self {
        let base = max((albedo[0] + albedo[1] + albedo[2]) * (1.0 / 3.0), 0.05);
        let gloss = fresnel(cos_view, material.ior);
        let clearcoat_lobe = material.clearcoat * clearcoat_fresnel(cos_view);
        let inverse = 1.0 / (base + gloss + clearcoat_lobe);
        LobeProbabilities { gloss: gloss * inverse, clearcoat_lobe: clearcoat_lobe * inverse }
    }
}

/// Probability that lane `i` samples the diffuse base.
#[inline(always)]
pub fn base_probability(surface: &Surface, material: &Material, i: usize) -> f32 {
    let cos_view = max(dot(at(&surface.view, i), at(&surface.normal, i)), 1e-4);
    let probabilities = LobeProbabilities::new(at(&surface.albedo, i), cos_view, material);
    1.0 - probabilities.gloss - probabilities.clearcoat_lobe
}

/// Samples a direction about a unit normal in proportion to its cosine; returns it and its cosine.
#[inline(always)]
pub fn cosine_direction(normal: Vec3, [u, v]: [f32; 2]) -> (Vec3, f32) {
    let ([right, up], (cosine, sine)) = (frame(normal), circle(u));
    let own = on_circle(v.sqrt(), (1.0 - v).sqrt(), cosine, sine);
    let along = add(scale(right, own[0]), scale(up, own[1]));
    (normalize(add(along, scale(normal, own[2]))), own[2])
}

/// Samples a direction for each lane from the mixture of the lobes.
///
/// The density is that of the whole mixture, so that the peak of one lobe never meets a small
/// density of another: the one-sample balance heuristic (Veach 1997, section 9.2.4).
#[inline(always)]
pub fn sample_bsdf(surface: &Surface, material: &Material, random: &BsdfRandom) -> BsdfSample {
    let clearcoat = Clearcoat::new(material);
    let square = material.clearcoat_alpha * material.clearcoat_alpha;
    let logarithm = log2(square);
    let (direction, weight) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
    let mut out = BsdfSample { direction, weight, gloss: [0.0; LANES], pdf: [0.0; LANES] };
    for i in 0..LANES {
        let (normal, view) = (at(&surface.normal, i), at(&surface.view, i));
        let (albedo, roughness) = (at(&surface.albedo, i), surface.roughness[i]);
        let alpha = gloss_alpha(roughness);
        let [right, up] = frame(normal);
        let own_view = [dot(view, right), dot(view, up), dot(view, normal)];
        let cos_view = max(own_view[2], 1e-4);
        let probabilities = LobeProbabilities::new(albedo, cos_view, material);

        let (u, v) = (random.direction[0][i], random.direction[1][i]);
        let (cosine, sine) = circle(u);
        let base = on_circle(v.sqrt(), (1.0 - v).sqrt(), cosine, sine);
        let gloss = visible_normal(own_view, alpha, v, cosine, sine);
        let height = (1.0 - exp2((1.0 - v) * logarithm)) / (1.0 - square);
        let clearcoat_lobe = on_circle(max(1.0 - height, 0.0).sqrt(), height.sqrt(), cosine, sine);
        let lobe = random.lobe[i];
        let half = select(lobe < probabilities.gloss, gloss, clearcoat_lobe);
        let mirrored = sub(scale(half, 2.0 * dot(half, own_view)), own_view);
        let own = select(lobe < probabilities.gloss + probabilities.clearcoat_lobe, mirrored, base);
        let along = add(scale(right, own[0]), scale(up, own[1]));
        let direction = normalize(add(along, scale(normal, own[2])));

        let angles = Angles::new(normal, view, direction);
        let (colored, plain) = scatter::<false>(&angles, 0.0, roughness, material, &clearcoat);
        let pdf = pdf(&angles, alpha, &probabilities, &clearcoat);
        let is_above = angles.light > 0.0;
        let inverse = if is_above { 1.0 / pdf } else { 0.0 };
        out.pdf[i] = pdf;
        out.gloss[i] = plain * inverse;
        for k in 0..3 {
            out.direction[k][i] = direction[k];
            out.weight[k][i] = (albedo[k] * colored + plain) * inverse;
        }
    }
    out
}

/// BSDF values for light from one unit direction per lane; 0 below the horizon.
pub struct BsdfValue {
    /// Reflectance of the base times cosine [1/sr].
    pub base: Lane3,
    /// Reflectance of gloss and clearcoat times cosine [1/sr].
    pub gloss: Lane,
    /// Density with which `sample_bsdf` draws the direction [1/sr].
    pub pdf: Lane,
}

/// Evaluates the BSDF for light from unit directions.
#[inline(always)]
pub fn evaluate_bsdf(surface: &Surface, material: &Material, directions: &Lane3) -> BsdfValue {
    let clearcoat = Clearcoat::new(material);
    let (base, gloss, pdf) = ([[0.0; LANES]; 3], [0.0; LANES], [0.0; LANES]);
    let mut out = BsdfValue { base, gloss, pdf };
    for i in 0..LANES {
        let (normal, view) = (at(&surface.normal, i), at(&surface.view, i));
        let (albedo, roughness) = (at(&surface.albedo, i), surface.roughness[i]);
        let angles = Angles::new(normal, view, at(directions, i));
        let probabilities = LobeProbabilities::new(albedo, angles.view, material);
        let (colored, plain) = scatter::<false>(&angles, 0.0, roughness, material, &clearcoat);
        let is_above = angles.light > 0.0;
        let drawn = self::pdf(&angles, gloss_alpha(roughness), &probabilities, &clearcoat);
        out.pdf[i] = if is_above { drawn } else { 0.0 };
        out.gloss[i] = if is_above { plain } else { 0.0 };
        for k in 0..3 {
            out.base[k][i] = if is_above { albedo[k] * colored } else { 0.0 };
        }
    }
    out
}

/// Density of a direction above the horizon [1/sr].
#[inline(always)]
fn pdf(
    angles: &Angles,
    alpha: f32,
    probabilities: &LobeProbabilities,
    clearcoat: &Clearcoat,
) -> f32 {
    let base = angles.light * (1.0 / PI);
    let gloss = ggx(angles.half, alpha) * smith(angles.view, alpha) / (4.0 * angles.view);
    let clearcoat_lobe =
        clearcoat.density(angles.half) * angles.half / (4.0 * max(angles.difference, 1e-4));
    (1.0 - probabilities.gloss - probabilities.clearcoat_lobe) * base
        + probabilities.gloss * gloss
        + probabilities.clearcoat_lobe * clearcoat_lobe
}

/// Two unit vectors that form a right-handed frame with a unit normal (Duff et al. 2017).
#[inline(always)]
pub fn frame([x, y, z]: Vec3) -> [Vec3; 2] {
    let sign = 1.0f32.copysign(z);
    let a = -1.0 / (sign + z);
    let b = x * y * a;
    [[1.0 + sign * x * x * a, sign * b, -sign * x], [b, sign + y * y * a, -y]]
}

/// Samples a visible microfacet normal (Dupuy and Benyoub 2023, spherical caps).
#[inline(always)]
fn visible_normal(view: Vec3, alpha: f32, v: f32, cosine: f32, sine: f32) -> Vec3 {
    let round = normalize([alpha * view[0], alpha * view[1], view[2]]);
    let z = (1.0 - v) * (1.0 + round[2]) - round[2];
    let cap = on_circle(max(1.0 - z * z, 0.0).sqrt(), z, cosine, sine);
    let half = add(cap, round);
    normalize([alpha * half[0], alpha * half[1], max(half[2], 1e-9)])
}

#[inline(always)]
pub fn on_circle(radius: f32, z: f32, cosine: f32, sine: f32) -> Vec3 {
    [radius * cosine, radius * sine, z]
}

#[inline(always)]
fn select(first: bool, a: Vec3, b: Vec3) -> Vec3 {
    [0, 1, 2].map(|k| if first { a[k] } else { b[k] })
}

/// Cosine and sine of `u` turns, 0 ≤ u < 1, with errors below 1e-6.
#[inline(always)]
pub fn circle(u: f32) -> (f32, f32) {
    let turn = if u > 0.5 { u - 1.0 } else { u };
    let size = turn.abs();
    let folded = if size > 0.25 { 0.5 - size } else { size };
    (sine_of_turn(0.25 - size), sine_of_turn(folded.copysign(turn)))
}

/// sin 2πx for |x| ≤ ¼, by its Taylor series.
#[inline(always)]
fn sine_of_turn(x: f32) -> f32 {
    let y = 2.0 * PI * x;
    let s = y * y;
    let tail = 1.0 / 5040.0 + s * (-1.0 / 362_880.0 + s * (1.0 / 39_916_800.0));
    y * (1.0 + s * (-1.0 / 6.0 + s * (1.0 / 120.0 - s * tail)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::path::sobol::{hash, point};

    const MATERIALS: [Material; 2] = [
        Material { ior: 1.0, clearcoat: 0.0, clearcoat_alpha: 0.1 },
        Material { ior: 1.4, clearcoat: 0.7, clearcoat_alpha: 0.1 },
    ];

    fn slanted(cos_view: f32, roughness: f32) -> Surface {
        let normal = normalize([0.3, -0.5, 0.2]);
        let [right, up] = frame(normal);
        let across = (1.0 - cos_view * cos_view).sqrt();
        let along = add(scale(right, 0.6 * across), scale(up, 0.8 * across));
        let view = add(along, scale(normal, cos_view));
        let all = |v: Vec3| v.map(|x| [x; LANES]);
        Surface {
            position: all([0.0; 3]),
            normal: all(normal),
            view: all(view),
            albedo: all([0.8, 0.5, 0.2]),
            roughness: [roughness; LANES],
        }
    }

    #[test]
    fn circle_agrees_with_the_standard_library() {
        for k in 0..10_000 {
            let u = k as f32 * 1e-4;
            let angle = 2.0 * std::f64::consts::PI * f64::from(u);
            let (c, s) = circle(u);
            assert!((f64::from(c) - angle.cos()).abs() < 1e-6, "{u}");
            assert!((f64::from(s) - angle.sin()).abs() < 1e-6, "{u}");
        }
    }

    /// The mean weight is the reflected fraction of light: by quadrature over the hemisphere.
    #[test]
    fn mean_weight_is_the_integral_of_the_reflectance() {
        for material in &MATERIALS {
            for (cos_view, roughness) in [(1.0, 0.5), (0.8, 0.35), (0.5, 0.9), (0.15, 0.5)] {
                let surface = slanted(cos_view, roughness);
                let drawn = mean_weight(&surface, material);
                let [r, g, b] = integral(&surface, material);
                for (k, expected) in [r, g, b].into_iter().enumerate() {
                    let error = (drawn[k] / expected - 1.0).abs();
                    assert!(error < 5e-3, "{cos_view} {roughness} {drawn:?} {expected}");
                }
            }
        }
    }

    /// ∫ density over the hemisphere is the fraction of samples above the horizon.
    #[test]
    fn density_is_that_of_the_draws() {
        let material = &MATERIALS[1];
        for (cos_view, roughness) in [(0.9, 0.3), (0.3, 0.6)] {
            let surface = slanted(cos_view, roughness);
            let (normal, view) = (at(&surface.normal, 0), at(&surface.view, 0));
            let probabilities = LobeProbabilities::new(at(&surface.albedo, 0), cos_view, material);
            let (alpha, clearcoat) = (gloss_alpha(roughness), Clearcoat::new(material));
            // Octants about the normal, by the sides of the view and of a slanted direction.
            let cell = |d: Vec3| usize::from(dot(d, view) > 0.7) + 2 * usize::from(d[0] > 0.0);
            let (mut expected, mut counted) = ([0.0; 4], [0.0; 4]);
            over_hemisphere(normal, 400, |d, area| {
                let angles = Angles::new(normal, view, d);
                expected[cell(d)] +=
                    f64::from(pdf(&angles, alpha, &probabilities, &clearcoat)) * area;
            });
            let count = 1 << 9;
            for index in 0..count {
                let out = sample_bsdf(&surface, material, &randoms(index));
                for i in (0..LANES).filter(|&i| out.weight[0][i] > 0.0) {
                    counted[cell(at(&out.direction, i))] += 1.0 / (count as usize * LANES) as f64;
                }
            }
            for k in 0..4 {
                assert!((expected[k] - counted[k]).abs() < 4e-3, "{expected:?} {counted:?}");
            }
        }
    }

    fn randoms(index: u32) -> BsdfRandom {
        let mut random = BsdfRandom { lobe: [0.0; LANES], direction: [[0.0; LANES]; 2] };
        for i in 0..LANES {
            let number = index * LANES as u32 + i as u32;
            [random.direction[0][i], random.direction[1][i]] = point(hash(7), number);
            random.lobe[i] = point(hash(8), number)[0];
        }
        random
    }

    fn mean_weight(surface: &Surface, material: &Material) -> [f64; 3] {
        let (count, mut sum) = (1 << 9, [0.0; 3]);
        for index in 0..count {
            let out = sample_bsdf(surface, material, &randoms(index));
            for k in 0..3 {
                sum[k] += out.weight[k].iter().map(|&w| f64::from(w)).sum::<f64>();
            }
        }
        sum.map(|s| s / (count as usize * LANES) as f64)
    }

    fn integral(surface: &Surface, material: &Material) -> [f64; 3] {
        let (normal, view) = (at(&surface.normal, 0), at(&surface.view, 0));
        let clearcoat = Clearcoat::new(material);
        let mut sum = [0.0; 3];
        over_hemisphere(normal, 500, |direction, area| {
            let angles = Angles::new(normal, view, direction);
            let (colored, plain) =
                scatter::<false>(&angles, 0.0, surface.roughness[0], material, &clearcoat);
            for k in 0..3 {
                sum[k] += f64::from(surface.albedo[k][0] * colored + plain) * area;
            }
        });
        sum
    }

    fn over_hemisphere(normal: Vec3, steps: usize, mut visit: impl FnMut(Vec3, f64)) {
        let [right, up] = frame(normal);
        let area = 2.0 * std::f64::consts::PI / (steps * steps) as f64;
        for z in (0..steps).map(|k| (k as f32 + 0.5) / steps as f32) {
            let radius = (1.0 - z * z).sqrt();
            for turn in (0..steps).map(|k| (k as f32 + 0.5) / steps as f32) {
                let (c, s) = circle(turn);
                let across = add(scale(right, radius * c), scale(up, radius * s));
                visit(add(across, scale(normal, z)), area);
            }
        }
    }
}
