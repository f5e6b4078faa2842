//! Default mucosa: a solid texture at the wall's points, baked into its textures.

pub mod grid;
pub(crate) mod noise;
mod raster;
pub(crate) mod strokes;
pub(crate) mod tissue;
mod vessels;

use crate::pool::detached;
use crate::simd::f32x64::{LANES, Vec3, at, dot, max};
use grid::SegmentGrid;
use multiversion::multiversion;
use noise::Lattice;
use numpy::{PyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use raster::{NO_FACE, Size, doubled_area, face_map};
use rayon::prelude::*;
use tissue::{Mucosa, Places, Samples, Tissue, turned};
use vessels::{Growth, grow};

/// Texels of padding that continue each chart, so that filtering reads no background.
const PADDING: usize = 8;

/// Count of numbers per vertex from Python: position [mm], normal, curvature [1/mm], arc length
/// [mm], and the factors of its segment on pits, bile and vessels.
const GIVEN: usize = 11;

/// Count of fields per vertex: as given, but with two slow variations instead of the arc length.
const FIELDS: usize = GIVEN + 1;

/// Wall as input of the kernel.
struct Wall<'a> {
    vertices: Vec<[f32; FIELDS]>,
    faces: &'a [[u32; 3]],
    uv: &'a [f64],
}

/// Texture set: sRGB color, roughness and height [m], row by row.
struct Textures {
    albedo: Vec<u8>,
    roughness: Vec<u8>,
    height: Vec<f32>,
}

/// Vertex fields of a face along one row of texels.
struct FaceFields {
    face: u32,
    origin: f64,
    middle: f64,
    /// Barycentric coordinates of the second and third corner: per texel along x, and at the
    /// origin's x.
    lines: [[f64; 2]; 2],
    fields: [f32; FIELDS],
    /// Differences from the first corner to the second and third.
    edges: [[f32; FIELDS]; 2],
}

/// Offset of a texel from a face's corner, wrapped with the texture to be nearest its middle.
#[inline(always)]
fn offset(value: f64, period: f64, middle: f64, origin: f64) -> f64 {
    let turns = (middle - value) / period;
    let whole = if turns.abs() < 0.5 { 0.0 } else { turns.round() };
    value + period * whole - origin
}

impl FaceFields {
    fn new(wall: &Wall, size: Size, face: u32, y: usize) -> Self {
        let at = face as usize;
        let [f, g, h] = wall.faces[at].map(|v| &wall.vertices[v as usize]);
        let corners = size.corners(&wall.uv[6 * at..6 * at + 6]);
        let [a, b, c] = corners;
        let area = doubled_area(&corners);
        let middle = |k: usize| (a[k] + b[k] + c[k]) / 3.0;
        let y = offset(y as f64, size.height as f64, middle(1), a[1]);
        Self {
            face,
            origin: a[0],
            middle: middle(0),
            lines: [
                [(c[1] - a[1]) / area, y * ((a[0] - c[0]) / area)],
                [(a[1] - b[1]) / area, y * ((b[0] - a[0]) / area)],
            ],
            fields: *f,
            edges: [std::array::from_fn(|k| g[k] - f[k]), std::array::from_fn(|k| h[k] - f[k])],
        }
    }

    /// Fields at a texel; extrapolated in the face's plane beyond its edges.
    #[inline(always)]
    fn at(&self, size: Size, x: usize) -> [f32; FIELDS] {
        let x = offset(x as f64, size.width as f64, self.middle, self.origin);
        let share = |line: &[f64; 2]| (x * line[0] + line[1]).clamp(-1.0, 2.0) as f32;
        let (s, t) = (share(&self.lines[0]), share(&self.lines[1]));
        let mut fields = self.fields;
        for (k, field) in fields.iter_mut().enumerate() {
            *field = *field + s * self.edges[0][k] + t * self.edges[1][k];
        }
        fields
    }
}

