//! Pools with level surfaces: what light loses and gains on its way through them.
//!
//! A pool is known by its level and by the vertices of the wall that lie along its stretch of the
//! gut. A ray has crossed the surface where it meets the level, if what it meets in the end lies
//! under it. The surface mirrors and lets through by Fresnel's law and turns no ray; the liquid
//! absorbs, and scatters once, the same to all sides.

use super::bubble::led_lobe;
use crate::lanes::*;
use crate::material::{Led, fresnel};
use std::f32::consts::{LOG2_E, PI};

/// `Pools::of_vertex` of a vertex in no pool.
pub const DRY: u16 = 0;

/// What the liquid is: `vrcaps.tissue.contents.liquid.Liquid`.
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
    /// Linear colour of what the surface mirrors.
    pub color: Vec3,
}

/// All pools of an organ.
pub struct Pools {
    /// Levels about the wall's centre [m], pool 1 first.
    pub levels: Vec<f32>,
    /// Pool along whose stretch each vertex lies, `DRY` for none.
    pub of_vertex: Vec<u16>,
}

/// Rays of a tile in the pools.
pub struct Wet {
    /// Lanes that pass through liquid.
    pub is_wet: [bool; LANES],
    /// Pool of each lane.
    pub pool: [u16; LANES],
    /// Where the liquid begins along the ray [m].
    pub start: Lane,
    /// Where it ends.
    pub end: Lane,
    /// Level of the lane's pool [m].
    level: Lane,
    /// Whether the eye is under this lane's pool.
    under: [bool; LANES],
    /// Whether the surface met lies under it.
    sunk: [bool; LANES],
}

impl Pools {
    /// Pool along whose stretch a face lies.
    #[inline(always)]
    pub fn of_face(&self, corners: [u32; 3]) -> u16 {
        let [a, b, c] = corners.map(|v| self.of_vertex[v as usize]);
        a.max(b).max(c)
    }

    /// What liquid lies on the way to the surfaces met, whose pools are given; so is the eye's.
    #[inline(always)]
    pub fn crossed(
        &self,
        eye: (Vec3, u16),
        directions: &Lane3,
        distance: &Lane,
        position: &Lane3,
        pool: [u16; LANES],
    ) -> Wet {
        let (origin, of_eye) = eye;
        let zero = [0.0; LANES];
        let no = [false; LANES];
        let mut wet =
            Wet { is_wet: no, pool, start: zero, end: zero, level: zero, under: no, sunk: no };
        for i in 0..LANES {
            if pool[i] == DRY {
                continue;
            }
            let level = self.levels[pool[i] as usize - 1];
            let under = pool[i] == of_eye && origin[2] < level;
            let sunk = position[2][i] < level && (under || origin[2] >= level);
            let crossing = (level - origin[2]) / directions[2][i];
            wet.level[i] = level;
            wet.under[i] = under;
            wet.sunk[i] = sunk;
            wet.is_wet[i] = under || sunk;
            wet.start[i] = if under { 0.0 } else { crossing };
            wet.end[i] = if sunk { distance[i] } else { crossing };
        }
        wet
    }
}

impl Optics {
    /// What is left of an LED's light after the liquid between it and each surface met.
    #[inline(always)]
    pub fn dim(&self, led: &Led, position: &Lane3, wet: &Wet, light: &mut Lane3) {
        for i in 0..LANES {
            let way = wet.way(led.position, at(position, i), i);
            for k in 0..3 {
                light[k][i] *= exp2(-LOG2_E * self.extinction(k) * way);
            }
        }
    }

    /// What is left of even light from above after the liquid over each surface met.
    ///
    /// Even light loses as much as a beam on a way 1.66 times as long (Elsasser 1942).
    #[inline(always)]
    pub fn dim_even(&self, position: &Lane3, wet: &Wet, light: &mut Lane3) {
        for i in 0..LANES {
            let depth = if wet.sunk[i] { max(wet.level[i] - position[2][i], 0.0) } else { 0.0 };
            for k in 0..3 {
                light[k][i] *= exp2(-1.66 * LOG2_E * self.extinction(k) * depth);
            }
        }
    }

    fn extinction(&self, k: usize) -> f32 {
        self.absorption[k] + self.scattering[k]
    }

    /// Carries radiance from the surfaces met to the eye.
    #[inline(always)]
    pub fn cover(
        &self,
        origin: Vec3,
        directions: &Lane3,
        (leds, distance): (&[Led], &Lane),
        wet: &Wet,
        radiance: &mut Lane3,
    ) {
        for i in (0..LANES).filter(|&i| wet.is_wet[i]) {
            let direction = at(directions, i);
            let length = wet.end[i] - wet.start[i];
            let glow = self.glow(origin, direction, leds, wet, i);
            let mut color = [0, 1, 2]
                .map(|k| radiance[k][i] * exp2(-LOG2_E * self.extinction(k) * length) + glow[k]);
            if wet.under[i] != wet.sunk[i] {
                color = self.through_surface(origin, direction, leds, wet, (i, distance[i], color));
            }
            for k in 0..3 {
                radiance[k][i] = color[k];
            }
        }
    }

