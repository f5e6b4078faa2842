//! Compositing of a bubble over the surfaces behind it: a thin shell of liquid around gas.
//!
//! Each crossing of the shell reflects a fraction of the light from the surroundings and transmits
//! the rest. The fractions are Fresnel's for a film much thicker than the coherence length, so that
//! its two surfaces add incoherently; a film does not refract rays. Each LED has two mirror images:
//! one in the front of the shell, a convex mirror, and one in its back, a concave mirror.
//!
//! A bubble up to the size of the meniscus lies wholly in liquid. Light that meets it from there at
//! an angle beyond arcsin(1/n) is totally reflected (Davis, J. Opt. Soc. Am. 45, 1955; Marston,
//! ibid. 69, 1979), hence its bright rim from 1/n = 0.75 of its radius to its outline, which shows
//! the wall around it. The rest is a diverging `lens`, below which the wall gets less light.

use super::rim::Rim;
use crate::lumen::clump::wave;
use crate::lumen::crossings::Crossings;
use crate::lumen::spheres::Sphere;
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
    /// Width of the rim of a bubble in liquid, as a fraction of its radius.
    pub border: f32,
    /// Fraction of light that the rim reflects.
    pub gleam: f32,
    /// Density of absorption in the rim for red, green and blue.
    pub stain: Vec3,
    /// Radius up to which a bubble lies wholly in liquid [m].
    pub meniscus: f32,
    /// Fraction of its light that the wall below a bubble in liquid loses.
    pub shade: f32,
    /// Root mean square slope of the deviations from a sphere.
    pub ripple: f32,
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
        let normals = normals(sphere, &crossings.near, eye);
        let shell = self.shell(sphere, (crossings, &normals), behind.distance, blur);
        let around = surroundings(sphere, leds, distance, crossings, behind);
        let stain = self.stain.map(|stain| 1.0 - exp2(-LOG2_E * stain));
        for front in [false, true] {
            let distances = if front { &crossings.near } else { &crossings.far };
            let seen: [bool; LANES] = std::array::from_fn(|i| {
                let is_drawn = front | !crossings.shared[1][i];
                is_drawn & (distances[i] > 0.0) & (distances[i] < behind.distance[i])
            });
            if !seen.contains(&true) {
                continue;
            }
            for i in 0..LANES {
                let rim = if front { shell.rim[i] } else { 0.0 };
                let film = shell.film[usize::from(!front)][i];
                let mirrored = film + (1.0 - film) * rim;
                let shade = if front { shell.shade[i] } else { 1.0 };
                let old = at(behind.radiance, i);
                let below = shaded(old, shade);
                for k in 0..3 {
                    let through = below[k] * (1.0 - mirrored);
                    let new = (1.0 - stain[k] * rim) * (through + around[k][i] * mirrored);
                    behind.radiance[k][i] = if seen[i] { new } else { old[k] };
                }
            }
            let shared = &crossings.shared[usize::from(!front)];
            let mirrors = std::array::from_fn(|i| seen[i] & !shared[i]);
            self.add_images(sphere, (distances, &mirrors), eye, leds, (blur, front), behind);
        }
    }

    /// Fraction of light that one crossing of the shell transmits, given the squared distance of
    /// the ray from the center over the squared radius.
    pub fn passes(&self, miss: f32) -> f32 {
        1.0 - self.film(max(1.0 - miss, 0.0).sqrt())
    }

    /// Reflection and shade of the shell.
    #[inline(always)]
    fn shell(
        &self,
        sphere: &Sphere,
        (crossings, normals): (&Crossings, &Lane3),
        behind: &Lane,
        blur: f32,
    ) -> Shell {
        let zero = [0.0; LANES];
        let mut shell = Shell { film: [zero; 2], rim: zero, shade: [1.0; LANES] };
        let (inverse, least) = (1.0 / sphere.radius, min(blur, 1.0));
        let rim = Rim::new(self, sphere, blur);
        for i in 0..LANES {
            // A pixel at the outline covers a range of angles, at least its own width.
            shell.film[1][i] = self.film(max(1.0 - crossings.miss[i], least).sqrt());
            // Where the bubble meets the wall it has an edge as well; a ray meets the wall aslant.
            let height = (behind[i] - crossings.near[i]) * inverse;
            let edge = min(crossings.edge[i], max(2.0 * height, 0.0));
            let waves = [0, 1].map(|k| wave(dot(at(normals, i), RIPPLES[k]) + sphere.phases[k]).0);
            let (rim, shade) = rim.at(edge, waves);
            shell.rim[i] = if crossings.shared[0][i] { 0.0 } else { rim };
            shell.shade[i] = if crossings.shared[0][i] { 1.0 } else { shade };
        }
        shell.film[0] = shell.film[1];
        if crossings.shared[0].contains(&true) {
            for i in 0..LANES {
                shell.film[0][i] = self.film(max(crossings.cosine[i], least.sqrt()));
            }
        }
        shell
    }

    /// Fraction of light that the film reflects.
    #[inline(always)]
    pub fn film(&self, cosine: f32) -> f32 {
        let surface = fresnel(cosine, self.ior);
        2.0 * surface / (1.0 + surface)
    }

    /// Part of a bubble that lies in liquid: 1 up to the size of the meniscus, above which it emerges.
    #[inline(always)]
    pub fn sunk(&self, sphere: &Sphere) -> f32 {
        min((self.meniscus / sphere.radius).sqrt(), 1.0)
    }
}

