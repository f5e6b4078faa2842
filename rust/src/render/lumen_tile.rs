//! Rendering of one tile of an image with lumen contents.
//!
//! Bubbles and liquid are composited over the surfaces behind them, and have separate channels. A
//! ray that hits the surface of a pool is refracted or reflected once.

use crate::lumen::spheres::Near;
use crate::render::channels::{Channels, Place};
use crate::render::led_visibility::{TilePoints, bits_of, lanes_of};
use crate::render::lumen::Contents;
use crate::render::lumen::foreground::Foreground;
use crate::render::lumen::intersect::LumenRays;
use crate::render::lumen::liquid::{DRY, Optics, Pools, Wet};
use crate::render::lumen::particle_surfaces::{Particles, paint, write_particles};
use crate::render::lumen::path_segment::{Bubbles, PathSegment, first_segment, unfolded};
use crate::render::lumen::refraction::{REFLECTED, REFRACTED, STRAIGHT, Turn};
use crate::render::material::Surface;
use crate::render::path::PrimaryHit;
use crate::render::path::lumen_contents::LumenMedia;
use crate::render::radiosity::SubsurfaceLight;
use crate::render::ray_table::TileRays;
use crate::render::shading::{
    Attributes, add_all_light, attributes, attributes_at, fraction, surface,
};
use crate::render::tile::{
    Scratch, TileLight, TileRenderer, WallTiles, add_indirect, write_color, write_geometry,
};
use crate::simd::f32x64::*;
use crate::wall::packet::{Hits, MISS, Pyramid, farthest_of};
use crate::wall::query;
use crate::wall::visibility::visible_tile;

/// Renderer of a wall with contents in front of it.
pub struct LumenTiles<'a> {
    bare: WallTiles<'a>,
    contents: &'a Contents,
    /// Pool in whose section the camera is.
    of_eye: u16,
}

/// Triangles hit, `MISS` where a particle occludes them.
#[inline(always)]
fn of_wall(triangles: &[u32; LANES], particles: &Particles) -> [u32; LANES] {
    std::array::from_fn(|i| if particles.owner[i] == MISS { triangles[i] } else { MISS })
}

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

/// Hits of the rays of a tile.
pub struct Seen {
    /// Hits of straight rays on the wall.
    straight: Hits,
    /// Surfaces finally visible, unless there is only the wall.
    surfaces: Option<Box<VisibleSurfaces>>,
}

/// Surfaces finally visible along the rays of a tile.
struct VisibleSurfaces {
    rays: Pyramid,
    /// Hits on the wall, also behind particles; distances along the whole path.
    hits: Hits,
    particles: Particles,
    found: Attributes,
    /// Bubbles that may be visible on straight rays from the camera, the farthest first.
    bubbles: Vec<Near>,
    /// Hits and surfaces without refraction in bubbles, if there is any: what labels state.
    unbent: Option<Box<(Hits, Attributes)>>,
    /// Liquid on the path, if any.
    wet: Option<Wet>,
}

impl VisibleSurfaces {
    /// Hits and surfaces without refraction in bubbles.
    fn unbent(&self) -> (&Hits, &Attributes) {
        match &self.unbent {
            Some(unbent) => (&unbent.0, &unbent.1),
            None => (&self.hits, &self.found),
        }
    }
}

