//! Compositing of a bubble over the surfaces behind it: a thin shell of liquid around gas.
//!
//! Each crossing of the shell reflects a fraction of the light from the surroundings and transmits
//! the rest. The fractions are Fresnel's for a film much thicker than the coherence length, so that
//! its two surfaces add incoherently; a film does not refract rays. Each LED has two mirror images:
//! one in the front of the shell, a convex mirror, and one in its back, a concave mirror.

use crate::lumen::spheres::{Crossings, Sphere};
use crate::render::led::Led;
use crate::render::material::fresnel;
use crate::simd::f32x64::*;
use crate::wall::packet::Pyramid;
use std::f32::consts::{LOG2_E, PI};

/// Parameters of all bubbles: `vrcaps.lumen.contents.Bubbles`.
#[derive(Clone, Copy)]
pub struct Film {
    /// Refractive index of the liquid.
    pub ior: f32,
    /// Width of the thick border around a bubble's outline, as a fraction of its radius.
    pub border: f32,
    /// Fraction of light that the border scatters from the surroundings towards the viewer.
    pub gleam: f32,
    /// Absorption of the border at maximum thickness, for red, green and blue.
    pub stain: Vec3,
    /// Roughness α of the shell in the mirror image of an LED.
    pub roughness: f32,
}

/// Surfaces of a tile before a bubble is composited over them.
pub struct Behind<'a> {
    /// Radiance [W/(sr·m²)].
    pub radiance: &'a mut Lane3,
    /// Distance of the surface behind [m].
    pub distance: &'a Lane,
}

/// Viewing rays of the tile.
pub struct Eye<'a> {
    /// Mean origin of the rays.
    pub origin: Vec3,
    /// Start of each ray.
    pub starts: &'a Lane3,
    /// Unit rays and the pyramid around them.
    pub rays: &'a Pyramid,
    /// Angle between pixels [rad].
    pub pixel_angle: f32,
}

impl Film {
    /// Composites a bubble over the surfaces behind it.
    #[inline(always)]
    pub fn cover(
        &self,
        sphere: &Sphere,
        crossings: &Crossings,
        eye: &Eye<'_>,
        leds: &[Led],
        behind: &mut Behind<'_>,
    ) {
        let offset = offset_of(sphere, eye);
        let distance = dot(offset, offset).sqrt();
        // Half a pixel, as a fraction of the radius.
        let blur = 0.5 * eye.pixel_angle * distance / sphere.radius;
        let shell = self.shell(crossings, blur);
        let around = surroundings(sphere, leds, distance, crossings, behind.distance);
        for front in [false, true] {
            let distances = if front { &crossings.near } else { &crossings.far };
            for i in 0..LANES {
                let seen = (distances[i] > 0.0) & (distances[i] < behind.distance[i]);
                for k in 0..3 {
                    let through = if seen { shell.through[k][i] } else { 1.0 };
                    let mirrored = if seen { shell.mirrored[i] } else { 0.0 };
                    let old = behind.radiance[k][i];
                    behind.radiance[k][i] = old * through + around[k][i] * mirrored;
                }
            }
            for led in leds {
                self.add_image(sphere, distances, eye, led, (blur, front), behind);
            }
        }
    }

    /// Fraction of light that one crossing of the shell transmits, given the squared distance of
    /// the ray from the center over the squared radius.
    pub fn passes(&self, miss: f32) -> f32 {
        let surface = fresnel(max(1.0 - miss, 0.0).sqrt(), self.ior);
        1.0 - 2.0 * surface / (1.0 + surface)
    }

    /// Transmission and reflection of one crossing of the shell.
    #[inline(always)]
    fn shell(&self, crossings: &Crossings, blur: f32) -> Shell {
        let mut shell = Shell { through: [[0.0; LANES]; 3], mirrored: [0.0; LANES] };
        let width = max(0.5 * self.border, blur);
        let peak = 0.5 * self.border / width;
        for i in 0..LANES {
            let miss = min(crossings.miss[i], 1.0);
            // A pixel at the outline covers a range of angles, at least its own width.
            let cosine = (max(1.0 - miss, min(blur, 1.0))).sqrt();
            let surface = fresnel(cosine, self.ior);
            let film = 2.0 * surface / (1.0 + surface);
            let from_border = (miss.sqrt() - 1.0 + 0.6 * self.border) / width;
            let border = peak * exp2(-LOG2_E * from_border * from_border);
            let inner = (miss.sqrt() - 1.0 + 1.8 * self.border) / (1.4 * width);
            let depth = peak * exp2(-LOG2_E * inner * inner);
            shell.mirrored[i] = film + (1.0 - film) * self.gleam * border;
            for k in 0..3 {
                let stain = exp2(-LOG2_E * self.stain[k] * depth);
                shell.through[k][i] = (1.0 - shell.mirrored[i]) * stain;
            }
        }
        shell
    }

