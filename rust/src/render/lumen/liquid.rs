//! Pools with level surfaces: attenuation and scattering of light on its path through them.
//!
//! A pool is given by its level and by the vertices of the wall along its section of the gut. The
//! surface reflects and transmits by Fresnel's law; the liquid absorbs, and scatters once and
//! isotropically. Light from the LEDs enters it without refraction.

use super::refraction::{REFRACTED, Turn};
use crate::render::led::Led;
use crate::simd::f32x64::*;
use std::f32::consts::{LOG2_E, PI};

/// `Pools::of_vertex` of a vertex in no pool.
pub const DRY: u16 = 0;

/// Properties of the liquid: `vrcaps.lumen.contents.Liquid`.
#[derive(Clone, Copy)]
pub struct Optics {
    /// Refractive index.
    pub ior: f32,
    /// Absorption coefficient for red, green and blue [1/m].
    pub absorption: Vec3,
    /// Scattering coefficient for red, green and blue [1/m].
    pub scattering: Vec3,
    /// Roughness α of the surface.
    pub roughness: f32,
}

/// All pools of an organ.
pub struct Pools {
    /// Levels relative to the wall's center [m], pool 1 first.
    pub levels: Vec<f32>,
    /// Pool of the section in which each vertex lies, `DRY` for none.
    pub of_vertex: Vec<u16>,
}

/// Rays of a tile in the pools.
pub struct Wet {
    /// Lanes that pass through liquid.
    pub is_wet: [bool; LANES],
    /// Pool of each lane.
    pub pool: [u16; LANES],
    /// Start of the liquid along the ray [m].
    pub start: Lane,
    /// `true` where the camera is below the level of this lane's pool.
    pub under: [bool; LANES],
    /// Continuation of the rays at its surface.
    pub turn: Turn,
    /// Level of the lane's pool [m].
    level: Lane,
}

impl Pools {
    /// Pool of the section in which a face lies.
    #[inline(always)]
    pub fn of_face(&self, corners: [u32; 3]) -> u16 {
        let [a, b, c] = corners.map(|v| self.of_vertex[v as usize]);
        a.max(b).max(c)
    }

    /// Level of a pool relative to the wall's center [m].
    pub fn level(&self, pool: u16) -> f32 {
        self.levels[pool as usize - 1]
    }

    /// Liquid on straight paths to surfaces at `position`, given the pools of these and of the
    /// camera.
    ///
    /// A ray from above has crossed the surface if its hit lies below the level; one from below if
    /// its hit lies above it.
    #[inline(always)]
    pub fn crossed(
        &self,
        (origin, of_eye): (Vec3, u16),
        directions: &Lane3,
        position: &Lane3,
        pool: [u16; LANES],
        ior: f32,
    ) -> Wet {
        let no = [false; LANES];
        let zero = [0.0; LANES];
        let mut wet =
            Wet { is_wet: no, pool, start: zero, under: no, turn: Turn::none(), level: zero };
        let is_under = of_eye != DRY && origin[2] < self.level(of_eye);
        for i in 0..LANES {
            wet.pool[i] = if is_under { of_eye } else { pool[i] };
            if wet.pool[i] == DRY {
                continue;
            }
            let level = self.level(wet.pool[i]);
            let sunk = position[2][i] < level;
            wet.level[i] = level;
            wet.under[i] = is_under;
            wet.is_wet[i] = is_under || (sunk && origin[2] >= level);
            if wet.is_wet[i] & (is_under != sunk) {
                let beyond = if is_under { 1.0 / ior } else { ior };
                wet.turn.set(i, origin, at(directions, i), level, beyond);
            }
            wet.start[i] = if is_under { 0.0 } else { wet.turn.distance[i] };
        }
        wet
    }
}