    /// Light scattered once, by the midpoint rule over the way through the liquid.
    #[inline(always)]
    fn glow(&self, origin: Vec3, direction: Vec3, leds: &[Led], wet: &Wet, i: usize) -> Vec3 {
        const PARTS: usize = 4;
        /// Nearest that a point of the liquid counts to an LED [m].
        const NEAREST: f32 = 1e-3;
        let (start, length) = (wet.start[i], wet.end[i] - wet.start[i]);
        let mut sum = [0.0; 3];
        for part in 0..PARTS {
            // Parts grow with the square of their number: most light comes back from nearby.
            let [from, to] = [part, part + 1].map(|p| (p * p) as f32 / (PARTS * PARTS) as f32);
            let way = 0.5 * (from + to) * length;
            let point = add(origin, scale(direction, start + way));
            for led in leds {
                let offset = sub(led.position, point);
                let square = max(dot(offset, offset), NEAREST * NEAREST);
                let power =
                    led_lobe(led, normalize(offset)) * (to - from) * length / (4.0 * PI * square);
                let total = way + wet.way(led.position, point, i);
                for k in 0..3 {
                    sum[k] += led.intensity[k]
                        * power
                        * self.scattering[k]
                        * exp2(-LOG2_E * self.extinction(k) * total);
                }
            }
        }
        sum
    }

    /// The surface itself: what it lets through, and what it mirrors on the eye's side.
    #[inline(always)]
    fn through_surface(
        &self,
        origin: Vec3,
        direction: Vec3,
        leds: &[Led],
        wet: &Wet,
        (i, far, color): (usize, f32, Vec3),
    ) -> Vec3 {
        let under = wet.under[i];
        let crossing = if under { wet.end[i] } else { wet.start[i] };
        let place = add(origin, scale(direction, crossing));
        let cosine = direction[2].abs();
        let ior = if under { 1.0 / self.ior } else { self.ior };
        let share = fresnel(cosine, ior);
        let mut mirrored = [0.0; 3];
        for led in leds {
            let offset = sub(led.position, place);
            let square = max(dot(offset, offset), 1e-8);
            let light = scale(offset, 1.0 / square.sqrt());
            let lobe = led_lobe(led, light);
            let half = normalize(sub(light, direction));
            let normal = if under { -half[2] } else { half[2] };
            let tilt = 2.0 * max(1.0 - normal, 0.0) / (self.roughness * self.roughness);
            let image = if normal > 0.0 {
                let density = exp2(-LOG2_E * tilt) / (PI * self.roughness * self.roughness);
                share * density / (4.0 * max(cosine, 0.05) * square)
            } else {
                0.0
            };
            for k in 0..3 {
                mirrored[k] += led.intensity[k] * lobe * image;
            }
        }
        // What the surface mirrors is as far off as what lies behind it.
        let behind = add(origin, scale(direction, far));
        for led in leds {
            let offset = sub(led.position, behind);
            let square = max(dot(offset, offset), 1e-8);
            let power = share * led_lobe(led, normalize(offset)) / (PI * square);
            for k in 0..3 {
                mirrored[k] += led.intensity[k] * power * self.color[k];
            }
        }
        if under {
            let way = -LOG2_E * crossing;
            let left = [0, 1, 2].map(|k| exp2(way * self.extinction(k)));
            return [0, 1, 2].map(|k| color[k] * (1.0 - share) + mirrored[k] * left[k]);
        }
        [0, 1, 2].map(|k| color[k] * (1.0 - share) + mirrored[k])
    }
}

impl Wet {
    /// Length of the way from an LED to a point that lies in the liquid of lane `i` [m].
    ///
    /// LEDs are where the eye is: in its pool, or in none.
    #[inline(always)]
    fn way(&self, led: Vec3, point: Vec3, i: usize) -> f32 {
        if !self.is_wet[i] {
            return 0.0;
        }
        let offset = sub(led, point);
        let length = dot(offset, offset).sqrt();
        let (below, led_below) = (self.level[i] - point[2], self.level[i] - led[2]);
        match (below > 0.0, led_below > 0.0) {
            (true, true) => length,
            (true, false) => length * below / max(below - led_below, 1e-9),
            (false, true) => length * led_below / max(led_below - below, 1e-9),
            (false, false) => 0.0,
        }
    }
}