    /// Adds the mirror image of an LED: a Gaussian lobe of normals about the mirroring normal, wide
    /// enough that every pixel near it samples it, with the same energy.
    #[inline(always)]
    fn add_image(
        &self,
        sphere: &Sphere,
        distances: &Lane,
        eye: &Eye<'_>,
        led: &Led,
        (blur, front): (f32, bool),
        behind: &mut Behind<'_>,
    ) {
        let (mirror, light, view) = mirror_place(sphere, eye.origin, led, front);
        let half = if front { mirror } else { scale(mirror, -1.0) };
        let offset = sub(led.position, sphere.center);
        let square = max(dot(offset, offset), sphere.radius * sphere.radius);
        let cosine = max(dot(half, view), 0.05);
        let axis = clamp(-dot(light, led.direction), 0.0, 1.0);
        // The variance of a uniform disc is half its squared radius, that of a Gaussian its own.
        let disc = 0.5 * led.half_vectors(square, axis, cosine);
        let spread = self.roughness * self.roughness + blur * blur + disc;
        let surface = fresnel(cosine, self.ior);
        let lobe = led_lobe(led, light);
        let peak = 2.0 * surface / (1.0 + surface) * lobe / (4.0 * PI * spread * cosine * square);
        let inverse = 1.0 / sphere.radius;
        let steepness = LOG2_E / spread;
        let place = add(offset_of(sphere, eye), scale(mirror, sphere.radius));
        let reach = -FADED * spread.sqrt() * sphere.radius;
        if eye.rays.closed && eye.rays.sides.iter().any(|side| dot(*side, place) < reach) {
            return;
        }
        for i in 0..LANES {
            let seen = (distances[i] > 0.0) & (distances[i] < behind.distance[i]);
            let offset = scale(at(&eye.rays.directions, i), distances[i]);
            let point = add(at(eye.starts, i), offset);
            let apart = sub(scale(sub(point, sphere.center), inverse), mirror);
            let image = if seen { peak * exp2(-steepness * dot(apart, apart)) } else { 0.0 };
            for k in 0..3 {
                behind.radiance[k][i] += led.intensity[k] * image;
            }
        }
    }
}

/// Mirror image of an LED in a shell: unit directions of the mirroring point from the center, and
/// from it to the LED and to the camera. Iterated from the solution for infinite distances.
#[inline(always)]
fn mirror_place(sphere: &Sphere, eye: Vec3, led: &Led, front: bool) -> (Vec3, Vec3, Vec3) {
    let sign = if front { 1.0 } else { -1.0 };
    let mut place = sphere.center;
    let (mut mirror, mut light, mut view) = ([0.0; 3], [0.0; 3], [0.0; 3]);
    for _ in 0..MIRROR_STEPS {
        light = normalize(sub(led.position, place));
        view = normalize(sub(eye, place));
        mirror = scale(normalize(add(light, view)), sign);
        place = add(sphere.center, scale(mirror, sphere.radius));
    }
    (mirror, light, view)
}

/// Number of iterations towards the mirroring point; each reduces the error by the ratio of the
/// radius to the distance of LED and camera.
const MIRROR_STEPS: usize = 4;

/// Standard deviations beyond which a mirror image is invisible.
const FADED: f32 = 3.5;

/// Vector from the camera to the center of a sphere.
#[inline(always)]
fn offset_of(sphere: &Sphere, eye: &Eye<'_>) -> Vec3 {
    sub(sphere.center, eye.origin)
}

/// One crossing of a shell.
struct Shell {
    through: Lane3,
    mirrored: Lane,
}

/// Fraction of an LED's intensity in the direction that its light travels, `-light`.
#[inline(always)]
fn led_lobe(led: &Led, light: Vec3) -> f32 {
    lobe(led, clamp(-dot(light, led.direction), 0.0, 1.0))
}

/// Fraction of an LED's intensity at a cosine of the angle to its axis.
#[inline(always)]
fn lobe(led: &Led, cosine: f32) -> f32 {
    if led.exponent == 0.0 {
        1.0
    } else if led.exponent == 1.0 {
        cosine
    } else {
        pow(cosine, led.exponent)
    }
}

/// Maximum distance from a bubble to the wall that it mirrors [m]: that of a bubble on the lens.
const MOST_ROOM: f32 = 0.01;

/// Radiance of the wall that a bubble mirrors: diffuse, of its color, facing the LEDs.
///
/// A shell that is hit at angle θ turns a ray by π − 2θ, so its middle mirrors the region behind
/// the camera, which the LEDs do not light, and its outline the region in front. The wall is taken
/// as a tube that ends in a hemisphere, centered on the bubble, at `distance` from the camera; its
/// radius is the distance from the bubble to the surface behind it, at most `MOST_ROOM`. The LEDs
/// are taken to be at the camera, and no lit point nearer to them than the bubble.
#[inline(always)]
fn surroundings(
    sphere: &Sphere,
    leds: &[Led],
    distance: f32,
    crossings: &Crossings,
    behind: &Lane,
) -> Lane3 {
    let mut radiance = [[0.0; LANES]; 3];
    for i in 0..LANES {
        let room = clamp(behind[i] - distance, sphere.radius, max(MOST_ROOM, sphere.radius));
        let forward = 2.0 * min(crossings.miss[i], 1.0) - 1.0;
        let aside = max(1.0 - forward * forward, 1e-6).sqrt();
        let reach = if forward < 0.0 { room / aside } else { room };
        let along = distance + reach * forward;
        let square = along * along + reach * reach * aside * aside;
        let cosine = max(along, 0.0) / square.sqrt();
        let nearness = 1.0 / (PI * max(square, distance * distance));
        for led in leds {
            let lit = lobe(led, cosine) * nearness;
            for k in 0..3 {
                radiance[k][i] += sphere.color[k] * led.intensity[k] * lit;
            }
        }
    }
    radiance
}
