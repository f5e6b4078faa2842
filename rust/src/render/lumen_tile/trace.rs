//! Surfaces visible along the rays of a tile, through pool surfaces and bubbles.

use super::{LumenTiles, VisibleSurfaces};
use crate::lumen::spheres::Near;
use crate::render::lumen::Contents;
use crate::render::lumen::intersect::LumenRays;
use crate::render::lumen::liquid::{DRY, Wet};
use crate::render::lumen::particle_surfaces::{Particles, write_particles};
use crate::render::lumen::refraction::{REFLECTED, REFRACTED, STRAIGHT, Turn};
use crate::render::ray_table::TileRays;
use crate::render::shading::{Attributes, attributes, attributes_at};
use crate::render::tile::{Scratch, WallTiles};
use crate::simd::f32x64::*;
use crate::wall::packet::{Hits, MISS, Pyramid, farthest_of};

/// Takes the hits of rays beyond their turns, in some lanes.
#[inline(always)]
fn take(
    turn: &Turn,
    lanes: &[bool; LANES],
    (met, theirs): (&Hits, &Particles),
    (hits, particles): (&mut Hits, &mut Particles),
    (position, view): (&mut Lane3, &mut Lane3),
) {
    for i in (0..LANES).filter(|&i| lanes[i]) {
        hits.distance[i] = met.distance[i];
        hits.triangle[i] = met.triangle[i];
        particles.take(i, (theirs, i));
        for k in 0..3 {
            hits.edges[k][i] = met.edges[k][i];
            let offset = (met.distance[i] - turn.distance[i]) * turn.heading[k][i];
            position[k][i] = turn.place[k][i] + offset;
            view[k][i] = -turn.heading[k][i];
        }
    }
}

