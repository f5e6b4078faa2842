//! One tile of an image with something in the lumen.
//!
//! Particles are surfaces like the wall: they take the place of the wall in every channel. Bubbles
//! and liquid are laid over what is behind them, and have channels of their own.

use super::Contents;
use super::bubble::{Behind, Eye};
use super::liquid::{DRY, Optics, Wet};
use super::spheres::Near;
use crate::channels::{Channels, Place};
use crate::lanes::*;
use crate::material::{Surface, add_light};
use crate::mucosa::noise::Lattice;
use crate::path::First;
use crate::query;
use crate::rays::TileRays;
use crate::render::{View, add_glow, primary, write_geometry};
use crate::scene::SceneData;
use crate::shade::{Attributes, attributes, surface};
use crate::tile::{Hits, MISS, Pyramid, farthest_of};
use crate::visibility::visible_tile;
use crate::wall::Wall;

/// `Channels::front_label` of a bubble; 0 is nothing.
pub const FRONT_BUBBLE: u8 = 1;
/// `Channels::front_label` of liquid.
pub const FRONT_LIQUID: u8 = 2;
/// `Attributes::face` of particle 0; the next have smaller numbers.
const FIRST_PARTICLE: i32 = -2;
/// Roughness of particles.
const CHYME_ROUGHNESS: f32 = 0.6;
/// Size of the lumps of a particle, as a share of its radius.
const LUMPS: f32 = 0.45;

/// What the tiles of one image share.
pub struct Filled<'a> {
    /// The wall.
    pub wall: &'a Wall,
    /// What is drawn on it.
    pub scene: &'a SceneData,
    /// What is in it.
    pub contents: &'a Contents,
    /// The view.
    pub view: &'a View<'a>,
    /// Pool in whose stretch the eye is.
    pub of_eye: u16,
}

/// Room for a tile's spheres; kept from tile to tile.
#[derive(Default)]
pub struct Room {
    near: Vec<Near>,
    blocking: Vec<Near>,
}

/// Triangles met, `MISS` where a particle hides them.
#[inline(always)]
fn of_wall(triangles: &[u32; LANES], owner: &[u32; LANES]) -> [u32; LANES] {
    std::array::from_fn(|i| if owner[i] == MISS { triangles[i] } else { MISS })
}

/// The nearest see-through thing in front of each surface.
struct Front {
    label: [u8; LANES],
    instance: [u16; LANES],
    distance: Lane,
}

impl<'a> Filled<'a> {
    /// A wall with contents as a view sees them.
    pub fn new(
        wall: &'a Wall,
        scene: &'a SceneData,
        contents: &'a Contents,
        view: &'a View<'a>,
    ) -> Self {
        let of_eye = contents.pools.as_ref().map_or(DRY, |(pools, _)| {
            let nearest = query::nearest(&wall.bvh, view.origin);
            pools.of_face(wall.faces[nearest.face as usize])
        });
        Filled { wall, scene, contents, view, of_eye }
    }

    /// The surfaces of wall and particles that paths set out from.
    #[inline(always)]
    pub fn first(&self, tile: &TileRays, pixel: [u32; LANES], room: &mut Room) -> First {
        let (rays, mut hits) = primary(self.wall, self.view, tile);
        let mut found =
            attributes(self.wall, self.scene, self.view.origin, &rays.directions, &hits);
        let owner = self.meet_particles(tile, &rays, &mut hits, &mut found, room);
        let mut surface = surface(self.scene, &found, &hits.distance, tile.pixel_angle);
        self.paint_particles(&owner, &mut surface);
        let triangle = of_wall(&hits.triangle, &owner);
        First { surface, hit: found.hit, triangle, pixel }
    }

