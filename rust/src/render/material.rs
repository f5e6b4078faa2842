//! Reflection of an LED's light by the wall: the Disney principled model (Burley 2012) with a
//! diffuse base, a dielectric GGX lobe and a clearcoat.

use crate::render::led::Led;
use crate::render::near_disc::{NEAR, is_stretched, near_discs, stretched_highlights};
use crate::simd::f32x64::*;
use crate::wall::packet::MISS;
use std::f32::consts::PI;

/// Reflectance parameters that are uniform over the wall.
#[derive(Clone, Copy)]
pub struct Material {
    /// Refractive index of the base relative to the lumen.
    pub ior: f32,
    /// Strength of the clearcoat, 0 to 1.
    pub clearcoat: f32,
    /// Roughness α of the clearcoat's GTR1 lobe.
    pub clearcoat_alpha: f32,
}

/// Surfaces hit by a tile's rays, ready for shading.
#[derive(Clone)]
pub struct Surface {
    /// Points [m].
    pub position: Lane3,
    /// Unit normals with relief, on the viewer's side.
    pub normal: Lane3,
    /// Unit directions to the viewer.
    pub view: Lane3,
    /// Linear base color.
    pub albedo: Lane3,
    /// Perceptual roughness.
    pub roughness: Lane,
}

impl Surface {
    /// The surface without base on the wall, where that light passes through the tissue.
    #[inline(always)]
    pub fn without_base(&self, triangles: &[u32; LANES]) -> Surface {
        let mut without_base = self.clone();
        for albedo in &mut without_base.albedo {
            for i in 0..LANES {
                albedo[i] = if triangles[i] == MISS { albedo[i] } else { 0.0 };
            }
        }
        without_base
    }
}

/// Adds the radiance [W/(sr·m²)] that an LED's light leaves towards the viewer; `visible` is the
/// visible fraction of the LED.
#[inline(always)]
pub fn add_light(
    surface: &Surface,
    material: &Material,
    led: &Led,
    visible: &Lane,
    radiance: &mut Lane3,
) {
    let mut reflection = if led.radius > 0.0 {
        reflect::<true>(surface, material, led)
    } else {
        reflect::<false>(surface, material, led)
    };
    let share = if led.radius > 0.0 {
        stretched_highlights(surface, material, led, &mut reflection);
        near_discs(surface, led, &mut reflection, visible)
    } else {
        [1.0; LANES]
    };
    let Reflection { diffuse, specular, mut lobe, .. } = reflection;
    if led.exponent != 1.0 {
        for i in 0..LANES {
            lobe[i] = if led.exponent == 0.0 { 1.0 } else { pow(lobe[i], led.exponent) };
        }
    }
    for i in 0..LANES {
        let (power, diffuse) = (lobe[i] * visible[i], diffuse[i] * share[i]);
        for k in 0..3 {
            radiance[k][i] +=
                led.intensity[k] * power * (surface.albedo[k][i] * diffuse + specular[i]);
        }
    }
}

/// Adds the radiance [W/(sr·m²)] that an LED's light leaves on tissue without absorption, after
/// transmission by its interface, given its refractive index and its diffuse transmittance.
#[inline(always)]
pub fn add_leaving(
    surface: &Surface,
    (ior, entering): (f32, f32),
    led: &Led,
    radiance: &mut Lane3,
) {
    for i in 0..LANES {
        let offset = sub(led.position, at(&surface.position, i));
        let square = max(dot(offset, offset), 1e-12);
        let light = scale(offset, 1.0 / square.sqrt());
        let cosine = clamp(dot(at(&surface.normal, i), light), 0.0, 1.0);
        let axis = clamp(-dot(light, led.direction), 0.0, 1.0);
        let lobe = if led.exponent == 0.0 { 1.0 } else { pow(axis, led.exponent) };
        let passes = (1.0 - fresnel(max(cosine, 1e-6), ior)) * cosine;
        let weight = passes * lobe / (PI * entering * square);
        for k in 0..3 {
            radiance[k][i] += led.intensity[k] * weight;
        }
    }
}