impl LumenTiles<'_> {
    /// Rays from the camera among wall and particles.
    #[inline(always)]
    pub(super) fn rays(&self) -> LumenRays<'_> {
        let WallTiles { wall, view, .. } = self.bare;
        LumenRays { wall, chyme: &self.contents.chyme, eye: view.origin }
    }

    /// True if there is nothing but the wall on a tile's rays and between their hits and the LEDs.
    #[inline(always)]
    pub(super) fn sees_wall_alone(
        &self,
        tile: &TileRays,
        (rays, hits): (&Pyramid, &Hits),
        scratch: &mut Scratch,
    ) -> bool {
        let Contents { chyme, pools, .. } = self.contents;
        if pools.is_some() || (!chyme.all.is_empty() && self.has_particles(rays, hits, scratch)) {
            return false;
        }
        self.gather(tile, rays, hits, scratch);
        scratch.near.is_empty()
    }

    /// True if particles may be in the bounding box of camera, LEDs and hits.
    #[inline(always)]
    fn has_particles(&self, rays: &Pyramid, hits: &Hits, scratch: &mut Scratch) -> bool {
        let (origin, leds) = (self.bare.view.origin, &self.bare.view.leds);
        let mut around = (origin, origin);
        for led in leds {
            enclose(&mut around, led.position.map(|x| x - led.radius));
            enclose(&mut around, led.position.map(|x| x + led.radius));
        }
        for i in 0..LANES {
            let end = add(origin, scale(at(&rays.directions, i), hits.distance[i]));
            enclose(&mut around, end);
        }
        self.contents.chyme.within(around, origin, &mut scratch.near);
        !scratch.near.is_empty()
    }

    /// Traces the rays of a tile, through the surface of a pool where they hit one.
    #[inline(always)]
    pub(super) fn trace(
        &self,
        tile: &TileRays,
        met: (&Pyramid, &Hits),
        scratch: &mut Scratch,
    ) -> VisibleSurfaces {
        let (wall, scene, view) = (self.bare.wall, self.bare.scene, self.bare.view);
        let (rays, mut hits) = (met.0.clone(), met.1.clone());
        let mut particles = Particles::nothing();
        if tile.any {
            particles = self.rays().intersect_particles(&rays, &mut hits, &mut scratch.near);
        }
        let mut found = attributes(wall, scene, view.origin, &rays.directions, &hits);
        let mut wet = if tile.any { self.wet(&rays, &hits, &found) } else { None };
        if let Some(Wet { turn, .. }) = wet.as_ref().filter(|wet| wet.turns()) {
            for kind in [REFRACTED, REFLECTED] {
                let lanes = turn.are(kind);
                if !lanes.contains(&true) {
                    continue;
                }
                let (met, theirs) = if kind == REFRACTED {
                    self.rays().intersect_refracted(turn, &lanes, &mut scratch.near)
                } else {
                    self.rays().intersect_reflected(
                        &rays.mirrored(),
                        turn,
                        &lanes,
                        &mut scratch.near,
                    )
                };
                let (position, view) = (&mut found.position, &mut found.view);
                let beyond = (&met, &theirs);
                take(turn, &lanes, beyond, (&mut hits, &mut particles), (position, view));
            }
            found = attributes_at(wall, scene, found.position, found.view, &hits);
        }
        write_particles(&self.contents.chyme, self.contents.label, &particles, &mut found);
        if let Some(wet) = &mut wet {
            for i in 0..LANES {
                wet.is_wet[i] &= found.hit[i];
                wet.turn.kind[i] = if found.hit[i] { wet.turn.kind[i] } else { STRAIGHT };
            }
        }
        self.gather(tile, &rays, &hits, scratch);
        let bubbles = self.in_order(scratch);
        let mut seen = VisibleSurfaces { rays, hits, particles, found, bubbles, unbent: None, wet };
        if seen.wet.is_none() {
            self.refract_in_bubbles(&mut seen, scratch);
        }
        seen
    }

    /// Replaces surfaces by those that refraction in bubbles makes visible.
    #[inline(always)]
    fn refract_in_bubbles(&self, seen: &mut VisibleSurfaces, scratch: &mut Scratch) {
        let (wall, scene, origin) = (self.bare.wall, self.bare.scene, self.bare.view.origin);
        let Contents { bubbles, chyme, film, label, .. } = self.contents;
        let near = (bubbles, &seen.bubbles[..]);
        let turn = film.refract(near, wall, (origin, &seen.rays), &seen.hits.distance);
        let Some(turn) = turn else { return };
        let mut lanes = turn.are(REFRACTED);
        let (met, theirs) = self.rays().intersect_refracted(&turn, &lanes, &mut scratch.near);
        for i in 0..LANES {
            lanes[i] &= (met.triangle[i] != MISS) | (theirs.owner[i] != MISS);
        }
        let (mut hits, mut particles) = (seen.hits.clone(), seen.particles.clone());
        let (mut position, mut view) = (seen.found.position, seen.found.view);
        let beyond = (&met, &theirs);
        take(&turn, &lanes, beyond, (&mut hits, &mut particles), (&mut position, &mut view));
        let mut found = attributes_at(wall, scene, position, view, &hits);
        write_particles(chyme, *label, &particles, &mut found);
        let unbent =
            (std::mem::replace(&mut seen.hits, hits), std::mem::replace(&mut seen.found, found));
        (seen.particles, seen.unbent) = (particles, Some(Box::new(unbent)));
    }

    /// Liquid on the path of each ray, if any.
    #[inline(always)]
    fn wet(&self, rays: &Pyramid, hits: &Hits, found: &Attributes) -> Option<Wet> {
        let (pools, optics) = self.contents.pools.as_ref()?;
        let mut pool = [DRY; LANES];
        for i in 0..LANES {
            if hits.triangle[i] != MISS {
                pool[i] = pools.of_face(self.bare.wall.bvh.corners[hits.triangle[i] as usize]);
            }
        }
        let eye = (self.bare.view.origin, self.of_eye);
        let wet = pools.crossed(eye, &rays.directions, &found.position, pool, optics.ior);
        wet.is_wet.contains(&true).then_some(wet)
    }

    /// Collects bubbles that may be visible in front of the wall.
    #[inline(always)]
    fn gather(&self, tile: &TileRays, rays: &Pyramid, hits: &Hits, scratch: &mut Scratch) {
        scratch.near.clear();
        if !tile.any {
            return;
        }
        let (origin, extent) = (self.bare.view.origin, self.bare.wall.extent);
        let farthest = farthest_of(&hits.distance);
        self.contents.bubbles.gather(origin, rays, extent, farthest, &mut scratch.near);
    }

    /// The spheres in `scratch`, the farthest first.
    pub(super) fn in_order(&self, scratch: &mut Scratch) -> Vec<Near> {
        let all = &self.contents.bubbles.all;
        let number = |near: &Near| all[near.index as usize].number;
        scratch
            .near
            .sort_unstable_by(|a, b| b.power.total_cmp(&a.power).then(number(a).cmp(&number(b))));
        scratch.near.clone()
    }
}
