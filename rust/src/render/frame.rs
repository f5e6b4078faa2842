//! One image: trace, shade and write every channel that was asked for.

use crate::cpu::on_pool;
use crate::lumen::Contents;
use crate::lumen::tile::{Filled, Room};
use crate::poses::read_pose;
use crate::render::channels::{ChannelArrays, Channels, Place};
use crate::render::material::{Led, Surface};
use crate::render::path::light_paths::LightTransport;
use crate::render::path::lumen_contents::LumenMedia;
use crate::render::path::virtual_lights::VirtualLights;
use crate::render::path::{PrimaryHit, Settings, wavefront};
use crate::render::radiosity::{Irradiance, Radiosity, SubsurfaceLight};
use crate::render::ray_table::{RayTable, TileRays};
use crate::render::scene::{Scene, SceneData};
use crate::render::shading::{Attributes, attributes, light, surface};
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::packet::{Hits, MAX_DISTANCE, Pyramid, trace};
use glam::DVec3;
use numpy::PyReadonlyArray2;
use pyo3::{exceptions::PyValueError, prelude::*, types::PyDict};
use rayon::prelude::*;

/// Everything about a view but its rays.
pub struct View<'a> {
    /// Where the camera is, about the wall's center [m].
    pub origin: Vec3,
    /// Rows of the rotation from the camera to the world, and back.
    pub to_world: [Vec3; 3],
    to_camera: [Vec3; 3],
    center: [f64; 3],
    /// LEDs about the wall's center.
    pub leds: Vec<Led>,
    /// Factor from radiance to linear image value.
    pub exposure: f32,
    /// Whether things cast shadows.
    pub shadows: bool,
    /// How light that is reflected more than once is found; None for direct light alone.
    pub paths: Option<Settings>,
    /// Irradiance by light that has bounced, if it is found as radiosity.
    pub irradiance: Option<Irradiance<'a>>,
    /// Where the LEDs' light comes from, if paths are connected to that.
    pub sources: Option<VirtualLights>,
}

impl View<'_> {
    fn new(
        wall: &Wall,
        pose: PyReadonlyArray2<'_, f64>,
        leds: PyReadonlyArray2<'_, f64>,
        exposure: f32,
        shadows: bool,
    ) -> PyResult<Self> {
        let (given, leds) = (pose, leds.as_array());
        let pose = given.as_array();
        if pose.dim() != (4, 4) || !pose.iter().all(|x| x.is_finite()) {
            return Err(PyValueError::new_err("A camera pose must be a finite 4 x 4 matrix."));
        }
        if leds.ncols() != 10 {
            return Err(PyValueError::new_err("LEDs must be of shape (k, 10)."));
        }
        let to_world = [0, 1, 2].map(|r| [0, 1, 2].map(|c| pose[[r, c]] as f32));
        let to_camera = [0, 1, 2].map(|r| [0, 1, 2].map(|c| pose[[c, r]] as f32));
        let (rotation, place) = read_pose(&given)?;
        let leds = leds
            .outer_iter()
            .map(|row| {
                let turned = |k: usize| rotation * DVec3::new(row[k], row[k + 1], row[k + 2]);
                Led {
                    position: wall.localize((turned(0) + place).to_array()),
                    direction: turned(3).as_vec3().to_array(),
                    intensity: [6, 7, 8].map(|k| row[k] as f32),
                    exponent: row[9] as f32,
                }
            })
            .collect();
        let origin = wall.localize(place.to_array());
        let (center, paths, irradiance, sources) = (wall.center, None, None, None);
        Ok(View {
            origin,
            to_world,
            to_camera,
            center,
            leds,
            exposure,
            shadows,
            paths,
            irradiance,
            sources,
        })
    }

    /// Where the LEDs' light comes from, if paths are to be connected to that.
    fn sources(&self, wall: &Wall, scene: &SceneData, rays: &RayTable) -> Option<VirtualLights> {
        let settings = self.paths.filter(|_| scene.tissue.is_none())?;
        let transport = light_transport(wall, scene, (&self.leds, settings), &rays.tiles);
        VirtualLights::new(&transport, rays.width * rays.height)
    }

    /// What LEDs light directly of surfaces behind which light goes on through tissue, if it does;
    /// `triangles` are `MISS` where there is no wall.
    #[inline(always)]
    pub fn without_base(
        &self,
        scene: &SceneData,
        surface: &Surface,
        triangles: &[u32; LANES],
    ) -> Option<Surface> {
        let is_traced = self.paths.is_some() || self.irradiance.is_some();
        (is_traced && scene.tissue.is_some()).then(|| surface.without_base(triangles))
    }

    /// What the tissue behind surfaces makes of light, where that is not left to paths.
    #[inline(always)]
    pub fn subsurface(
        &self,
        surface: &Surface,
        hits: &Hits,
        triangles: &[u32; LANES],
    ) -> Option<SubsurfaceLight> {
        self.irradiance.as_ref()?.subsurface(surface, hits, triangles)
    }
}