/// Directions of the waves of the ripple, times their periods per radius.
pub const RIPPLES: [Vec3; 3] = [[0.47, 0.23, -0.23], [-0.22, 0.54, 0.2], [0.2, -0.2, 0.64]];

/// Outward unit normals of a sphere at distances along the rays.
#[inline(always)]
pub fn normals(sphere: &Sphere, distances: &Lane, eye: &Eye<'_>) -> Lane3 {
    let inverse = 1.0 / sphere.radius;
    let mut normals = [[0.0; LANES]; 3];
    for k in 0..3 {
        for i in 0..LANES {
            let along = distances[i] * eye.rays.directions[k][i];
            normals[k][i] = (eye.starts[k][i] + along - sphere.center[k]) * inverse;
        }
    }
    normals
}

/// Vector from the camera to the center of a sphere.
#[inline(always)]
pub fn offset_of(sphere: &Sphere, eye: &Eye<'_>) -> Vec3 {
    sub(sphere.center, eye.origin)
}

/// Reflection and shade of a shell.
struct Shell {
    /// Fraction of light that the film reflects at the first and at the second crossing.
    film: [Lane; 2],
    /// Fraction of the rest that the rim reflects.
    rim: Lane,
    /// Relative radiance of the wall below.
    shade: Lane,
}

/// Radiance of a wall that loses a part of its direct light: the rest was reflected by other parts of
/// the wall before, so that it has the wall's color twice.
#[inline(always)]
fn shaded(radiance: Vec3, shade: f32) -> Vec3 {
    let peak = max(max(radiance[0], radiance[1]), max(radiance[2], 1e-30));
    radiance.map(|value| value * shade * (shade + (1.0 - shade) * value / peak))
}

/// Minimum radiance of the surface behind relative to that of a wall that faces the LEDs.
const LEAST: f32 = 0.12;

/// Weight of a wall that faces the LEDs in the radiance of reflections.
const OWN_PART: f32 = 0.6;

/// Weight of the bubble's color in the hue of its reflections.
const OWN_HUE: f32 = 0.6;

/// Maximum distance from a bubble to the wall that it mirrors [m]: that of a bubble on the lens.
const MOST_ROOM: f32 = 0.01;

/// Radiance of the wall that a bubble mirrors.
///
/// It is the mean of that of a diffuse wall of the bubble's color that faces the LEDs, weighted by
/// `OWN_PART`, and of their geometric mean with the surface behind, which an outline mirrors; the
/// latter is counted as at least `LEAST` of the former. The hue is that of the surface behind, mixed
/// with the bubble's.
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
    behind: &Behind<'_>,
) -> Lane3 {
    let mut radiance = [[0.0; LANES]; 3];
    for i in 0..LANES {
        let room =
            clamp(behind.distance[i] - distance, sphere.radius, max(MOST_ROOM, sphere.radius));
        let forward = 2.0 * min(crossings.miss[i], 1.0) - 1.0;
        let aside = max(1.0 - forward * forward, 1e-6).sqrt();
        let reach = if forward < 0.0 { room / aside } else { room };
        let along = distance + reach * forward;
        let square = along * along + reach * reach * aside * aside;
        let cosine = max(along, 0.0) / square.sqrt();
        let nearness = 1.0 / (PI * max(square, distance * distance));
        for led in leds {
            let lit = led.lobe(cosine) * nearness;
            for k in 0..3 {
                radiance[k][i] += sphere.color[k] * led.intensity[k] * lit;
            }
        }
        let (light, hue) = (at(&radiance, i), at(behind.radiance, i));
        let (own, seen) = (light[0] + light[1] + light[2], hue[0] + hue[1] + hue[2]);
        let mean = OWN_PART * own + (1.0 - OWN_PART) * (own * max(seen, LEAST * own)).sqrt();
        let per_hue = mean / max(seen + OWN_HUE * own, 1e-30);
        for k in 0..3 {
            radiance[k][i] = (hue[k] + OWN_HUE * light[k]) * per_hue;
        }
    }
    radiance
}
