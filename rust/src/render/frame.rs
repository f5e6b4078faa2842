//! Rendering of one image: trace, shade and write every requested channel.

use crate::pool::on_pool;
use crate::render::channels::{ChannelArrays, Channels, Place};
use crate::render::led::Led;
use crate::render::led_visibility::{BLOCK, Samples, Strip};
use crate::render::lumen::Contents;
use crate::render::lumen_tile::LumenTiles;
use crate::render::path::light_paths::LightTransport;
use crate::render::path::lumen_contents::LumenMedia;
use crate::render::path::tracer::Tracer;
use crate::render::path::virtual_lights::VirtualLights;
use crate::render::path::{PrimaryHit, Settings, wavefront};
use crate::render::radiosity::Radiosity;
use crate::render::ray_table::{RayTable, TileRays};
use crate::render::scene::{Scene, SceneData};
use crate::render::tile::{Scratch, TileLight, TileRenderer, WallTiles};
use crate::render::view::View;
use crate::simd::f32x64::*;
use crate::wall::Wall;
use numpy::PyReadonlyArray2;
use pyo3::{exceptions::PyValueError, prelude::*, types::PyDict};
use rayon::prelude::*;

/// Renders the channels of `out`, a dictionary of C-contiguous arrays of the table's shape.
///
/// `leds` holds position [m], direction, intensity [W/sr] and lobe exponent of each LED in the
/// camera's frame; `paths` the paths per ray, their maximum number of reflections and their seed;
/// `radiosity` the solver of indirect light.
#[pyfunction]
#[pyo3(signature = (
    wall, scene, rays, pose, leds, out, *, exposure, shadows, contents=None, paths=None, radiosity=None
))]
#[allow(clippy::too_many_arguments)] // called from Python only
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
    scene.data.check_size(wall)?;
    if !wall.has_normals {
        return Err(PyValueError::new_err(
            "The wall has moved under a world: refit it to draw it.",
        ));
    }
    let rest = radiosity.map(|light| light.rest(py)).transpose()?;
    if let Some(rest) = &rest {
        scene.data.check_size(rest)?;
    }
    let mut view = View::new(wall, pose.as_array(), leds.as_array(), exposure, shadows)?;
    if let Some((spp, max_bounces, seed)) = paths {
        view.trace_paths(Settings { spp, max_bounces, seed });
    }
    let shape = (rays.height, rays.width);
    let mut arrays = ChannelArrays::borrow(out, shape)?;
    let channels = arrays.channels()?;
    let radiosity = radiosity.zip(rest.as_deref()).filter(|_| channels.wants_light());
    on_pool(py, || {
        view.irradiance =
            radiosity.map(|(solver, rest)| solver.solve(rest, wall, (&view.leds, shadows)));
        view.sources =
            virtual_lights(wall, &scene.data, &view, rays).filter(|_| contents.is_none());
        let bare = WallTiles { wall, scene: &scene.data, view: &view };
        let filled = contents.map(|contents| LumenTiles::new(bare, contents));
        match &filled {
            Some(filled) => render_bands(filled, bare, rays, channels),
            None => render_bands(&bare, bare, rays, channels),
        }
    });
    Ok(())
}

/// Maximum number of rows of tiles whose soft shadows are traced together; target number of tiles.
const MAX_STRIP_ROWS: usize = 64;
const STRIP_TILES: usize = 16_384;

/// Renders all rows of tiles of an image.
pub fn render_bands<T: TileRenderer + Sync>(
    renderer: &T,
    bare: WallTiles<'_>,
    rays: &RayTable,
    channels: Channels<'_>,
) {
    let columns = rays.columns();
    let rows = rays.tiles.len() / columns;
    let is_soft = bare.view.has_soft_shadows() && channels.wants_light();
    let strip_rows = (STRIP_TILES / columns).next_multiple_of(BLOCK).clamp(BLOCK, MAX_STRIP_ROWS);
    let samples = Samples::new(bare.wall, &bare.view.leds);
    let mut bands = channels.bands(rays.width, rows);
    for start in (0..rows).step_by(strip_rows) {
        // The filter reads the next row of tiles, whose rays depend on the row after it.
        let first = start.saturating_sub(BLOCK);
        let last = (start + strip_rows + BLOCK).min(rows);
        let tiles = &rays.tiles[first * columns..last * columns];
        let strip = is_soft.then(|| Strip::trace(renderer, &samples, tiles, columns));
        let count = strip_rows.min(bands.len());
        bands.par_drain(..count).with_max_len(1).enumerate().for_each(|(number, mut band)| {
            let row = start + number;
            let tiles = &rays.tiles[row * columns..(row + 1) * columns];
            let height = (rays.height - row * TILE).min(TILE);
            let area = Area { row: row * TILE, size: (rays.width, height) };
            let strip = strip.as_ref().map(|strip| (strip, row - first));
            render_band(renderer, bare, (tiles, strip), area, &mut band);
        });
    }
}

/// Strip of tiles that are traced together, and a row in it.
type StripRow<'a, S> = (&'a Strip<'a, S>, usize);

/// Position of a band of tiles in the image.
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

    /// Indices of a tile's pixels in the image.
    fn pixels(self, column: usize) -> [u32; LANES] {
        let first = self.row * self.size.0 + column * TILE;
        std::array::from_fn(|i| (first + i / TILE * self.size.0 + i % TILE) as u32)
    }
}

/// Light transport with the media of some tiles.
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

/// Virtual lights of the LEDs, if paths are connected to them.
fn virtual_lights(
    wall: &Wall,
    scene: &SceneData,
    view: &View<'_>,
    rays: &RayTable,
) -> Option<VirtualLights> {
    let settings = view.paths.filter(|_| scene.tissue.is_none())?;
    let transport = light_transport(wall, scene, (&view.leds, settings), &rays.tiles);
    VirtualLights::new(&transport, rays.width * rays.height)
}

/// Radiance of indirect light from the surfaces of each tile towards the viewer.
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
    let tracer = Tracer { transport, media, sources, candidate_paths };
    let firsts: Vec<PrimaryHit> = tiles.iter().enumerate().map(first).collect();
    Some(wavefront::indirect(&tracer, &firsts))
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn render_band<T: TileRenderer>(
    renderer: &T,
    WallTiles { wall, scene, view }: WallTiles<'_>,
    (tiles, strip): (&[TileRays], Option<StripRow<'_, T::Seen>>),
    area: Area,
    out: &mut Channels<'_>,
) {
    let mut scratch = Scratch::default();
    let own: Vec<T::Seen>;
    let seen = match strip {
        Some((strip, row)) => &strip.seen[row * tiles.len()..(row + 1) * tiles.len()],
        None => {
            own = tiles.iter().map(|tile| renderer.see(tile, &mut scratch)).collect();
            &own
        }
    };
    let first = |(column, tile): (usize, &TileRays)| {
        renderer.primary_hit(tile, area.pixels(column), &seen[column])
    };
    let media = renderer.media();
    let indirect =
        if out.wants_light() { indirect(wall, scene, view, tiles, media, first) } else { None };
    for (column, tile) in tiles.iter().enumerate() {
        let light = TileLight {
            indirect: indirect.as_ref().map(|tiles| &tiles[column]),
            visibility: strip.map(|(strip, row)| (&strip.visibility, (row, column))),
        };
        renderer.render_tile(tile, area.place(column), &seen[column], light, &mut scratch, out);
    }
}