/// Batch of covered texels of a row: columns and vertex fields.
struct Lot {
    columns: [usize; LANES],
    rows: [[f32; FIELDS]; LANES],
    count: usize,
}

impl Lot {
    #[inline(always)]
    fn places(&self) -> Places {
        let column = |k: usize| {
            let mut lane = [0.0; LANES];
            for (value, fields) in lane.iter_mut().zip(&self.rows) {
                *value = fields[k];
            }
            lane
        };
        let mut normal = [column(3), column(4), column(5)];
        for i in 0..LANES {
            let n = at(&normal, i);
            let length = max(dot(n, n).sqrt(), 1e-9);
            for k in 0..3 {
                normal[k][i] = n[k] / length;
            }
        }
        Places {
            point: [column(0), column(1), column(2)],
            normal,
            curvature: column(6),
            shade: column(7),
            region: column(8),
            pits: column(9),
            bile: column(10),
            vessels: column(11),
        }
    }
}

/// Encoder to 8-bit sRGB (IEC 61966-2-1) by a table over the square root, for evenly spaced codes.
struct Encoder([u8; Encoder::STEPS + 1]);

impl Encoder {
    const STEPS: usize = 4096;

    fn new() -> Self {
        Self(std::array::from_fn(|step| {
            let root = step as f64 / Self::STEPS as f64;
            let x = root * root;
            let code = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
            (code * 255.0).round() as u8
        }))
    }

    fn encode(&self, linear: f32) -> u8 {
        self.0[(linear.clamp(0.0, 1.0).sqrt() * Self::STEPS as f32 + 0.5) as usize]
    }
}

/// Adds variations that are slow enough to be stored at the wall's vertices: redness and bile.
fn with_slow_variation(given: &[f32], seed: u32) -> Vec<[f32; FIELDS]> {
    let noise =
        |stream: u32, size: f32| Lattice::new(seed.wrapping_mul(31).wrapping_add(stream), size);
    let (segments, regions) = (noise(3, 110.0), noise(4, 55.0));
    let fields = |v: &[f32]| {
        let segment = segments.gradient([v[7], 40.7, 78.1]);
        let region = regions.gradient(turned([v[0], v[1], v[2]]));
        let shade = 0.5 * segment + 0.45 * region;
        [v[0], v[1], v[2], v[3], v[4], v[5], v[6], shade, region, v[8], v[9], v[10]]
    };
    given.chunks_exact(GIVEN).map(fields).collect()
}

fn paint(wall: &Wall, map: &[u32], size: Size, tissue: &Tissue) -> Textures {
    let encoder = Encoder::new();
    let texels = size.width * size.height;
    let mut textures = Textures {
        albedo: vec![0; 3 * texels],
        roughness: vec![0; texels],
        height: vec![0.0; texels],
    };
    textures
        .albedo
        .par_chunks_exact_mut(3 * size.width)
        .zip(textures.roughness.par_chunks_exact_mut(size.width))
        .zip(textures.height.par_chunks_exact_mut(size.width))
        .enumerate()
        .for_each(|(y, ((albedo, roughness), height))| {
            let row = Row { y, albedo, roughness, height };
            paint_row(wall, &map[y * size.width..][..size.width], size, tissue, &encoder, row);
        });
    textures
}

/// Row of the textures.
struct Row<'a> {
    y: usize,
    albedo: &'a mut [u8],
    roughness: &'a mut [u8],
    height: &'a mut [f32],
}

