//! What floats in the lumen on the ways of paths: particles stop and reflect light, bubbles and
//! liquid take their share of it.
//!
//! Ways are straight: a path that goes on from what the camera sees is refracted by nothing.

use crate::lumen::Contents;
use crate::lumen::liquid::DRY;
use crate::lumen::particle_surfaces::paint;
use crate::render::material::Surface;
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::packet::MISS;
use crate::wall::query;
use crate::wall::ray::Hit;
use crate::wall::visibility::FREE_WAY;
use std::f32::consts::LOG2_E;

/// Contents of the lumen that paths travel in.
pub struct Afloat<'a> {
    /// The wall around them.
    pub wall: &'a Wall,
    /// What they are.
    pub contents: &'a Contents,
    /// Pool under whose level the LEDs are.
    pub of_leds: u16,
}

impl Afloat<'_> {
    /// What a ray meets first, wall or particle, and what is left of the light that comes back along
    /// it.
    #[inline(always)]
    pub fn meet(&self, start: Vec3, heading: Vec3, from: u32, hit: Hit) -> (Hit, Vec3) {
        let mut met = hit;
        self.contents.chyme.along(start, heading, hit.distance, |index, [near, _], _| {
            if near > 0.0 && near < met.distance {
                met = Hit { distance: near, triangle: MISS, particle: index as u32, ..met };
            }
        });
        let end = add(start, scale(heading, met.distance));
        let pool = self.pool_along((start, from), (end, hit.triangle));
        (met, self.left((start, heading, met.distance), pool))
    }

    /// What is left of an LED's light at a point; nothing where a particle is in the way.
    #[inline(always)]
    pub fn led_left(&self, led: Vec3, point: Vec3) -> Vec3 {
        let offset = sub(point, led);
        let (heading, distance) = (normalize(offset), dot(offset, offset).sqrt());
        let reach = distance * FREE_WAY;
        let mut is_free = true;
        self.contents.chyme.along(led, heading, reach, |_, [near, _], _| {
            is_free &= !(near > 0.0 && near < reach);
        });
        if !is_free {
            return [0.0; 3];
        }
        let pool = if self.of_leds == DRY { self.pool_at(point) } else { self.of_leds };
        self.left((led, heading, distance), pool)
    }

    /// Gives the particles among the surfaces met their place and look.
    #[inline(always)]
    pub fn show(&self, met: &[(u32, Hit)], surface: &mut Surface) {
        let mut owner = [MISS; LANES];
        for (i, (_, hit)) in met.iter().enumerate() {
            owner[i] = hit.particle;
            if hit.particle != MISS {
                let sphere = &self.contents.chyme.all[hit.particle as usize];
                let normal = normalize(sub(at(&surface.position, i), sphere.center));
                for k in 0..3 {
                    surface.normal[k][i] = normal[k];
                }
            }
        }
        paint(&self.contents.chyme, &owner, surface);
    }

    /// Share of light that gets along a way through bubbles and the liquid of a pool.
    #[inline(always)]
    fn left(&self, (start, heading, length): (Vec3, Vec3, f32), pool: u16) -> Vec3 {
        let mut left = [1.0; 3];
        self.contents.bubbles.along(start, heading, length, |_, ways, miss| {
            for way in ways {
                let passes = self.contents.film.passes(miss);
                left = scale(left, if way > 0.0 && way < length { passes } else { 1.0 });
            }
        });
        let Some((pools, optics)) = self.contents.pools.as_ref().filter(|_| pool != DRY) else {
            return left;
        };
        let level = pools.level(pool);
        let (below, above) = (level - start[2], level - start[2] - length * heading[2]);
        let sunk = max(below, 0.0) + max(above, 0.0);
        let way = length * sunk / max(below.abs() + above.abs(), 1e-9);
        [0, 1, 2].map(|k| left[k] * exp2(-LOG2_E * optics.extinction(k) * way))
    }

    /// Pool that a way from one surface to another leads through: of the end that lies in it.
    #[inline(always)]
    fn pool_along(&self, start: (Vec3, u32), end: (Vec3, u32)) -> u16 {
        let Some((pools, _)) = &self.contents.pools else { return DRY };
        for (point, triangle) in [start, end] {
            if triangle == MISS {
                continue;
            }
            let pool = pools.of_face(self.wall.bvh.corners[triangle as usize]);
            if pool != DRY && point[2] < pools.level(pool) {
                return pool;
            }
        }
        DRY
    }

    /// Pool that a point at a surface lies in.
    #[inline(always)]
    fn pool_at(&self, point: Vec3) -> u16 {
        let Some((pools, _)) = &self.contents.pools else { return DRY };
        if pools.levels.iter().all(|&level| point[2] >= level) {
            return DRY;
        }
        let nearest = query::nearest(&self.wall.bvh, point);
        let pool = pools.of_face(self.wall.faces[nearest.face as usize]);
        if pool != DRY && point[2] < pools.level(pool) { pool } else { DRY }
    }
}