/// Reflection of one LED's light by the wall.
pub struct Reflection {
    /// Reflected radiance per radiant intensity [1/m²], colored by the base; includes the cosine at
    /// the surface and the inverse squared distance, as does `specular`.
    pub diffuse: Lane,
    /// The part that the base does not color.
    pub specular: Lane,
    /// Cosine of the angle between the LED's axis and the light, at least 0.
    pub lobe: Lane,
    /// `true` for points in a highlight that is not round, see `is_stretched`.
    pub is_stretched: [bool; LANES],
}

#[inline(always)]
fn reflect<const IS_DISC: bool>(surface: &Surface, material: &Material, led: &Led) -> Reflection {
    let (mut diffuse, mut specular, mut lobe) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
    let mut stretched = [false; LANES];
    let clearcoat = Clearcoat::new(material);
    let square_radius = led.radius * led.radius;
    for i in 0..LANES {
        let offset = sub(led.position, at(&surface.position, i));
        let square = max(dot(offset, offset), 1e-12);
        let light = scale(offset, 1.0 / square.sqrt());
        let normal = at(&surface.normal, i);
        let angles = Angles::new(normal, at(&surface.view, i), light);
        let cosine = clamp(-dot(light, led.direction), 0.0, 1.0);
        let spread =
            if IS_DISC { led.half_vectors(square, cosine, angles.difference) } else { 0.0 };
        let (mut base, rest) =
            scatter::<IS_DISC>(&angles, spread, surface.roughness[i], material, &clearcoat);
        if IS_DISC {
            let ratio = min(square_radius / square, NEAR);
            base *= disc_mean(ratio, led, (dot(normal, led.direction), angles.light), cosine);
            let alpha = min(gloss_alpha(surface.roughness[i]), material.clearcoat_alpha);
            stretched[i] = is_stretched(&angles, square_radius / square, cosine, alpha);
        }
        let falloff = if angles.light > 0.0 { 1.0 / square } else { 0.0 };
        diffuse[i] = base * falloff;
        specular[i] = rest * falloff;
        lobe[i] = cosine;
    }
    Reflection { diffuse, specular, lobe, is_stretched: stretched }
}

/// Mean irradiance over an LED's disc, relative to that of a point at its center.
///
/// From a point of the disc a surface receives cosᵐφ cosθ/d², which depends on the point by
/// (n·l)/|l|^(m+3) times constants. This is the mean of its Taylor series up to the second order in
/// radius over distance, whose square is `ratio`; `cosine` is cos φ, and the normal is given by its
/// scalar products with the LED's axis and with the direction to the LED.
#[inline(always)]
fn disc_mean(ratio: f32, led: &Led, (axis, light): (f32, f32), cosine: f32) -> f32 {
    let power = 0.5 * (led.exponent + 3.0);
    let across = 0.5 * power * (power + 1.0) * (1.0 - cosine * cosine);
    let tilt = 0.5 * power * (1.0 + axis * cosine / max(light, 0.1));
    clamp(1.0 + ratio * (across - 0.5 * power - tilt), 0.5, 2.0)
}

/// Cosines between the directions of one reflection; the half vector bisects view and light.
pub struct Angles {
    /// Normal and view, clamped to a small positive value.
    pub view: f32,
    /// Normal and light.
    pub light: f32,
    /// Normal and half vector.
    pub half: f32,
    /// View and half vector.
    pub difference: f32,
}

impl Angles {
    /// Cosines of unit vectors.
    #[inline(always)]
    pub fn new(normal: Vec3, view: Vec3, light: Vec3) -> Self {
        let half = add(light, view);
        let half = scale(half, 1.0 / max(dot(half, half), 1e-12).sqrt());
        Angles {
            view: max(dot(normal, view), 1e-4),
            light: dot(normal, light),
            half: min(dot(normal, half), 1.0),
            difference: min(dot(view, half), 1.0),
        }
    }
}

/// Roughness α of the base's GGX lobe.
#[inline(always)]
pub fn gloss_alpha(roughness: f32) -> f32 {
    max(roughness * roughness, 1e-3)
}

