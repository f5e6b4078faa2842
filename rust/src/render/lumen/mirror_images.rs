//! Mirror images of the LEDs in the shell of a bubble, whose ripple distorts them.
//!
//! The shell has the radius 1 + η(n) in the direction n, in radii of the sphere. To first order its
//! normal is n − ∇η, evaluated at each pixel: an image lies where that is the mirroring normal,
//! stretched or repeated as the curvature of the shell requires.

use super::bubble::{Behind, Eye, Film, RIPPLES, normals, offset_of};
use crate::lumen::clump::wave;
use crate::lumen::spheres::Sphere;
use crate::render::led::Led;
use crate::render::material::fresnel;
use crate::simd::f32x64::*;
use std::f32::consts::{LOG2_E, PI};

/// Root mean square slope of the ripple at unit amplitude.
const SLOPE: f32 = 4.12;

/// Maximum slope of the ripple at unit amplitude: that of a wave is 8 at most.
const STEEPEST: f32 = 15.2;

/// Fraction of an LED's disc that is its bright die, by assumption; in a mirror image, which shows
/// the disc, the light of all of it comes from there.
const DIE: f32 = 0.15;

/// Standard deviations beyond which a mirror image is invisible.
const FADED: f32 = 3.5;

/// Mirror image of an LED.
struct Image {
    /// Unit normal that mirrors its center.
    normal: Vec3,
    /// Integral of its radiance over the normals, for an LED of unit intensity [1/m²].
    light: f32,
    /// Variance of the normals that mirror the disc of the LED.
    disc: f32,
}

impl Film {
    /// Adds the mirror images of the LEDs: lobes of normals about the mirroring normals, wide
    /// enough that every pixel near them samples them, with the same energy.
    #[inline(always)]
    pub fn add_images(
        &self,
        sphere: &Sphere,
        (distances, seen): (&Lane, &[bool; LANES]),
        eye: &Eye<'_>,
        leds: &[Led],
        (blur, front): (f32, bool),
        behind: &mut Behind<'_>,
    ) {
        let mut found: Option<(Lane3, Lane)> = None;
        for led in leds {
            let Some(image) = self.image(sphere, eye, led, (blur, front)) else { continue };
            let (normals, pixel) =
                found.get_or_insert_with(|| self.rippled(sphere, distances, eye, blur));
            for i in 0..LANES {
                let soft = self.roughness * self.roughness + pixel[i];
                let inverse = 1.0 / (soft + image.disc);
                let apart = sub(at(normals, i), image.normal);
                let light = image.light * inverse * lobe(dot(apart, apart), inverse, image.disc);
                let light = if seen[i] { light } else { 0.0 };
                for k in 0..3 {
                    behind.radiance[k][i] += led.intensity[k] * light;
                }
            }
        }
    }

    /// Mirror image of an LED; none if no ray of the tile comes near it.
    #[inline(always)]
    fn image(
        &self,
        sphere: &Sphere,
        eye: &Eye<'_>,
        led: &Led,
        (blur, front): (f32, bool),
    ) -> Option<Image> {
        let (normal, light, view) = mirror_place(sphere, eye.origin, led, front);
        let half = if front { normal } else { scale(normal, -1.0) };
        let offset = sub(led.position, sphere.center);
        let square = max(dot(offset, offset), sphere.radius * sphere.radius);
        let cosine = max(dot(half, view), 0.05);
        let axis = clamp(-dot(light, led.direction), 0.0, 1.0);
        // The variance of a uniform disc is half its squared radius, that of a Gaussian its own.
        let disc = 0.5 * DIE * led.half_vectors(square, axis, cosine);
        let spread = self.roughness * self.roughness + blur * blur + disc;
        let place = add(offset_of(sphere, eye), scale(normal, sphere.radius));
        let aside = STEEPEST / SLOPE * self.ripple;
        let reach = -(FADED * spread.sqrt() + aside) * sphere.radius;
        if eye.rays.closed && eye.rays.sides.iter().any(|side| dot(*side, place) < reach) {
            return None;
        }
        let light = self.reflects(sphere, cosine) * led.lobe(axis) / (4.0 * cosine * square);
        Some(Image { normal, light, disc })
    }