    /// Renders one tile; `glow` is light beyond direct light.
    #[inline(always)]
    pub fn render_tile(
        &self,
        tile: &TileRays,
        place: Place,
        glow: Option<&Lane3>,
        room: &mut Room,
        out: &mut Channels<'_>,
    ) {
        let (wall, view) = (self.wall, self.view);
        let (rays, mut hits) = primary(wall, view, tile);
        let mut found = attributes(wall, self.scene, view.origin, &rays.directions, &hits);
        let owner = self.meet_particles(tile, &rays, &mut hits, &mut found, room);
        let wet = self.wet(&rays, &hits, &found);
        let covering = self.bubbles(tile, &rays, &hits, room);
        let mut front = Front::of_liquid(wet.as_ref(), &found.hit);
        let mut radiance = [[0.0; LANES]; 3];
        let colored = out.wants_color();
        if colored {
            let mut surface = surface(self.scene, &found, &hits.distance, tile.pixel_angle);
            self.paint_particles(&owner, &mut surface);
            let bare = view.bare(self.scene, &surface, &of_wall(&hits.triangle, &owner));
            let lit = bare.as_ref().unwrap_or(&surface);
            radiance = self.light(lit, &found.hit, wet.as_ref(), room);
            if let Some(bounced) = &view.bounced {
                let mut light = [[0.0; LANES]; 3];
                bounced.add((&surface, &found.normal), &hits, &mut light);
                if let (Some(wet), Some(optics)) = (&wet, self.optics()) {
                    optics.dim_even(&surface.position, wet, &mut light);
                }
                add_glow(Some(&light), &mut radiance);
            }
            add_glow(glow, &mut radiance);
            place.write3(&mut out.albedo, &surface.albedo, &found.hit, f32::NAN);
            if let (Some(wet), Some(optics)) = (&wet, self.optics()) {
                let lit = (&view.leds[..], &hits.distance);
                optics.cover(view.origin, &rays.directions, lit, wet, &mut radiance);
            }
        }
        let eye = Eye { origin: view.origin, rays: &rays, pixel_angle: tile.pixel_angle };
        for near in &covering {
            let sphere = &self.contents.bubbles.all[near.index as usize];
            let ways = sphere.crossings(view.origin, &rays.directions);
            front.add_bubble(sphere.instance, [&ways.near, &ways.far], &hits.distance);
            if colored {
                let mut behind = Behind { radiance: &mut radiance, distance: &hits.distance };
                self.contents.film.cover(sphere, &ways, &eye, &view.leds, &mut behind);
            }
        }
        place.write_color(&mut out.rgb, &radiance, view.exposure);
        place.write3(&mut out.radiance, &radiance, &found.hit, 0.0);
        front.write(tile, place, out);
        write_geometry(view, tile, &hits, &found, place, out);
    }

    fn optics(&self) -> Option<&Optics> {
        self.contents.pools.as_ref().map(|(_, optics)| optics)
    }

    /// Puts particles that hide the wall in its place; returns which sphere each lane sees.
    #[inline(always)]
    fn meet_particles(
        &self,
        tile: &TileRays,
        rays: &Pyramid,
        hits: &mut Hits,
        found: &mut Attributes,
        room: &mut Room,
    ) -> [u32; LANES] {
        let mut owner = [MISS; LANES];
        if !tile.any {
            return owner;
        }
        let (chyme, origin) = (&self.contents.chyme, self.view.origin);
        let farthest = farthest_of(&hits.distance);
        chyme.gather(origin, rays, self.wall.extent, farthest, &mut room.near);
        for near in &room.near {
            let ways = chyme.all[near.index as usize].crossings(origin, &rays.directions);
            for i in 0..LANES {
                let nearer = (ways.near[i] > 0.0) & (ways.near[i] < hits.distance[i]);
                hits.distance[i] = if nearer { ways.near[i] } else { hits.distance[i] };
                owner[i] = if nearer { near.index } else { owner[i] };
            }
        }
        for i in (0..LANES).filter(|&i| owner[i] != MISS) {
            let sphere = &chyme.all[owner[i] as usize];
            let inverse = 1.0 / sphere.radius;
            for k in 0..3 {
                let place = origin[k] + hits.distance[i] * rays.directions[k][i];
                found.position[k][i] = place;
                found.normal[k][i] = (place - sphere.center[k]) * inverse;
            }
            found.hit[i] = true;
            found.face[i] = FIRST_PARTICLE - sphere.number as i32;
            found.weights[0][i] = 0.0;
            found.weights[1][i] = 0.0;
            found.arc_length[i] = sphere.arc_length;
            found.label[i] = self.contents.label;
            found.instance[i] = sphere.instance;
        }
        owner
    }

    /// Gives particles their colour and their lumps.
    #[inline(always)]
    fn paint_particles(&self, owner: &[u32; LANES], surface: &mut Surface) {
        for i in (0..LANES).filter(|&i| owner[i] != MISS) {
            let sphere = &self.contents.chyme.all[owner[i] as usize];
            let size = LUMPS * sphere.radius;
            let own = sub(at(&surface.position, i), sphere.center);
            let lump = Lattice::new(sphere.number, size).displacement(own);
            let grain = Lattice::new(!sphere.number, 0.5 * size).displacement(own);
            let smooth = at(&surface.normal, i);
            let rough = [0, 1, 2].map(|k| smooth[k] + 0.4 * lump[k] + 0.25 * grain[k]);
            // Lumps that turn away from the viewer are not seen.
            let away = min(dot(rough, at(&surface.view, i)) - 0.05, 0.0);
            let normal = normalize(sub(rough, scale(at(&surface.view, i), away)));
            let shade = 1.0 + 0.25 * lump[0] + 0.2 * grain[1];
            for k in 0..3 {
                surface.normal[k][i] = normal[k];
                surface.albedo[k][i] = clamp(sphere.color[k] * shade, 0.0, 0.95);
            }
            surface.roughness[i] = CHYME_ROUGHNESS;
        }
    }

