//! The default mucosa: a solid function of the wall's points, baked into its textures.

pub mod grid;
pub(crate) mod noise;
mod raster;
mod tissue;
mod vessels;

use grid::SegmentGrid;
use multiversion::multiversion;
use noise::{Lattice, Vec3};
use numpy::{PyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use raster::{NO_FACE, Size, doubled_area, face_map};
use rayon::prelude::*;
use tissue::{Mucosa, Place, Tissue, turned};
use vessels::{Growth, grow};

/// Texels around each chart that continue it, so that filtering sees no background.
const PADDING: usize = 8;

/// Numbers a vertex brings: position [mm], normal, curvature [1/mm], arc length [mm], and the
/// factors of its segment on pits, bile and vessels.
const GIVEN: usize = 11;

/// Numbers a vertex carries: those it brings, but for the arc length two slow variations.
const FIELDS: usize = GIVEN + 1;

/// The wall as the kernel reads it.
struct Wall<'a> {
    vertices: Vec<[f32; FIELDS]>,
    faces: &'a [[u32; 3]],
    uv: &'a [f64],
}

/// A texture set: sRGB color, roughness and height [m], row by row.
struct Textures {
    albedo: Vec<u8>,
    roughness: Vec<u8>,
    height: Vec<f32>,
}

/// A face's vertex fields as affine functions of texel coordinates.
struct FaceFields {
    face: u32,
    origin: [f64; 2],
    middle: [f64; 2],
    /// Barycentric coordinates of the second and third corner per texel along x and y.
    slopes: [[f64; 2]; 2],
    fields: [[f32; FIELDS]; 3],
}

impl FaceFields {
    fn new(wall: &Wall, size: Size, face: u32) -> Self {
        let at = face as usize;
        let fields = wall.faces[at].map(|v| wall.vertices[v as usize]);
        let corners = size.corners(&wall.uv[6 * at..6 * at + 6]);
        let [a, b, c] = corners;
        let area = doubled_area(&corners);
        Self {
            face,
            origin: a,
            middle: [0, 1].map(|k| (a[k] + b[k] + c[k]) / 3.0),
            slopes: [
                [(c[1] - a[1]) / area, (a[0] - c[0]) / area],
                [(a[1] - b[1]) / area, (b[0] - a[0]) / area],
            ],
            fields,
        }
    }

    /// The place at a texel; beyond the face's edges it goes on in the face's plane.
    #[inline(always)]
    fn place(&self, size: Size, x: usize, y: usize) -> Place {
        let offset = |value: usize, axis: usize, period: usize| {
            let (value, period) = (value as f64, period as f64);
            let turns = (self.middle[axis] - value) / period;
            let whole = if turns.abs() < 0.5 { 0.0 } else { turns.round() };
            value + period * whole - self.origin[axis]
        };
        let (x, y) = (offset(x, 0, size.width), offset(y, 1, size.height));
        let [s, t] = self.slopes.map(|slope| (x * slope[0] + y * slope[1]).clamp(-1.0, 2.0) as f32);
        let [f, g, h] = &self.fields;
        let at = |k: usize| f[k] + s * (g[k] - f[k]) + t * (h[k] - f[k]);
        let normal: Vec3 = [at(3), at(4), at(5)];
        let length = vessels::dot(normal, normal).sqrt().max(1e-9);
        Place {
            point: [at(0), at(1), at(2)],
            normal: normal.map(|n| n / length),
            curvature: at(6),
            shade: at(7),
            region: at(8),
            pits: at(9),
            bile: at(10),
            vessels: at(11),
        }
    }
}

/// 8-bit sRGB (IEC 61966-2-1) by a table over the square root, which spreads the codes evenly.
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

/// Adds what varies so slowly that the wall's vertices hold it: redness and bile.
fn with_slow_variation(given: &[f32], seed: u32) -> Vec<[f32; FIELDS]> {
    let noise =
        |stream: u32, size: f32| Lattice::new(seed.wrapping_mul(31).wrapping_add(stream), size);
    let (mut segments, mut regions) = (noise(3, 110.0), noise(4, 55.0));
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

/// One row of the textures.
struct Row<'a> {
    y: usize,
    albedo: &'a mut [u8],
    roughness: &'a mut [u8],
    height: &'a mut [f32],
}

/// Compiled for several instruction sets; none of them changes a bit of the result.
#[multiversion(targets("x86_64+avx2", "aarch64+neon"))]
fn paint_row(wall: &Wall, map: &[u32], size: Size, tissue: &Tissue, encoder: &Encoder, row: Row) {
    let plain = tissue.plain();
    let mut brush = tissue.brush();
    let mut fields: Option<FaceFields> = None;
    for (x, &face) in map.iter().enumerate() {
        let sample = if face == NO_FACE {
            plain
        } else {
            let fields = match &mut fields {
                Some(fields) if fields.face == face => fields,
                stale => stale.insert(FaceFields::new(wall, size, face)),
            };
            brush.at(&fields.place(size, x, row.y))
        };
        for c in 0..3 {
            row.albedo[3 * x + c] = encoder.encode(sample.albedo[c]);
        }
        row.roughness[x] = (sample.roughness * 255.0 + 0.5) as u8;
        row.height[x] = sample.height * 1e-3;
    }
}

type TextureArrays<'py> =
    (Bound<'py, PyArray1<u8>>, Bound<'py, PyArray1<u8>>, Bound<'py, PyArray1<f32>>);

/// Bakes a mucosa into textures of `layout`: height, width and the wall's length under a texel [mm].
///
/// `wall` [n 11] holds each vertex's position [mm], normal, curvature [1/mm], arc length [mm] and
/// factors on pits, bile and vessels; `uv` [m 6] the texture coordinates of each face's corners. Returns albedo, roughness and height, flat.
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
    let textures = py.detach(|| {
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
