//! Rendering of one tile of an image with lumen contents.
//!
//! Bubbles and liquid are composited over the surfaces behind them, and have separate channels. A
//! ray that hits the surface of a pool is refracted or reflected once.

mod trace;
mod transport;

use crate::lumen::spheres::Near;
use crate::render::channels::{Channels, Place};
use crate::render::led_visibility::{TilePoints, bits_of, lanes_of};
use crate::render::lumen::Contents;
use crate::render::lumen::foreground::Foreground;
use crate::render::lumen::liquid::{DRY, Optics, Pools, Wet};
use crate::render::lumen::particle_surfaces::Particles;
use crate::render::lumen::path_segment::first_segment;
use crate::render::lumen::refraction::STRAIGHT;
use crate::render::path::PrimaryHit;
use crate::render::path::lumen_contents::LumenMedia;
use crate::render::ray_table::TileRays;
use crate::render::shading::Attributes;
use crate::render::tile::{
    Scratch, TileLight, TileRenderer, WallTiles, add_indirect, write_color, write_geometry,
};
use crate::simd::f32x64::*;
use crate::wall::packet::{Hits, MISS, Pyramid};
use crate::wall::query;

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
}