impl TileRenderer for LumenTiles<'_> {
    type Seen = Seen;

    #[inline(always)]
    fn media(&self) -> Option<LumenMedia<'_>> {
        let is_under = |(pools, _): &&(Pools, Optics)| {
            self.of_eye != DRY && self.bare.view.origin[2] < pools.level(self.of_eye)
        };
        let under = self.contents.pools.as_ref().filter(is_under);
        let of_leds = if under.is_some() { self.of_eye } else { DRY };
        Some(LumenMedia { wall: self.bare.wall, contents: self.contents, of_leds })
    }

    #[inline(always)]
    fn see(&self, tile: &TileRays, scratch: &mut Scratch) -> Seen {
        let (rays, straight) = self.bare.intersect(tile);
        let met = (&rays, &straight);
        let is_wall = self.sees_wall_alone(tile, met, scratch);
        let surfaces = (!is_wall).then(|| Box::new(self.trace(tile, met, scratch)));
        Seen { straight, surfaces }
    }

    #[inline(always)]
    fn points(&self, tile: &TileRays, seen: &Seen) -> TilePoints {
        let Some(surfaces) = &seen.surfaces else { return self.bare.points(tile, &seen.straight) };
        let VisibleSurfaces { hits, found, .. } = &**surfaces;
        let used = bits_of(&found.hit);
        TilePoints { position: found.position, used, distance: hits.distance }
    }

    #[inline(always)]
    fn shade_particles(&self, place: Vec3, points: &Lane3, scratch: &mut Scratch, lit: &mut u64) {
        let chyme = &self.contents.chyme;
        if *lit == 0 || chyme.all.is_empty() {
            return;
        }
        let mut lanes = lanes_of(*lit);
        chyme.shade(place, points, self.bare.wall.extent, &mut scratch.blocking, &mut lanes);
        *lit = bits_of(&lanes);
    }

    #[inline(always)]
    fn primary_hit(&self, tile: &TileRays, pixel: [u32; LANES], seen: &Seen) -> PrimaryHit {
        let Some(surfaces) = &seen.surfaces else {
            return self.bare.primary_hit(tile, pixel, &seen.straight);
        };
        let VisibleSurfaces { hits, particles, found, .. } = &**surfaces;
        let surface = self.surface(found, hits, particles, tile.pixel_angle);
        let triangle = of_wall(&hits.triangle, particles);
        PrimaryHit { surface, hit: found.hit, triangle, pixel }
    }

    #[inline(always)]
    fn render_tile(
        &self,
        tile: &TileRays,
        place: Place,
        seen: &Seen,
        given: TileLight<'_>,
        scratch: &mut Scratch,
        out: &mut Channels<'_>,
    ) {
        let (wall, view) = (self.bare, self.bare.view);
        let Some(seen) = &seen.surfaces else {
            let rays = tile.pyramid.rotated(&view.to_world);
            Foreground::of_liquid(None).write(tile, place, out);
            place.write(&mut out.refraction_label, &[STRAIGHT; LANES], &tile.used, STRAIGHT);
            place.write_subsampled(&mut out.sparse_refraction, 1, |_, _| STRAIGHT);
            wall.render_hits(tile, (&rays, &seen.straight), place, (given, scratch), out);
            return;
        };
        let VisibleSurfaces { rays, hits, particles, found, bubbles, wet, .. } = &**seen;
        let (unbent_hits, unbent) = seen.unbent();
        if out.wants_color() {
            let surface = self.surface(found, hits, particles, tile.pixel_angle);
            let triangles = of_wall(&hits.triangle, particles);
            let (without_base, subsurface) =
                view.split_subsurface(wall.scene, &surface, hits, &triangles);
            let lit = (without_base.as_ref().unwrap_or(&surface), subsurface.as_ref());
            let mut fractions = std::mem::take(&mut scratch.fractions);
            let is_known = given.fractions([&found.normal, &surface.normal], tile, &mut fractions);
            let visible = is_known.then_some(&fractions[..]);
            let mut radiance = self.light(lit, (found, hits), wet.as_ref(), visible, scratch);
            scratch.fractions = fractions;
            add_indirect(given.indirect, &mut radiance);
            self.transmit(seen, tile.pixel_angle, scratch, &mut radiance);
            write_color((&surface, &radiance), &found.hit, view.exposure, place, out);
        }
        let mut front = Foreground::of_liquid(wet.as_ref());
        let reach = first_segment(wet.as_ref(), unbent_hits);
        for near in bubbles {
            // The first crossing of bubbles that overlap is that of a sphere.
            let sphere = &self.contents.bubbles.all[near.index as usize];
            let [first, second, _] = sphere.ends(&|_| view.origin, &rays.directions);
            front.add_bubble(sphere.instance, [&first, &second], &reach);
        }
        front.write(tile, place, out);
        let kind = wet.as_ref().map_or([STRAIGHT; LANES], |wet| wet.turn.kind);
        place.write(&mut out.refraction_label, &kind, &unbent.hit, STRAIGHT);
        place.write_subsampled(&mut out.sparse_refraction, 1, |i, _| kind[i]);
        write_geometry(view, tile, unbent_hits, unbent, place, out);
    }
}

impl<'a> LumenTiles<'a> {
    /// A wall with contents in a view.
    pub fn new(bare: WallTiles<'a>, contents: &'a Contents) -> Self {
        let WallTiles { wall, view, .. } = bare;
        let of_eye = contents.pools.as_ref().map_or(DRY, |(pools, _)| {
            let nearest = query::nearest(&wall.bvh, view.origin);
            pools.of_face(wall.faces[nearest.face as usize])
        });
        LumenTiles { bare, contents, of_eye }
    }

    /// Rays from the camera among wall and particles.
    #[inline(always)]
    fn rays(&self) -> LumenRays<'_> {
        let WallTiles { wall, view, .. } = self.bare;
        LumenRays { wall, chyme: &self.contents.chyme, eye: view.origin }
    }

    /// True if there is nothing but the wall on a tile's rays and between their hits and the LEDs.
    #[inline(always)]
    fn sees_wall_alone(
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
        let (mut low, mut high) = (origin, origin);
        let mut enclose = |point: Vec3| {
            for k in 0..3 {
                low[k] = min(low[k], point[k]);
                high[k] = max(high[k], point[k]);
            }
        };
        for led in leds {
            enclose(led.position.map(|x| x - led.radius));
            enclose(led.position.map(|x| x + led.radius));
        }
        for i in 0..LANES {
            enclose(add(origin, scale(at(&rays.directions, i), hits.distance[i])));
        }
        self.contents.chyme.within((low, high), origin, &mut scratch.near);
        !scratch.near.is_empty()
    }

    fn optics(&self) -> Option<&Optics> {
        self.contents.pools.as_ref().map(|(_, optics)| optics)
    }

    /// Traces the rays of a tile, through the surface of a pool where they hit one.
    #[inline(always)]
    fn trace(
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

    #[inline(always)]
    fn surface(
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
    fn in_order(&self, scratch: &mut Scratch) -> Vec<Near> {
        let all = &self.contents.bubbles.all;
        let number = |near: &Near| all[near.index as usize].number;
        scratch
            .near
            .sort_unstable_by(|a, b| b.power.total_cmp(&a.power).then(number(a).cmp(&number(b))));
        scratch.near.clone()
    }

    /// Transports radiance from the surfaces hit to the camera.
    #[inline(always)]
    fn transmit(
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
    fn light(
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