/// Reflectance times the cosine at the surface [1/sr]: the part that is colored by the base, and
/// the part that is not. Valid only if the light is above the surface.
///
/// `spread` is 0 for light from one direction; for an LED's disc (`IS_DISC`) it is the area of its
/// half vectors over π, see `disc_lobe`.
#[inline(always)]
pub fn scatter<const IS_DISC: bool>(
    angles: &Angles,
    spread: f32,
    roughness: f32,
    material: &Material,
    clearcoat: &Clearcoat,
) -> (f32, f32) {
    let alpha = gloss_alpha(roughness);
    let density =
        if IS_DISC { ggx_disc(angles.half, alpha, spread) } else { ggx(angles.half, alpha) };
    let gloss = fresnel(angles.difference, material.ior)
        * density
        * smith(angles.view, alpha)
        * smith(angles.light, alpha)
        / (4.0 * angles.view);
    let clearcoat_lobe = clearcoat.reflect::<IS_DISC>(angles, spread) * angles.light;
    (diffuse_lobe(angles, roughness), gloss + clearcoat_lobe)
}

/// Diffuse reflectance for an albedo of 1 times the cosine at the surface [1/sr] (Burley 2012).
#[inline(always)]
pub fn diffuse_lobe(angles: &Angles, roughness: f32) -> f32 {
    let retro = 2.0 * roughness * angles.difference * angles.difference;
    let (fl, fv) = (schlick(angles.light), schlick(angles.view));
    let base = (1.0 - 0.5 * fl) * (1.0 - 0.5 * fv) + retro * (fl + fv + fl * fv * (retro - 1.0));
    base * angles.light * (1.0 / PI)
}

/// Weight (1 − cos θ)⁵ of Schlick's Fresnel term (1994).
#[inline(always)]
fn schlick(cosine: f32) -> f32 {
    let m = clamp(1.0 - cosine, 0.0, 1.0);
    let square = m * m;
    square * square * m
}

/// Reflectance of a smooth dielectric for unpolarized light (Fresnel).
#[inline(always)]
pub fn fresnel(cosine: f32, ior: f32) -> f32 {
    let inside = max(1.0 - (1.0 - cosine * cosine) / (ior * ior), 0.0).sqrt();
    let across = (cosine - ior * inside) / (cosine + ior * inside);
    let along = (ior * cosine - inside) / (ior * cosine + inside);
    0.5 * (across * across + along * along)
}

/// Direction beyond a smooth surface of light that a viewer sees along `view`, by Snell's law; along
/// the surface for total reflection.
#[inline(always)]
pub fn refract_into(view: Vec3, normal: Vec3, ior: f32) -> Vec3 {
    let (cosine, inverse) = (dot(view, normal), 1.0 / ior);
    let inside = max(1.0 - (1.0 - cosine * cosine) * inverse * inverse, 0.0).sqrt();
    sub(scale(normal, cosine * inverse - inside), scale(view, inverse))
}

/// Density of microfacet normals (Trowbridge and Reitz; Walter et al. 2007, eq. 33).
#[inline(always)]
pub fn ggx(cosine: f32, alpha: f32) -> f32 {
    let square = cosine * cosine;
    let spread = (1.0 - square) / (alpha * alpha) + square;
    1.0 / (PI * alpha * alpha * spread * spread)
}

/// Terms of the mean of a microfacet lobe over the half vectors of an LED's disc.
struct DiscLobe {
    /// R, the root of (ρ² + α² − s²)² + 4 α² s².
    root: f32,
    /// M = R + α² + s² − ρ².
    sum: f32,
    /// ρ².
    spread: f32,
}

/// Mean of a microfacet lobe over the half vectors of an LED's disc.
///
/// On the plane perpendicular to the normal, the half vectors of a small disc fill an area, taken
/// as a circle of radius ρ at distance s from the normal: π ρ² is the disc's solid angle over 4
/// (v·h), as an element of half vectors is one of light over that (Walter et al. 2007, eq. 14).
/// GTR1 and GGX are the functions 1/(α² + s²) and 1/(α² + s²)² of that plane, with s² times (1 −
/// α²). Their means over the circle have closed forms: the first by integration around circles and
/// over their radii, the second as its derivative by −α².
#[inline(always)]
fn disc_lobe(cos_half: f32, square_alpha: f32, spread: f32) -> DiscLobe {
    let narrow = 1.0 - square_alpha;
    let (square, spread) = (narrow * max(1.0 - cos_half * cos_half, 0.0), narrow * spread);
    let apart = spread + square_alpha - square;
    let root = (apart * apart + 4.0 * square_alpha * square).sqrt();
    DiscLobe { root, sum: max(root + square_alpha + square - spread, 1e-9), spread }
}