impl Optics {
    /// Attenuates an LED's light in the liquid between it and each surface.
    #[inline(always)]
    pub fn dim(&self, led: &Led, position: &Lane3, wet: &Wet, light: &mut Lane3) {
        for i in 0..LANES {
            let length = wet.length_in_liquid(led.position, at(position, i), i);
            for k in 0..3 {
                light[k][i] *= exp2(-LOG2_E * self.extinction(k) * length);
            }
        }
    }

    /// Attenuates diffuse light from above in the liquid over each surface.
    ///
    /// Diffuse light is attenuated like a beam on a path 1.66 times as long (Elsasser 1942).
    #[inline(always)]
    pub fn dim_even(&self, position: &Lane3, wet: &Wet, light: &mut Lane3) {
        for i in 0..LANES {
            let depth = if wet.is_wet[i] { max(wet.level[i] - position[2][i], 0.0) } else { 0.0 };
            for k in 0..3 {
                light[k][i] *= exp2(-1.66 * LOG2_E * self.extinction(k) * depth);
            }
        }
    }

    /// Extinction coefficient of a color [1/m].
    #[inline(always)]
    pub fn extinction(&self, k: usize) -> f32 {
        self.absorption[k] + self.scattering[k]
    }

    /// LEDs with their intensities at a point in the liquid of lane `i`.
    pub fn dimmed(&self, leds: &[Led], point: Vec3, wet: &Wet, i: usize) -> Vec<Led> {
        let dim = |led: &Led| {
            let exponent = -LOG2_E * wet.length_in_liquid(led.position, point, i);
            let intensity =
                [0, 1, 2].map(|k| led.intensity[k] * exp2(exponent * self.extinction(k)));
            Led { intensity, ..*led }
        };
        leds.iter().map(dim).collect()
    }

    /// Transports radiance through segments of liquid, which start on the camera's side at `starts`
    /// and extend along unit `directions`; segments of length 0 have no effect.
    #[inline(always)]
    pub fn carry(
        &self,
        (starts, directions, length): (&Lane3, &Lane3, &Lane),
        leds: &[Led],
        wet: &Wet,
        radiance: &mut Lane3,
    ) {
        let in_scattering = self.in_scattering((starts, directions, length), leds, wet);
        for k in 0..3 {
            let steepness = -LOG2_E * self.extinction(k);
            for i in 0..LANES {
                radiance[k][i] = radiance[k][i] * exp2(steepness * length[i]) + in_scattering[k][i];
            }
        }
    }

    /// Single-scattered light, by the midpoint rule along the path through the liquid.
    #[inline(always)]
    fn in_scattering(
        &self,
        (starts, directions, length): (&Lane3, &Lane3, &Lane),
        leds: &[Led],
        wet: &Wet,
    ) -> Lane3 {
        const PARTS: usize = 4;
        /// Minimum distance between a point of the liquid and an LED [m].
        const NEAREST: f32 = 1e-3;
        let mut sum = [[0.0; LANES]; 3];
        for part in 0..PARTS {
            // Interval boundaries grow with the squared index: most scattered light comes from
            // nearby.
            let [from, to] = [part, part + 1].map(|p| (p * p) as f32 / (PARTS * PARTS) as f32);
            for led in leds {
                let (mut power, mut total, mut lobe) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
                for i in 0..LANES {
                    let distance = 0.5 * (from + to) * length[i];
                    let point = add(at(starts, i), scale(at(directions, i), distance));
                    let offset = sub(led.position, point);
                    let square = max(dot(offset, offset), NEAREST * NEAREST);
                    power[i] = (to - from) * length[i] / (4.0 * PI * square);
                    lobe[i] = clamp(-dot(normalize(offset), led.direction), 0.0, 1.0);
                    total[i] = distance + wet.length_in_liquid(led.position, point, i);
                }
                shape(&mut lobe, led.exponent);
                for k in 0..3 {
                    let strength = led.intensity[k] * self.scattering[k];
                    let steepness = -LOG2_E * self.extinction(k);
                    for i in 0..LANES {
                        let light = strength * power[i] * lobe[i];
                        sum[k][i] += light * exp2(steepness * total[i]);
                    }
                }
            }
        }
        sum
    }

