//! Reflection of an LED's light by the wall: the Disney principled model (Burley 2012) with a
//! diffuse base, a dielectric GGX lobe and a clearcoat.

use crate::simd::f32x64::*;
use crate::wall::packet::MISS;
use std::f32::consts::PI;

/// Reflectance that is the same all over the wall.
#[derive(Clone, Copy)]
pub struct Material {
    /// Refractive index of the base relative to the lumen.
    pub ior: f32,
    /// Strength of the clearcoat, 0 to 1.
    pub clearcoat: f32,
    /// Roughness α of the clearcoat's GTR1 lobe.
    pub clearcoat_alpha: f32,
}

/// An LED in the frame of the wall.
#[derive(Clone, Copy)]
pub struct Led {
    /// Place [m].
    pub position: Vec3,
    /// Unit direction of its axis.
    pub direction: Vec3,
    /// Radiant intensity on its axis [W/sr] for red, green, blue.
    pub intensity: Vec3,
    /// Exponent of its angular lobe.
    pub exponent: f32,
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
    /// The surface without its base where it is a wall, whose light goes through the tissue.
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

/// Adds the radiance [W/(sr·m²)] that an LED's light leaves towards the viewer.
#[inline(always)]
pub fn add_light(
    surface: &Surface,
    material: &Material,
    led: &Led,
    lit: &[bool; LANES],
    radiance: &mut Lane3,
) {
    let Reflection { diffuse, specular, mut lobe } = reflect(surface, material, led);
    if led.exponent != 1.0 {
        for i in 0..LANES {
            lobe[i] = if led.exponent == 0.0 { 1.0 } else { pow(lobe[i], led.exponent) };
        }
    }
    for i in 0..LANES {
        let power = if lit[i] { lobe[i] } else { 0.0 };
        for k in 0..3 {
            radiance[k][i] +=
                led.intensity[k] * power * (surface.albedo[k][i] * diffuse[i] + specular[i]);
        }
    }
}

/// Adds the radiance [W/(sr·m²)] that an LED's light leaves on tissue without absorption, by what
/// passes its interface: of this refractive index, and of diffuse light this share.
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
struct Reflection {
    /// Reflected radiance per radiant intensity [1/m²], the part colored by the base; holds the
    /// cosine at the surface and the inverse square of the distance, as does the next.
    diffuse: Lane,
    /// The part that is not colored.
    specular: Lane,
    /// Cosine of the angle at which the light leaves the LED, at least 0.
    lobe: Lane,
}

#[inline(always)]
fn reflect(surface: &Surface, material: &Material, led: &Led) -> Reflection {
    let (mut diffuse, mut specular, mut lobe) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
    let clearcoat = Clearcoat::new(material);
    for i in 0..LANES {
        let offset = sub(led.position, at(&surface.position, i));
        let square = max(dot(offset, offset), 1e-12);
        let light = scale(offset, 1.0 / square.sqrt());
        let angles = Angles::new(at(&surface.normal, i), at(&surface.view, i), light);
        let (base, rest) = scatter(&angles, surface.roughness[i], material, &clearcoat);
        let falloff = if angles.light > 0.0 { 1.0 / square } else { 0.0 };
        diffuse[i] = base * falloff;
        specular[i] = rest * falloff;
        lobe[i] = clamp(-dot(light, led.direction), 0.0, 1.0);
    }
    Reflection { diffuse, specular, lobe }
}

/// Cosines between the directions of one reflection; the half vector lies between view and light.
pub struct Angles {
    /// Normal and view, at least a trifle.
    pub view: f32,
    /// Normal and light.
    pub light: f32,
    /// Normal and half vector.
    pub half: f32,
    /// View and half vector.
    pub difference: f32,
}

impl Angles {
    /// Of unit vectors.
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
/// the part that is not. Only where the light is above the surface.
#[inline(always)]
pub fn scatter(
    angles: &Angles,
    roughness: f32,
    material: &Material,
    clearcoat: &Clearcoat,
) -> (f32, f32) {
    let retro = 2.0 * roughness * angles.difference * angles.difference;
    let (fl, fv) = (schlick(angles.light), schlick(angles.view));
    let base = (1.0 - 0.5 * fl) * (1.0 - 0.5 * fv) + retro * (fl + fv + fl * fv * (retro - 1.0));
    let alpha = gloss_alpha(roughness);
    let gloss = fresnel(angles.difference, material.ior)
        * ggx(angles.half, alpha)
        * smith(angles.view, alpha)
        * smith(angles.light, alpha)
        / (4.0 * angles.view);
    let clearcoat_lobe = clearcoat.reflect(angles) * angles.light;
    (base * angles.light * (1.0 / PI), gloss + clearcoat_lobe)
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

/// Density of micro-normals (Trowbridge and Reitz; Walter et al. 2007, eq. 33).
#[inline(always)]
pub fn ggx(cosine: f32, alpha: f32) -> f32 {
    let square = cosine * cosine;
    let spread = (1.0 - square) / (alpha * alpha) + square;
    1.0 / (PI * alpha * alpha * spread * spread)
}

/// Share of micro-facets not masked from one direction (Walter et al. 2007, eq. 34).
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
    fn reflect(&self, angles: &Angles) -> f32 {
        const ALPHA: f32 = 0.25;
        self.strength
            * clearcoat_fresnel(angles.difference)
            * self.density(angles.half)
            * smith(angles.view, ALPHA)
            * smith(angles.light, ALPHA)
    }

    /// Density of its micro-normals (GTR1).
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