/// Mean of `ggx` over a disc of half vectors: 2/(R M) instead of 1/(α² + s²)².
#[inline(always)]
fn ggx_disc(cos_half: f32, alpha: f32, spread: f32) -> f32 {
    let square_alpha = min(alpha * alpha, 0.999);
    let DiscLobe { root, sum, .. } = disc_lobe(cos_half, square_alpha, spread);
    2.0 * square_alpha / (PI * root * sum)
}

/// Fraction of microfacets not masked from one direction (Walter et al. 2007, eq. 34).
#[inline(always)]
pub fn smith(cosine: f32, alpha: f32) -> f32 {
    let square = max(cosine * cosine, 1e-8);
    2.0 / (1.0 + (1.0 + alpha * alpha * (1.0 - square) / square).sqrt())
}

/// The clearcoat of a mucus film: a GTR1 lobe of index 1.5, a quarter as strong as a full layer
/// (Burley 2012, 5.4).
pub struct Clearcoat {
    strength: f32,
    spread: f32,
    scale: f32,
}

impl Clearcoat {
    /// The clearcoat of a material.
    #[inline(always)]
    pub fn new(material: &Material) -> Self {
        let square = material.clearcoat_alpha * material.clearcoat_alpha;
        let logarithm = log2(square) * std::f32::consts::LN_2;
        Clearcoat {
            strength: 0.25 * material.clearcoat,
            spread: square - 1.0,
            scale: (square - 1.0) / (PI * logarithm),
        }
    }

    #[inline(always)]
    fn reflect<const IS_DISC: bool>(&self, angles: &Angles, spread: f32) -> f32 {
        const ALPHA: f32 = 0.25;
        let density = if IS_DISC {
            self.disc_density(angles.half, spread)
        } else {
            self.density(angles.half)
        };
        self.strength
            * clearcoat_fresnel(angles.difference)
            * density
            * smith(angles.view, ALPHA)
            * smith(angles.light, ALPHA)
    }

    /// Mean density of its microfacet normals over a disc of half vectors, see `disc_lobe`: the
    /// mean of 1/(α² + s²) over a disc of radius ρ is ln(1 + x)/ρ², where x = 2 ρ²/M.
    #[inline(always)]
    fn disc_density(&self, cos_half: f32, spread: f32) -> f32 {
        let DiscLobe { sum, spread, .. } = disc_lobe(cos_half, self.spread + 1.0, spread);
        let x = 2.0 * spread / sum;
        let small = 1.0 + x * (-0.5 + x * (1.0 / 3.0));
        let logarithm = log2(1.0 + x) * std::f32::consts::LN_2 / max(x, 1e-20);
        2.0 * self.scale * if x < 1e-2 { small } else { logarithm } / sum
    }

    /// Density of its microfacet normals (GTR1).
    #[inline(always)]
    pub fn density(&self, cos_half: f32) -> f32 {
        self.scale / (1.0 + self.spread * cos_half * cos_half)
    }
}

/// Reflectance of the clearcoat's surface (Schlick 1994).
#[inline(always)]
pub fn clearcoat_fresnel(cosine: f32) -> f32 {
    0.04 + 0.96 * schlick(cosine)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_that_enters_obeys_snell() {
        let normal = normalize([0.2, -0.4, 0.7]);
        let view = normalize([0.5, 0.1, 0.6]);
        let inside = refract_into(view, normal, 1.4);
        let sine = |v: Vec3| dot(cross(v, normal), cross(v, normal)).sqrt();
        assert!((dot(inside, inside) - 1.0).abs() < 1e-5 && dot(inside, normal) < 0.0);
        assert!((sine(view) - 1.4 * sine(inside)).abs() < 1e-5);
        assert!(dot(cross(view, normal), inside).abs() < 1e-6);
    }
}