/// Compiled for several instruction sets, with bit-identical results.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn paint_row(
    wall: &Wall,
    map: &[u32],
    size: Size,
    tissue: &Tissue,
    encoder: &Encoder,
    mut row: Row,
) {
    let plain = tissue.plain();
    let mut lot = Lot { columns: [0; LANES], rows: [[0.0; FIELDS]; LANES], count: 0 };
    let mut fields: Option<FaceFields> = None;
    for (x, &face) in map.iter().enumerate() {
        if face == NO_FACE {
            row.put(encoder, x, &plain, 0);
            continue;
        }
        let fields = match &mut fields {
            Some(fields) if fields.face == face => fields,
            stale => stale.insert(FaceFields::new(wall, size, face, row.y)),
        };
        (lot.columns[lot.count], lot.rows[lot.count]) = (x, fields.at(size, x));
        lot.count += 1;
        if lot.count == LANES {
            row.paint(tissue, encoder, &mut lot);
        }
    }
    if lot.count > 0 {
        row.paint(tissue, encoder, &mut lot);
    }
}

impl Row<'_> {
    /// Evaluates the texels of a batch and clears it.
    #[inline(always)]
    fn paint(&mut self, tissue: &Tissue, encoder: &Encoder, lot: &mut Lot) {
        let samples = tissue.at(&lot.places());
        for i in 0..lot.count {
            self.put(encoder, lot.columns[i], &samples, i);
        }
        lot.count = 0;
    }

    #[inline(always)]
    fn put(&mut self, encoder: &Encoder, x: usize, samples: &Samples, i: usize) {
        for c in 0..3 {
            self.albedo[3 * x + c] = encoder.encode(samples.albedo[c][i]);
        }
        self.roughness[x] = (samples.roughness[i] * 255.0 + 0.5) as u8;
        self.height[x] = samples.height[i] * 1e-3;
    }
}

type TextureArrays<'py> =
    (Bound<'py, PyArray1<u8>>, Bound<'py, PyArray1<u8>>, Bound<'py, PyArray1<f32>>);

/// Bakes a mucosa into textures of `layout`: height, width and the wall's length in a texel [mm].
///
/// `wall` [n 11] holds each vertex's position [mm], normal, curvature [1/mm], arc length [mm] and
/// factors on pits, bile and vessels; `uv` [m 6] the texture coordinates of each face's corners.
/// Returns albedo, roughness and height, flat.
#[pyfunction]
pub fn bake_mucosa<'py>(
    py: Python<'py>,
    wall: PyReadonlyArray2<'py, f32>,
    faces: PyReadonlyArray2<'py, u32>,
    uv: PyReadonlyArray2<'py, f64>,
    layout: (usize, usize, f32),
    seed: u32,
    mucosa: Mucosa,
) -> PyResult<TextureArrays<'py>> {
    let faces: Vec<[u32; 3]> =
        faces.as_slice()?.chunks_exact(3).map(|f| [f[0], f[1], f[2]]).collect();
    let vertices = with_slow_variation(wall.as_slice()?, seed);
    let wall = Wall { vertices, faces: &faces, uv: uv.as_slice()? };
    let size = Size { height: layout.0, width: layout.1 };
    let texel = layout.2;
    let textures = detached(py, || {
        let (map, segments) =
            rayon::join(|| face_map(wall.uv, size, PADDING), || grow_on(&wall, seed, &mucosa));
        let tissue = Tissue::new(mucosa, seed, SegmentGrid::new(&segments, texel), texel);
        paint(&wall, &map, size, &tissue)
    });
    Ok((
        PyArray1::from_vec(py, textures.albedo),
        PyArray1::from_vec(py, textures.roughness),
        PyArray1::from_vec(py, textures.height),
    ))
}

fn grow_on(wall: &Wall, seed: u32, mucosa: &Mucosa) -> Vec<vessels::Segment> {
    let column = |k: usize| -> Vec<Vec3> {
        wall.vertices.iter().map(|r| [r[k], r[k + 1], r[k + 2]]).collect()
    };
    let growth = Growth {
        seed,
        spacing: mucosa.vessel_spacing * 1e3,
        trunk_spacing: mucosa.trunk_spacing * 1e3,
        tip_radius: mucosa.capillary_radius * 1e3,
    };
    grow(&column(0), &column(3), wall.faces, growth)
}
