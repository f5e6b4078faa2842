//! Pools with level surfaces: what light loses and gains on its way through them.
//!
//! A pool is known by its level and by the vertices of the wall that lie along its stretch of the
//! gut. The surface mirrors and lets through by Fresnel's law; the liquid absorbs, and scatters
//! once, the same to all sides. Light from the LEDs takes the straight way into it.

use super::bubble::led_lobe;
use super::turn::Turn;
use crate::lanes::*;
use crate::material::Led;
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
    /// Whether the eye is under this lane's pool.
    pub under: [bool; LANES],
    /// How the rays go on at its surface.
    pub turn: Turn,
    /// Level of the lane's pool [m].
    level: Lane,
}

impl Pools {
    /// Pool along whose stretch a face lies.
    #[inline(always)]
    pub fn of_face(&self, corners: [u32; 3]) -> u16 {
        let [a, b, c] = corners.map(|v| self.of_vertex[v as usize]);
        a.max(b).max(c)
    }

    /// Level of a pool about the wall's centre [m].
    pub fn level(&self, pool: u16) -> f32 {
        self.levels[pool as usize - 1]
    }

    /// What liquid lies on the way to the surfaces that straight rays meet at `position`, whose
    /// pools are given; so is the eye's.
    ///
    /// A ray from above has crossed the surface if what it meets lies under it; one from below if
    /// it gets above it.
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
            wet.start[i] = if is_under { 0.0 } else { wet.turn.way[i] };
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
            let depth = if wet.is_wet[i] { max(wet.level[i] - position[2][i], 0.0) } else { 0.0 };
            for k in 0..3 {
                light[k][i] *= exp2(-1.66 * LOG2_E * self.extinction(k) * depth);
            }
        }
    }

    fn extinction(&self, k: usize) -> f32 {
        self.absorption[k] + self.scattering[k]
    }

    /// LEDs as bright as they are at a point in the liquid of lane `i`.
    pub fn dimmed(&self, leds: &[Led], point: Vec3, wet: &Wet, i: usize) -> Vec<Led> {
        let dim = |led: &Led| {
            let way = -LOG2_E * wet.way(led.position, point, i);
            let intensity = [0, 1, 2].map(|k| led.intensity[k] * exp2(way * self.extinction(k)));
            Led { intensity, ..*led }
        };
        leds.iter().map(dim).collect()
    }

    /// Radiance of lane `i` after a piece of liquid, which begins on the eye's side at a point and
    /// goes on along a unit direction.
    #[inline(always)]
    pub fn carry(
        &self,
        color: Vec3,
        (start, direction, length): (Vec3, Vec3, f32),
        leds: &[Led],
        wet: &Wet,
        i: usize,
    ) -> Vec3 {
        let glow = self.glow((start, direction, length), leds, wet, i);
        [0, 1, 2].map(|k| color[k] * exp2(-LOG2_E * self.extinction(k) * length) + glow[k])
    }

    /// Light scattered once, by the midpoint rule over the way through the liquid.
    #[inline(always)]
    fn glow(
        &self,
        (start, direction, length): (Vec3, Vec3, f32),
        leds: &[Led],
        wet: &Wet,
        i: usize,
    ) -> Vec3 {
        const PARTS: usize = 4;
        /// Nearest that a point of the liquid counts to an LED [m].
        const NEAREST: f32 = 1e-3;
        let mut sum = [0.0; 3];
        for part in 0..PARTS {
            // Parts grow with the square of their number: most light comes back from nearby.
            let [from, to] = [part, part + 1].map(|p| (p * p) as f32 / (PARTS * PARTS) as f32);
            let way = 0.5 * (from + to) * length;
            let point = add(start, scale(direction, way));
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

    /// The surfaces themselves: what they let through of the radiance from beyond, what they mirror
    /// of that `mirrored` on the eye's side, and the mirror images of the LEDs.
    #[inline(always)]
    pub fn meet_surface(
        &self,
        directions: &Lane3,
        leds: &[Led],
        wet: &Wet,
        mirrored: &Lane3,
        radiance: &mut Lane3,
    ) {
        let (lanes, refracted) = (wet.turn.lanes(), wet.turn.refracted());
        for i in (0..LANES).filter(|&i| lanes[i]) {
            let images = self.images(at(directions, i), leds, wet, i);
            let share = if refracted[i] { wet.turn.share[i] } else { 0.0 };
            for k in 0..3 {
                let through = (1.0 - share) * radiance[k][i];
                radiance[k][i] = through + share * mirrored[k][i] + images[k];
            }
        }
    }

    /// Mirror images of the LEDs in the surface, which is rough by a Gaussian of slopes.
    #[inline(always)]
    fn images(&self, direction: Vec3, leds: &[Led], wet: &Wet, i: usize) -> Vec3 {
        let place = at(&wet.turn.place, i);
        let (cosine, square_roughness) = (direction[2].abs(), self.roughness * self.roughness);
        let mut sum = [0.0; 3];
        for led in leds {
            let offset = sub(led.position, place);
            let square = max(dot(offset, offset), 1e-8);
            let light = scale(offset, 1.0 / square.sqrt());
            let half = normalize(sub(light, direction));
            // The eye is on the side that the ray comes from.
            let normal = half[2] * -1f32.copysign(direction[2]);
            if normal <= 0.0 {
                continue;
            }
            let tilt = 2.0 * max(1.0 - normal, 0.0) / square_roughness;
            let density = exp2(-LOG2_E * tilt) / (PI * square_roughness);
            let lobe = led_lobe(led, light) * wet.turn.share[i] * density;
            let image = lobe / (4.0 * max(cosine, 0.05) * square);
            let way = if wet.under[i] { -LOG2_E * square.sqrt() } else { 0.0 };
            for k in 0..3 {
                sum[k] += led.intensity[k] * image * exp2(way * self.extinction(k));
            }
        }
        sum
    }
}

impl Wet {
    /// Whether any ray meets the surface.
    #[inline(always)]
    pub fn turns(&self) -> bool {
        self.turn.lanes().contains(&true)
    }

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