/// Renders the channels of `out`, a dictionary of C-contiguous arrays of the table's shape.
///
/// `leds` holds position [m], direction, intensity [W/sr] and lobe exponent of each in the camera's
/// frame; `paths` how many paths a ray has, their most reflections, and their seed; `radiosity` the
/// solver of indirect light.
#[pyfunction]
#[pyo3(signature = (
    wall, scene, rays, pose, leds, out, *, exposure, shadows, contents=None, paths=None, radiosity=None
))]
#[allow(clippy::too_many_arguments)] // the one door from Python
pub fn render(
    py: Python<'_>,
    wall: &Wall,
    scene: &Scene,
    rays: &RayTable,
    pose: PyReadonlyArray2<'_, f64>,
    leds: PyReadonlyArray2<'_, f64>,
    out: &Bound<'_, PyDict>,
    exposure: f32,
    shadows: bool,
    contents: Option<&Contents>,
    paths: Option<(u32, u32, u64)>,
    radiosity: Option<&Radiosity>,
) -> PyResult<()> {
    if scene.data.faces.len() != wall.faces.len()
        || scene.data.arc_length.len() != wall.vertices.len()
    {
        return Err(PyValueError::new_err(
            "Scene and wall have different numbers of faces or vertices.",
        ));
    }
    if !wall.has_normals {
        return Err(PyValueError::new_err(
            "The wall has moved under a world: refit it to draw it.",
        ));
    }
    let rest = radiosity.map(|light| light.rest(py));
    let mut view = View::new(wall, pose, leds, exposure, shadows)?;
    view.paths = paths.map(|(spp, max_bounces, seed)| Settings { spp, max_bounces, seed });
    let shape = (rays.height, rays.width);
    let mut arrays = ChannelArrays::borrow(out, shape)?;
    let channels = arrays.channels()?;
    let radiosity = radiosity.zip(rest.as_deref()).filter(|_| channels.wants_light());
    on_pool(py, || {
        view.irradiance =
            radiosity.map(|(solver, rest)| solver.solve(rest, wall, (&view.leds, shadows)));
        view.sources = view.sources(wall, &scene.data, rays).filter(|_| contents.is_none());
        let columns = rays.columns();
        let filled = contents.map(|c| Filled::new(wall, &scene.data, c, &view));
        let bands = channels.bands(rays.width, rays.tiles.len() / columns);
        bands.into_par_iter().with_max_len(1).enumerate().for_each(|(row, mut band)| {
            let tiles = &rays.tiles[row * columns..(row + 1) * columns];
            let height = (rays.height - row * TILE).min(TILE);
            let area = Area { row: row * TILE, size: (rays.width, height) };
            match &filled {
                Some(filled) => render_filled_band(filled, tiles, area, &mut band),
                None => render_band(wall, &scene.data, &view, tiles, area, &mut band),
            }
        });
    });
    Ok(())
}

/// Where a band of tiles lies in the image.
#[derive(Clone, Copy)]
struct Area {
    /// First row of pixels.
    row: usize,
    /// Width and height [pixels].
    size: (usize, usize),
}

impl Area {
    fn place(self, column: usize) -> Place {
        Place { column: column * TILE, size: self.size }
    }

    /// Number of each pixel of a tile in the image.
    fn pixels(self, column: usize) -> [u32; LANES] {
        let first = self.row * self.size.0 + column * TILE;
        std::array::from_fn(|i| (first + i / TILE * self.size.0 + i % TILE) as u32)
    }
}

/// What paths of some tiles travel in.
#[inline(always)]
fn light_transport<'a>(
    wall: &'a Wall,
    scene: &'a SceneData,
    (leds, settings): (&'a [Led], Settings),
    tiles: &[TileRays],
) -> LightTransport<'a> {
    let pixel_angle = tiles.iter().fold(0.0, |angle, tile| max(angle, tile.pixel_angle));
    LightTransport { wall, scene, leds, pixel_angle, settings }
}

