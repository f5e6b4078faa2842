//! Rendering of one tile of an image: trace, shade and write every requested channel.

use crate::lumen::spheres::Near;
use crate::render::channels::{Channels, Place};
use crate::render::led_visibility::{LedVisibility, TilePoints, bits_of};
use crate::render::material::Surface;
use crate::render::path::PrimaryHit;
use crate::render::path::lumen_contents::LumenMedia;
use crate::render::ray_table::TileRays;
use crate::render::scene::SceneData;
use crate::render::shading::{Attributes, Shadows, attributes, light, surface};
use crate::render::view::View;
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::bundle::trace_in_bundles;
use crate::wall::packet::{Hits, MAX_DISTANCE, MISS, Pyramid, trace};

/// Scratch memory for a tile's spheres; reused between tiles.
#[derive(Default)]
pub struct Scratch {
    /// Spheres near some rays.
    pub near: Vec<Near>,
    /// Particles between an LED and surfaces.
    pub blocking: Vec<Near>,
    /// Visible fraction of each LED.
    pub fractions: Vec<Lane>,
}

impl TileLight<'_> {
    /// Writes the visible fraction of each LED in the pixels of a tile, given unit normals of the
    /// wall and with relief, if its visibility is known.
    #[inline(always)]
    pub fn fractions(&self, normals: [&Lane3; 2], tile: &TileRays, out: &mut Vec<Lane>) -> bool {
        let Some((visibility, place)) = self.visibility else { return false };
        visibility.fractions(place, normals, tile.is_wide, out);
        true
    }
}

/// Light at the surfaces of a tile that is computed before rendering.
#[derive(Clone, Copy, Default)]
pub struct TileLight<'a> {
    /// Indirect light.
    pub indirect: Option<&'a Lane3>,
    /// Visibility of the LEDs, and row and column of the tile in it; None for shadows of points.
    pub visibility: Option<(&'a LedVisibility<'a>, (usize, usize))>,
}

/// Renderer of the tiles of a view.
pub trait TileRenderer {
    /// Hits of the rays of a tile.
    type Seen: Send + Sync;

    /// Media of paths besides air.
    fn media(&self) -> Option<LumenMedia<'_>>;

    /// Traces the rays of a tile.
    fn see(&self, tile: &TileRays, scratch: &mut Scratch) -> Self::Seen;

    /// Points hit.
    fn points(&self, tile: &TileRays, seen: &Self::Seen) -> TilePoints;

    /// Clears the bits of points that particles occlude from a position.
    fn shade_particles(&self, place: Vec3, points: &Lane3, scratch: &mut Scratch, lit: &mut u64);

    /// Surfaces from which paths of a tile start.
    fn primary_hit(&self, tile: &TileRays, pixel: [u32; LANES], seen: &Self::Seen) -> PrimaryHit;

    /// Renders one tile.
    fn render_tile(
        &self,
        tile: &TileRays,
        place: Place,
        seen: &Self::Seen,
        light: TileLight<'_>,
        scratch: &mut Scratch,
        out: &mut Channels<'_>,
    );
}

/// Renderer of a wall with nothing in front of it.
#[derive(Clone, Copy)]
pub struct WallTiles<'a> {
    /// The wall.
    pub wall: &'a Wall,
    /// Labels, textures and reflectance of the wall.
    pub scene: &'a SceneData,
    /// The view.
    pub view: &'a View<'a>,
}

impl TileRenderer for WallTiles<'_> {
    type Seen = Hits;

    #[inline(always)]
    fn media(&self) -> Option<LumenMedia<'_>> {
        None
    }

    #[inline(always)]
    fn see(&self, tile: &TileRays, _: &mut Scratch) -> Hits {
        self.intersect(tile).1
    }

    #[inline(always)]
    fn points(&self, tile: &TileRays, hits: &Hits) -> TilePoints {
        let (mut position, mut used) = ([[0.0; LANES]; 3], [false; LANES]);
        for i in 0..LANES {
            used[i] = hits.triangle[i] != MISS;
            let direction = at(&tile.pyramid.directions, i);
            for k in 0..3 {
                position[k][i] =
                    self.view.origin[k] + hits.distance[i] * dot(self.view.to_world[k], direction);
            }
        }
        TilePoints { position, used: bits_of(&used), distance: hits.distance }
    }

    #[inline(always)]
    fn shade_particles(&self, _: Vec3, _: &Lane3, _: &mut Scratch, _: &mut u64) {}

    #[inline(always)]
    fn primary_hit(&self, tile: &TileRays, pixel: [u32; LANES], hits: &Hits) -> PrimaryHit {
        let rays = tile.pyramid.rotated(&self.view.to_world);
        let found = attributes(self.wall, self.scene, self.view.origin, &rays.directions, hits);
        let surface = surface(self.scene, &found, &hits.distance, tile.pixel_angle);
        PrimaryHit { surface, hit: found.hit, triangle: hits.triangle, pixel }
    }

    #[inline(always)]
    fn render_tile(
        &self,
        tile: &TileRays,
        place: Place,
        hits: &Hits,
        light: TileLight<'_>,
        scratch: &mut Scratch,
        out: &mut Channels<'_>,
    ) {
        let rays = tile.pyramid.rotated(&self.view.to_world);
        self.render_hits(tile, (&rays, hits), place, (light, scratch), out);
    }
}

