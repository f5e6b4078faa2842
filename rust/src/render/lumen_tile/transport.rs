//! Radiance of the visible surfaces, and its transport through liquid and bubbles to the camera.

use super::{LumenTiles, VisibleSurfaces};
use crate::render::lumen::liquid::{Optics, Wet};
use crate::render::lumen::particle_surfaces::{Particles, paint, write_particles};
use crate::render::lumen::path_segment::{Bubbles, PathSegment, first_segment, unfolded};
use crate::render::lumen::refraction::REFRACTED;
use crate::render::material::Surface;
use crate::render::radiosity::SubsurfaceLight;
use crate::render::shading::{Attributes, add_all_light, attributes_at, fraction, surface};
use crate::render::tile::{Scratch, add_indirect};
use crate::simd::f32x64::*;
use crate::wall::packet::{Hits, Pyramid};
use crate::wall::visibility::visible_tile;

impl LumenTiles<'_> {
    fn optics(&self) -> Option<&Optics> {
        self.contents.pools.as_ref().map(|(_, optics)| optics)
    }

    #[inline(always)]
    pub(super) fn surface(
        &self,
        found: &Attributes,
        hits: &Hits,
        particles: &Particles,
        pixel_angle: f32,
    ) -> Surface {
        let mut surface = surface(self.bare.scene, found, &hits.distance, pixel_angle);
        paint(&self.contents.chyme, particles, &mut surface);
        surface
    }

    /// Transports radiance from the surfaces hit to the camera.
    #[inline(always)]
    pub(super) fn transmit(
        &self,
        seen: &VisibleSurfaces,
        pixel_angle: f32,
        scratch: &mut Scratch,
        radiance: &mut Lane3,
    ) {
        let VisibleSurfaces { rays, bubbles, wet, .. } = seen;
        let hits = seen.unbent().0;
        let (leds, film) = (&self.bare.view.leds[..], &self.contents.film);
        let spheres = &self.contents.bubbles;
        let liquid = self.optics().zip(wet.as_ref());
        let mut soaked = [false; LANES];
        if let Some((optics, wet)) = liquid {
            soaked = wet.under;
            if wet.turns() {
                self.transmit_beyond((optics, wet), hits, pixel_angle, scratch, radiance);
                let mirrored = self.mirrored((optics, wet), rays, pixel_angle, scratch);
                optics.meet_surface(&rays.directions, leds, wet, &mirrored, radiance);
            }
            for i in 0..LANES {
                soaked[i] &= wet.is_wet[i];
            }
        }
        let origin = self.bare.view.origin;
        let leg = PathSegment {
            rays,
            starts: &origin.map(|x| [x; LANES]),
            origin,
            used: &[true; LANES],
            soaked,
            from: &[0.0; LANES],
            to: &first_segment(wet.as_ref(), hits),
        };
        let bubbles = Bubbles { spheres, near: bubbles, film, pixel_angle };
        leg.carry(&bubbles, liquid, leds, radiance);
    }

    /// Transports radiance from the surfaces hit to the pool surfaces on the path.
    #[inline(always)]
    fn transmit_beyond(
        &self,
        (optics, wet): (&Optics, &Wet),
        hits: &Hits,
        pixel_angle: f32,
        scratch: &mut Scratch,
        radiance: &mut Lane3,
    ) {
        let turn = &wet.turn;
        let mut ends = turn.place;
        for k in 0..3 {
            for i in 0..LANES {
                ends[k][i] += (hits.distance[i] - turn.distance[i]) * turn.heading[k][i];
            }
        }
        let lanes = turn.lanes();
        let (starts, origin, around) = unfolded(turn, &turn.heading, &ends, &lanes);
        self.contents.bubbles.within(around, origin, &mut scratch.near);
        let near = self.in_order(scratch);
        let sunk = |i: usize| wet.is_wet[i] & (wet.under[i] != (turn.kind[i] == REFRACTED));
        let leg = PathSegment {
            rays: &Pyramid { directions: turn.heading, ..Pyramid::open() },
            starts: &starts,
            origin,
            used: &lanes,
            soaked: std::array::from_fn(sunk),
            from: &turn.distance,
            to: &hits.distance,
        };
        let (spheres, film) = (&self.contents.bubbles, &self.contents.film);
        let bubbles = Bubbles { spheres, near: &near, film, pixel_angle };
        leg.carry(&bubbles, Some((optics, wet)), &self.bare.view.leds, radiance);
    }

    /// Radiance that pool surfaces reflect where they also transmit rays.
    #[inline(always)]
    fn mirrored(
        &self,
        (optics, wet): (&Optics, &Wet),
        rays: &Pyramid,
        pixel_angle: f32,
        scratch: &mut Scratch,
    ) -> Lane3 {
        let turn = &wet.turn;
        let lanes = turn.are(REFRACTED);
        if !lanes.contains(&true) {
            return [[0.0; LANES]; 3];
        }
        let mirror = rays.mirrored();
        let (hits, particles) =
            self.rays().intersect_reflected(&mirror, turn, &lanes, &mut scratch.near);
        let (mut position, mut view) = (turn.place, mirror.directions);
        for k in 0..3 {
            for i in 0..LANES {
                let distance = if lanes[i] { hits.distance[i] - turn.distance[i] } else { 0.0 };
                position[k][i] += distance * mirror.directions[k][i];
                view[k][i] = -mirror.directions[k][i];
            }
        }
        let mut found = attributes_at(self.bare.wall, self.bare.scene, position, view, &hits);
        write_particles(&self.contents.chyme, self.contents.label, &particles, &mut found);
        let surface = self.surface(&found, &hits, &particles, pixel_angle);
        let in_liquid = wet.under.contains(&true);
        let mut radiance =
            self.light((&surface, None), (&found, &hits), in_liquid.then_some(wet), None, scratch);
        if !in_liquid {
            return radiance;
        }
        let (starts, origin, _) = unfolded(turn, &mirror.directions, &position, &lanes);
        let leg = PathSegment {
            rays: &mirror,
            starts: &starts,
            origin,
            used: &lanes,
            soaked: std::array::from_fn(|i| wet.is_wet[i] & wet.under[i] & found.hit[i]),
            from: &turn.distance,
            to: &hits.distance,
        };
        let (spheres, film) = (&self.contents.bubbles, &self.contents.film);
        let bubbles = Bubbles { spheres, near: &[], film, pixel_angle };
        leg.carry(&bubbles, Some((optics, wet)), &self.bare.view.leds, &mut radiance);
        radiance
    }

    /// Radiance of the surfaces hit, without the media in between, given the visible fraction of
    /// each LED, or shadows from LED centers.
    #[inline(always)]
    pub(super) fn light(
        &self,
        (surface, subsurface): (&Surface, Option<&SubsurfaceLight>),
        (found, hits): (&Attributes, &Hits),
        wet: Option<&Wet>,
        visible: Option<&[Lane]>,
        scratch: &mut Scratch,
    ) -> Lane3 {
        let (wall, view, hit) = (self.bare.wall, self.bare.view, &found.hit);
        let liquid = self.optics().zip(wet);
        let mut radiance = [[0.0; LANES]; 3];
        for (k, led) in view.direct_leds().iter().enumerate() {
            let mut lit = *hit;
            if view.shadows && visible.is_none() {
                lit = visible_tile(wall, led.position, &surface.position, hit);
                let chyme = &self.contents.chyme;
                let points = &surface.position;
                chyme.shade(led.position, points, wall.extent, &mut scratch.blocking, &mut lit);
            }
            let lit = visible.map_or_else(|| fraction(&lit), |visible| visible[k]);
            let Some((optics, wet)) = liquid else {
                add_all_light(
                    (surface, subsurface),
                    &self.bare.scene.material,
                    led,
                    &lit,
                    &mut radiance,
                );
                continue;
            };
            let mut light = [[0.0; LANES]; 3];
            add_all_light((surface, subsurface), &self.bare.scene.material, led, &lit, &mut light);
            optics.dim(led, &surface.position, wet, &mut light);
            add_indirect(Some(&light), &mut radiance);
        }
        if let Some(irradiance) = &view.irradiance {
            let mut light = [[0.0; LANES]; 3];
            irradiance.add((surface, &found.normal), hits, subsurface, &mut light);
            if let Some((optics, wet)) = liquid {
                optics.dim_even(&surface.position, wet, &mut light);
            }
            add_indirect(Some(&light), &mut radiance);
        }
        radiance
    }
}