/// Light beyond direct light that the surfaces met by each tile send to the viewer.
#[inline(always)]
fn indirect(
    wall: &Wall,
    scene: &SceneData,
    view: &View<'_>,
    tiles: &[TileRays],
    media: Option<LumenMedia<'_>>,
    first: impl FnMut((usize, &TileRays)) -> PrimaryHit,
) -> Option<Vec<Lane3>> {
    let settings = view.paths?;
    let transport = light_transport(wall, scene, (&view.leds, settings), tiles);
    let sources = view.sources.as_ref();
    let candidate_paths = VirtualLights::candidate_paths(
        settings.spp.min(wavefront::samples_per_wavefront(tiles.len())),
    );
    let tracer = wavefront::Tracer { transport, media, sources, candidate_paths };
    let firsts: Vec<PrimaryHit> = tiles.iter().enumerate().map(first).collect();
    Some(wavefront::indirect(&tracer, &firsts))
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn render_band(
    wall: &Wall,
    scene: &SceneData,
    view: &View<'_>,
    tiles: &[TileRays],
    area: Area,
    out: &mut Channels<'_>,
) {
    let first = |(column, tile): (usize, &TileRays)| {
        let (rays, hits) = primary(wall, view, tile);
        let found = attributes(wall, scene, view.origin, &rays.directions, &hits);
        let surface = surface(scene, &found, &hits.distance, tile.pixel_angle);
        let pixel = area.pixels(column);
        PrimaryHit { surface, hit: found.hit, triangle: hits.triangle, pixel }
    };
    let indirect =
        if out.wants_light() { indirect(wall, scene, view, tiles, None, first) } else { None };
    for (column, tile) in tiles.iter().enumerate() {
        let indirect = indirect.as_ref().map(|tiles| &tiles[column]);
        let (rays, hits) = primary(wall, view, tile);
        let place = area.place(column);
        render_tile((wall, scene, view), tile, (&rays, &hits), place, indirect, out);
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn render_filled_band(filled: &Filled<'_>, tiles: &[TileRays], area: Area, out: &mut Channels<'_>) {
    let mut room = Room::default();
    let Filled { wall, scene, view, .. } = *filled;
    let first =
        |(column, tile): (usize, &TileRays)| filled.first(tile, area.pixels(column), &mut room);
    let afloat = Some(filled.afloat());
    let indirect =
        if out.wants_light() { indirect(wall, scene, view, tiles, afloat, first) } else { None };
    for (column, tile) in tiles.iter().enumerate() {
        let indirect = indirect.as_ref().map(|tiles| &tiles[column]);
        filled.render_tile(tile, area.place(column), indirect, &mut room, out);
    }
}

/// The rays of a tile in the world, and where they meet the wall.
#[inline(always)]
pub fn primary(wall: &Wall, view: &View<'_>, tile: &TileRays) -> (Pyramid, Hits) {
    let mut reach = [0.0; LANES];
    for i in 0..LANES {
        reach[i] = if tile.used[i] { MAX_DISTANCE } else { 0.0 };
    }
    let mut hits = Hits::within(reach);
    let rays = tile.pyramid.rotated(&view.to_world);
    if tile.any {
        trace::<false>(&wall.bvh, view.origin, &rays, wall.extent, &mut hits);
    }
    (rays, hits)
}

/// Renders one tile of a wall with nothing before it, whose rays have met that; `glow` is light
/// beyond direct light.
#[inline(always)]
pub fn render_tile(
    (wall, scene, view): (&Wall, &SceneData, &View<'_>),
    tile: &TileRays,
    (rays, hits): (&Pyramid, &Hits),
    place: Place,
    indirect: Option<&Lane3>,
    out: &mut Channels<'_>,
) {
    let found = attributes(wall, scene, view.origin, &rays.directions, hits);
    if out.wants_color() {
        let surface = surface(scene, &found, &hits.distance, tile.pixel_angle);
        let without_base = view.without_base(scene, &surface, &hits.triangle);
        let subsurface = view.subsurface(&surface, hits, &hits.triangle);
        let lit = (without_base.as_ref().unwrap_or(&surface), subsurface.as_ref());
        let mut radiance = light(wall, &scene.material, &view.leds, view.shadows, lit, &found.hit);
        if let Some(irradiance) = &view.irradiance {
            irradiance.add((&surface, &found.normal), hits, subsurface.as_ref(), &mut radiance);
        }
        add_indirect(indirect, &mut radiance);
        place.write_light(out, &radiance, &found.hit, view.exposure);
        place.write3(&mut out.albedo, &surface.albedo, &found.hit, f32::NAN);
    }
    write_geometry(view, tile, hits, &found, place, out);
}

/// Adds light beyond direct light, if there is any.
#[inline(always)]
pub fn add_indirect(indirect: Option<&Lane3>, radiance: &mut Lane3) {
    let Some(indirect) = indirect else { return };
    for k in 0..3 {
        for i in 0..LANES {
            radiance[k][i] += indirect[k][i];
        }
    }
}

/// Writes the channels of the surfaces met.
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