    /// Applies the surfaces: radiance transmitted from beyond, `mirrored` radiance reflected on the
    /// camera's side, and the mirror images of the LEDs.
    #[inline(always)]
    pub fn meet_surface(
        &self,
        directions: &Lane3,
        leds: &[Led],
        wet: &Wet,
        mirrored: &Lane3,
        radiance: &mut Lane3,
    ) {
        let mut images = [[0.0; LANES]; 3];
        for led in leds {
            self.add_image(directions, led, wet, &mut images);
        }
        let (lanes, refracted) = (wet.turn.lanes(), wet.turn.are(REFRACTED));
        for k in 0..3 {
            for i in 0..LANES {
                let reflectance = if refracted[i] { wet.turn.reflectance[i] } else { 0.0 };
                let image = if lanes[i] { images[k][i] } else { 0.0 };
                radiance[k][i] =
                    (1.0 - reflectance) * radiance[k][i] + reflectance * mirrored[k][i] + image;
            }
        }
    }

    /// Adds mirror images of an LED in the surface, whose roughness is a Gaussian of slopes.
    #[inline(always)]
    fn add_image(&self, directions: &Lane3, led: &Led, wet: &Wet, sum: &mut Lane3) {
        let (mut image, mut length, mut lobe) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        for i in 0..LANES {
            let direction = at(directions, i);
            let offset = sub(led.position, at(&wet.turn.place, i));
            let square = max(dot(offset, offset), 1e-8);
            let light = scale(offset, 1.0 / square.sqrt());
            let half = normalize(sub(light, direction));
            // The camera is on the side that the ray comes from.
            let normal = half[2] * -1f32.copysign(direction[2]);
            lobe[i] = clamp(-dot(light, led.direction), 0.0, 1.0);
            // A Gaussian as wide as the disc, see `Film::add_image`.
            let disc = 0.5 * led.half_vectors(square, lobe[i], dot(light, half));
            let square_roughness = self.roughness * self.roughness + disc;
            let tilt = 2.0 * max(1.0 - normal, 0.0) / square_roughness;
            let density = exp2(-LOG2_E * tilt) / (PI * square_roughness);
            let peak =
                wet.turn.reflectance[i] * density / (4.0 * max(direction[2].abs(), 0.05) * square);
            image[i] = if normal > 0.0 { peak } else { 0.0 };
            length[i] = if wet.under[i] { square.sqrt() } else { 0.0 };
        }
        shape(&mut lobe, led.exponent);
        for k in 0..3 {
            let steepness = -LOG2_E * self.extinction(k);
            for i in 0..LANES {
                sum[k][i] += led.intensity[k] * image[i] * lobe[i] * exp2(steepness * length[i]);
            }
        }
    }
}

/// Replaces cosines by fractions of an LED's intensity.
#[inline(always)]
fn shape(lobe: &mut Lane, exponent: f32) {
    if exponent == 1.0 {
        return;
    }
    for cosine in lobe {
        *cosine = if exponent == 0.0 { 1.0 } else { pow(*cosine, exponent) };
    }
}

impl Wet {
    /// True if any ray hits the surface.
    #[inline(always)]
    pub fn turns(&self) -> bool {
        self.turn.lanes().contains(&true)
    }

    /// Length of the liquid between an LED and a point that lies in the liquid of lane `i` [m].
    ///
    /// LEDs are in the camera's pool, or in none.
    #[inline(always)]
    fn length_in_liquid(&self, led: Vec3, point: Vec3, i: usize) -> f32 {
        let offset = sub(led, point);
        let (below, led_below) = (self.level[i] - point[2], self.level[i] - led[2]);
        let sunk = max(below, 0.0) + max(led_below, 0.0);
        let fraction = sunk / max(below.abs() + led_below.abs(), 1e-9);
        let length = dot(offset, offset).sqrt() * fraction;
        if self.is_wet[i] { length } else { 0.0 }
    }
}