/// Rays of a tile given the camera's position and the rows of its rotation, and their hits on a
/// wall.
#[inline(always)]
pub fn intersect(
    wall: &Wall,
    origin: Vec3,
    to_world: &[Vec3; 3],
    tile: &TileRays,
) -> (Pyramid, Hits) {
    let mut reach = [0.0; LANES];
    for i in 0..LANES {
        reach[i] = if tile.used[i] { MAX_DISTANCE } else { 0.0 };
    }
    let mut hits = Hits::within(reach);
    let rays = tile.pyramid.rotated(to_world);
    if tile.is_wide {
        trace_in_bundles(wall, origin, &rays, &tile.used, &mut hits);
    } else if tile.any {
        trace::<false>(&wall.bvh, origin, &rays, wall.extent, &mut hits);
    }
    (rays, hits)
}

impl WallTiles<'_> {
    /// Rays of a tile in the world, and their hits on the wall.
    #[inline(always)]
    pub fn intersect(&self, tile: &TileRays) -> (Pyramid, Hits) {
        intersect(self.wall, self.view.origin, &self.view.to_world, tile)
    }

    /// Renders one tile whose rays have hit only the wall.
    #[inline(always)]
    pub fn render_hits(
        &self,
        tile: &TileRays,
        (rays, hits): (&Pyramid, &Hits),
        place: Place,
        (given, scratch): (TileLight<'_>, &mut Scratch),
        out: &mut Channels<'_>,
    ) {
        let WallTiles { wall, scene, view } = *self;
        let found = attributes(wall, scene, view.origin, &rays.directions, hits);
        if out.wants_color() {
            let surface = surface(scene, &found, &hits.distance, tile.pixel_angle);
            let (without_base, subsurface) =
                view.split_subsurface(scene, &surface, hits, &hits.triangle);
            let lit = (without_base.as_ref().unwrap_or(&surface), subsurface.as_ref());
            let shadows = match (view.shadows, tile.is_wide) {
                _ if given.fractions(
                    [&found.normal, &surface.normal],
                    tile,
                    &mut scratch.fractions,
                ) =>
                {
                    Shadows::Known(&scratch.fractions)
                }
                (false, _) => Shadows::None,
                (true, false) => Shadows::ByLed,
                (true, true) => Shadows::ByPoint,
            };
            let leds = view.direct_leds();
            let mut radiance = light(wall, &scene.material, leds, shadows, lit, &found.hit);
            if let Some(irradiance) = &view.irradiance {
                irradiance.add((&surface, &found.normal), hits, subsurface.as_ref(), &mut radiance);
            }
            add_indirect(given.indirect, &mut radiance);
            write_color((&surface, &radiance), &found.hit, view.exposure, place, out);
        }
        write_geometry(view, tile, hits, &found, place, out);
    }
}

/// Writes base color and light of the surfaces hit.
#[inline(always)]
pub fn write_color(
    (surface, radiance): (&Surface, &Lane3),
    hit: &[bool; LANES],
    exposure: f32,
    place: Place,
    out: &mut Channels<'_>,
) {
    place.write_light(out, radiance, hit, exposure);
    place.write3(&mut out.albedo, &surface.albedo, hit, f32::NAN);
}

/// Adds indirect light, if any.
#[inline(always)]
pub fn add_indirect(indirect: Option<&Lane3>, radiance: &mut Lane3) {
    let Some(indirect) = indirect else { return };
    for k in 0..3 {
        for i in 0..LANES {
            radiance[k][i] += indirect[k][i];
        }
    }
}

/// Writes the geometry channels of the surfaces hit.
#[inline(always)]
pub fn write_geometry(
    view: &View<'_>,
    tile: &TileRays,
    hits: &Hits,
    found: &Attributes,
    place: Place,
    out: &mut Channels<'_>,
) {
    let hit = &found.hit;
    if out.depth.is_some() {
        let mut depth = [0.0; LANES];
        for i in 0..LANES {
            depth[i] = hits.distance[i] * tile.pyramid.directions[2][i];
        }
        place.write(&mut out.depth, &depth, hit, f32::NAN);
    }
    if out.normal.is_some() {
        let mut normal = [[0.0; LANES]; 3];
        for k in 0..3 {
            for i in 0..LANES {
                normal[k][i] = dot(view.to_camera[k], at(&found.normal, i));
            }
        }
        place.write3(&mut out.normal, &normal, hit, f32::NAN);
    }
    let position = |i: usize, k: usize| {
        if hit[i] { (f64::from(found.position[k][i]) + view.center[k]) as f32 } else { f32::NAN }
    };
    let face = |i: usize| if hit[i] { found.face[i] } else { -1 };
    let weight = |i: usize, k: usize| if hit[i] { found.weights[k][i] } else { f32::NAN };
    place.write_each(&mut out.position, 3, position);
    place.write_subsampled(&mut out.sparse_position, 3, position);
    place.write_subsampled(&mut out.sparse_face, 1, |i, _| face(i));
    place.write_subsampled(&mut out.sparse_weights, 2, weight);
    place.write(&mut out.ray_distance, &hits.distance, hit, f32::NAN);
    place.write(&mut out.arc_length, &found.arc_length, hit, f32::NAN);
    place.write(&mut out.label, &found.label, hit, 0);
    place.write(&mut out.instance, &found.instance, hit, 0);
    place.write_each(&mut out.face, 1, |i, _| face(i));
    place.write_each(&mut out.weights, 2, weight);
}