    /// Fraction of light that the shell reflects: in liquid only the surface of the gas does.
    #[inline(always)]
    fn reflects(&self, sphere: &Sphere, cosine: f32) -> f32 {
        let film = self.film(cosine);
        film + (fresnel(cosine, self.ior) - film) * self.sunk(sphere)
    }

    /// Unit normals of the rippled shell where the rays cross it, and the variance of the normals
    /// within a pixel: that in the sphere times the squared mean curvature.
    #[inline(always)]
    fn rippled(
        &self,
        sphere: &Sphere,
        distances: &Lane,
        eye: &Eye<'_>,
        blur: f32,
    ) -> (Lane3, Lane) {
        let mut normals = normals(sphere, distances, eye);
        let mut pixel = [blur * blur; LANES];
        let amplitude = self.ripple / SLOPE;
        for i in 0..LANES {
            let normal = at(&normals, i);
            let (mut slope, mut curvature) = ([0.0; 3], 1.0);
            for (k, way) in RIPPLES.iter().enumerate() {
                let along = dot(normal, *way);
                let (value, rise) = wave(along + sphere.phases[k]);
                let across = dot(*way, *way) - along * along;
                slope = add(slope, scale(*way, amplitude * rise));
                curvature += amplitude * (16.0 * across * 1.0f32.copysign(value) + along * rise);
            }
            let aside = sub(slope, scale(normal, dot(slope, normal)));
            let rippled = normalize(sub(normal, aside));
            for k in 0..3 {
                normals[k][i] = rippled[k];
            }
            pixel[i] *= max(curvature * curvature, 1.0);
        }
        (normals, pixel)
    }
}

/// Lobe of unit integral over the plane, at a squared distance times the inverse of its variance
/// and over that variance: a Gaussian with a flat top in the part that is an LED's disc.
#[inline(always)]
fn lobe(square: f32, inverse: f32, disc: f32) -> f32 {
    let (q, flat) = (square * inverse, disc * inverse);
    // Integral of exp(−(1 − t) q − t q²) over q, to 1 %.
    let area = 1.0 - (0.38 - 0.266 * flat) * flat;
    exp2(-LOG2_E * q * (1.0 - flat + flat * q)) / (PI * area)
}

/// Mirror image of an LED in a shell: unit directions of the mirroring point from the center, and
/// from it to the LED and to the camera. Iterated from the solution for infinite distances.
#[inline(always)]
fn mirror_place(sphere: &Sphere, eye: Vec3, led: &Led, front: bool) -> (Vec3, Vec3, Vec3) {
    let sign = if front { 1.0 } else { -1.0 };
    let mut place = sphere.center;
    let (mut mirror, mut light, mut view) = ([0.0; 3], [0.0; 3], [0.0; 3]);
    for _ in 0..mirror_steps(sphere, eye, led) {
        light = normalize(sub(led.position, place));
        view = normalize(sub(eye, place));
        mirror = scale(normalize(add(light, view)), sign);
        place = add(sphere.center, scale(mirror, sphere.radius));
    }
    (mirror, light, view)
}

/// Number of iterations towards the mirroring point; each reduces the error by the ratio of the
/// radius to the distance of LED and camera. It is below 1 % of the radius for ratios up to 0.3.
#[inline(always)]
fn mirror_steps(sphere: &Sphere, eye: Vec3, led: &Led) -> usize {
    let offsets = [eye, led.position].map(|from| sub(from, sphere.center));
    let square = min(dot(offsets[0], offsets[0]), dot(offsets[1], offsets[1]));
    let ratio = sphere.radius * sphere.radius / square;
    if ratio < 0.01 {
        2
    } else if ratio < 0.04 {
        3
    } else {
        4
    }
}