    /// Liquid on the way of each ray, if there is any in the organ.
    #[inline(always)]
    fn wet(&self, rays: &Pyramid, hits: &Hits, found: &Attributes) -> Option<Wet> {
        let (pools, _) = self.contents.pools.as_ref()?;
        let mut pool = [DRY; LANES];
        for i in 0..LANES {
            if hits.triangle[i] != MISS {
                pool[i] = pools.of_face(self.wall.bvh.corners[hits.triangle[i] as usize]);
            }
        }
        let eye = (self.view.origin, self.of_eye);
        let wet = pools.crossed(eye, &rays.directions, &hits.distance, &found.position, pool);
        wet.is_wet.contains(&true).then_some(wet)
    }

    /// Bubbles that the tile may see, the farthest first.
    #[inline(always)]
    fn bubbles(&self, tile: &TileRays, rays: &Pyramid, hits: &Hits, room: &mut Room) -> Vec<Near> {
        if !tile.any {
            return Vec::new();
        }
        let farthest = farthest_of(&hits.distance);
        let origin = self.view.origin;
        self.contents.bubbles.gather(origin, rays, self.wall.extent, farthest, &mut room.near);
        let all = &self.contents.bubbles.all;
        let number = |near: &Near| all[near.index as usize].number;
        room.near
            .sort_unstable_by(|a, b| b.power.total_cmp(&a.power).then(number(a).cmp(&number(b))));
        room.near.clone()
    }

    /// Radiance of the surfaces met, seen without what lies between.
    #[inline(always)]
    fn light(
        &self,
        surface: &Surface,
        hit: &[bool; LANES],
        wet: Option<&Wet>,
        room: &mut Room,
    ) -> Lane3 {
        let (wall, view) = (self.wall, self.view);
        let mut radiance = [[0.0; LANES]; 3];
        for led in &view.leds {
            let mut lit = *hit;
            if view.shadows {
                lit = visible_tile(wall, led.position, &surface.position, hit);
                let chyme = &self.contents.chyme;
                let points = &surface.position;
                chyme.shade(led.position, points, wall.extent, &mut room.blocking, &mut lit);
            }
            let (Some(wet), Some(optics)) = (wet, self.optics()) else {
                add_light(surface, &self.scene.material, led, &lit, &mut radiance);
                continue;
            };
            let mut light = [[0.0; LANES]; 3];
            add_light(surface, &self.scene.material, led, &lit, &mut light);
            optics.dim(led, &surface.position, wet, &mut light);
            for k in 0..3 {
                for i in 0..LANES {
                    radiance[k][i] += light[k][i];
                }
            }
        }
        radiance
    }
}

impl Front {
    #[inline(always)]
    fn of_liquid(wet: Option<&Wet>, hit: &[bool; LANES]) -> Self {
        let mut front =
            Front { label: [0; LANES], instance: [0; LANES], distance: [f32::INFINITY; LANES] };
        let Some(wet) = wet else { return front };
        for i in (0..LANES).filter(|&i| wet.is_wet[i] && hit[i]) {
            front.label[i] = FRONT_LIQUID;
            front.instance[i] = wet.pool[i];
            front.distance[i] = wet.start[i];
        }
        front
    }

    /// A bubble counts where the ray crosses its shell for the first time.
    #[inline(always)]
    fn add_bubble(&mut self, instance: u16, ways: [&Lane; 2], distance: &Lane) {
        for i in 0..LANES {
            let first = if ways[0][i] > 0.0 { ways[0][i] } else { ways[1][i] };
            let nearer = (first > 0.0) & (first < distance[i]) & (first < self.distance[i]);
            self.distance[i] = if nearer { first } else { self.distance[i] };
            self.label[i] = if nearer { FRONT_BUBBLE } else { self.label[i] };
            self.instance[i] = if nearer { instance } else { self.instance[i] };
        }
    }

    #[inline(always)]
    fn write(&self, tile: &TileRays, place: Place, out: &mut Channels<'_>) {
        let mut seen = [false; LANES];
        let mut depth = [0.0; LANES];
        for i in 0..LANES {
            seen[i] = tile.used[i] && self.label[i] != 0;
            depth[i] = self.distance[i] * tile.pyramid.directions[2][i];
        }
        place.write(&mut out.front_label, &self.label, &seen, 0);
        place.write(&mut out.front_instance, &self.instance, &seen, 0);
        place.write(&mut out.front_depth, &depth, &seen, f32::NAN);
    }
}
