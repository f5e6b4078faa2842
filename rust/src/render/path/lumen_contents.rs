//! Lumen contents along paths: particles stop and reflect light, bubbles and liquid attenuate it.
//!
//! Path segments are straight: nothing refracts them beyond the first surface.

use crate::lumen::clump::Met;
use crate::lumen::spheres::Near;
use crate::render::lumen::Contents;
use crate::render::lumen::liquid::DRY;
use crate::render::lumen::particle_surfaces::{Particles, paint};
use crate::render::material::Surface;
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::packet::MISS;
use crate::wall::query;
use crate::wall::ray::Hit;
use crate::wall::visibility::SHADOW_REACH;
use std::f32::consts::LOG2_E;

/// Contents of the lumen in which paths travel.
pub struct LumenMedia<'a> {
    /// Wall around the contents.
    pub wall: &'a Wall,
    /// Contents of the lumen.
    pub contents: &'a Contents,
    /// Pool below whose level the LEDs are.
    pub of_leds: u16,
}

impl LumenMedia<'_> {
    /// First hit of a ray, wall or particle, and the transmittance back along it.
    #[inline(always)]
    pub fn intersect(&self, start: Vec3, heading: Vec3, from: u32, hit: Hit) -> (Hit, Vec3) {
        let (distance, met) = self.meet_particles::<false>((start, heading), hit.distance);
        let mut hits = hit;
        if met.owner[0] != MISS {
            hits = Hit { distance, triangle: MISS, particle: met.owner[0], ..hits };
        }
        let end = add(start, scale(heading, hits.distance));
        let pool = self.pool_between((start, from), (end, hit.triangle));
        (hits, self.transmittance((start, heading, hits.distance), pool))
    }

    /// Transmittance from an LED to a point; 0 if a particle is in between.
    #[inline(always)]
    pub fn led_transmittance(&self, led: Vec3, point: Vec3) -> Vec3 {
        let offset = sub(point, led);
        let (heading, distance) = (normalize(offset), dot(offset, offset).sqrt());
        let reach = distance * SHADOW_REACH;
        if self.meet_particles::<true>((led, heading), reach).0 < reach {
            return [0.0; 3];
        }
        let pool = if self.of_leds == DRY { self.pool_at(point) } else { self.of_leds };
        self.transmittance((led, heading, distance), pool)
    }

    /// Distance to the first particle on a ray, or `until` if there is none [m], and the hit.
    #[inline(always)]
    fn meet_particles<const ANY: bool>(&self, ray: (Vec3, Vec3), until: f32) -> (f32, Met<1>) {
        let (chyme, mut near) = (&self.contents.chyme, Vec::new());
        chyme.along(ray.0, ray.1, until, |index, _, _| {
            near.push(Near { power: 0.0, index: index as u32 });
        });
        chyme.meet_ray::<ANY>(&mut near, ray, until)
    }

    /// Sets position and material of the particles among the surfaces hit.
    #[inline(always)]
    pub fn shade_particles(&self, hits: &[(u32, Hit)], surface: &mut Surface) {
        let mut particles = Particles::nothing();
        for (i, (_, hit)) in hits.iter().enumerate().filter(|(_, (_, hit))| hit.particle != MISS) {
            let met = self.contents.chyme.look_at(hit.particle, at(&surface.position, i));
            particles.take(i, (&met, 0));
            for k in 0..3 {
                surface.normal[k][i] = met.normal[k][0];
            }
        }
        paint(&self.contents.chyme, &particles, surface);
    }

    /// Transmittance along a segment through bubbles and the liquid of a pool.
    #[inline(always)]
    fn transmittance(&self, (start, heading, length): (Vec3, Vec3, f32), pool: u16) -> Vec3 {
        let mut transmittance = [1.0; 3];
        self.contents.bubbles.along(start, heading, length, |_, crossings, miss| {
            for distance in crossings {
                let passes = self.contents.film.passes(miss);
                transmittance = scale(
                    transmittance,
                    if distance > 0.0 && distance < length { passes } else { 1.0 },
                );
            }
        });
        let Some((pools, optics)) = self.contents.pools.as_ref().filter(|_| pool != DRY) else {
            return transmittance;
        };
        let level = pools.level(pool);
        let (below, above) = (level - start[2], level - start[2] - length * heading[2]);
        let sunk = max(below, 0.0) + max(above, 0.0);
        let soaked = length * sunk / max(below.abs() + above.abs(), 1e-9);
        [0, 1, 2].map(|k| transmittance[k] * exp2(-LOG2_E * optics.extinction(k) * soaked))
    }

    /// Pool through which a segment between two surfaces leads: that of the end that lies in it.
    #[inline(always)]
    fn pool_between(&self, start: (Vec3, u32), end: (Vec3, u32)) -> u16 {
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

    /// Pool in which a point at a surface lies.
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
