//! Images as three planes, and operations on each plane.

use crate::pool::on_pool;
use crate::render::channels::srgb;
use crate::simd::f32x64::max;
use numpy::{
    IntoPyArray, PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
    ndarray::Array3,
};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Height and width of three planes.
///
/// # Errors
/// If the number of planes is not three.
pub fn size(planes: &PyReadonlyArray3<'_, f32>) -> PyResult<(usize, usize)> {
    match planes.shape()[..] {
        [3, h, w] if h > 0 && w > 0 => Ok((h, w)),
        _ => Err(PyValueError::new_err("Planes must be of shape (3, h, w).")),
    }
}

/// Height and width of an image [h w 3].
///
/// # Errors
/// If it has another shape.
pub fn size_of_image(image: &PyReadonlyArray3<'_, f32>) -> PyResult<(usize, usize)> {
    match image.shape()[..] {
        [h, w, 3] if h > 0 && w > 0 => Ok((h, w)),
        _ => Err(PyValueError::new_err("An image must be of shape (h, w, 3).")),
    }
}

/// An array of planes [3 h w].
pub fn planes_array(
    py: Python<'_>,
    pixels: Vec<f32>,
    (height, width): (usize, usize),
) -> Bound<'_, PyArray3<f32>> {
    Array3::from_shape_vec((3, height, width), pixels)
        .expect("three planes were filled")
        .into_pyarray(py)
}

/// One row of three planes: red, green, blue.
pub type Line<'a, T = f32> = [&'a mut [T]; 3];

/// Rows of three planes.
pub fn rows<T>(pixels: &mut [T], (height, width): (usize, usize)) -> Vec<Line<'_, T>> {
    let (red, rest) = pixels.split_at_mut(height * width);
    let (green, blue) = rest.split_at_mut(height * width);
    red.chunks_mut(width)
        .zip(green.chunks_mut(width))
        .zip(blue.chunks_mut(width))
        .map(|((r, g), b)| [r, g, b])
        .collect()
}

/// Multiplies a row by a value.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
pub fn amplify(row: &[f32], factor: f32, out: &mut [f32]) {
    for (value, x) in out.iter_mut().zip(row) {
        *value = x * factor;
    }
}

/// Multiplies a row by another elementwise.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
pub fn shade_row(row: &mut [f32], factors: &[f32]) {
    for (value, factor) in row.iter_mut().zip(factors) {
        *value *= factor;
    }
}

/// Multiplies planes by a map [h w].
#[pyfunction]
pub fn vignetting<'py>(
    py: Python<'py>,
    planes: PyReadonlyArray3<'py, f32>,
    map: PyReadonlyArray2<'py, f32>,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let (height, width) = size(&planes)?;
    if map.shape() != [height, width] {
        return Err(PyValueError::new_err("A map must be of the planes' shape (h, w)."));
    }
    let (source, map) = (planes.as_slice()?, map.as_slice()?);
    let mut out = source.to_vec();
    on_pool(py, || {
        out.par_chunks_mut(width).enumerate().for_each(|(k, row)| {
            shade_row(row, &map[k % height * width..][..width]);
        });
    });
    Ok(planes_array(py, out, (height, width)))
}

/// Index of the first of four neighbors, and their weights.
type Taps = (usize, [f32; 4]);

/// Source samples of a scaled axis.
fn cubic_taps(length: usize, center: f32, scale: f32) -> Vec<Taps> {
    let last = length as f32 - 1.0;
    (0..length)
        .map(|k| {
            let at = center + (k as f32 - center) / scale;
            if !(-0.5..=last + 0.5).contains(&at) {
                return (0, [0.0; 4]);
            }
            let at = at.clamp(0.0, last);
            let first = (at.floor() as usize).min(length.saturating_sub(2));
            let t = at - first as f32;
            // Catmull-Rom: interpolates the values, and is exact for parabolas.
            let weights = [
                t * (-0.5 + t * (1.0 - 0.5 * t)),
                1.0 + t * t * (-2.5 + 1.5 * t),
                t * (0.5 + t * (2.0 - 1.5 * t)),
                t * t * (-0.5 + 0.5 * t),
            ];
            (first, weights)
        })
        .collect()
}

/// Four neighbors that start one before `first`, clamped to the length.
#[inline(always)]
fn neighbors(first: usize, length: usize) -> [usize; 4] {
    let last = length - 1;
    [first.saturating_sub(1), first, (first + 1).min(last), (first + 2).min(last)]
}

/// Taps of a row's columns: runs of columns with consecutive neighbors, and all weights.
struct Columns {
    /// First column, one past the last, and the first neighbor of the first.
    runs: Vec<(usize, usize, usize)>,
    weights: [Vec<f32>; 4],
}

impl Columns {
    fn new(taps: &[Taps]) -> Self {
        let mut runs: Vec<(usize, usize, usize)> = Vec::new();
        for (x, &(first, _)) in taps.iter().enumerate() {
            match runs.last_mut() {
                Some((begin, end, from)) if *from + x - *begin == first => *end += 1,
                _ => runs.push((x, x + 1, first)),
            }
        }
        Columns { runs, weights: [0, 1, 2, 3].map(|k| taps.iter().map(|t| t.1[k]).collect()) }
    }
}

/// One row from the four around it, given their weights; `mixed` is a buffer for it.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn scale_row(
    lines: [&[f32]; 4],
    weights: [f32; 4],
    columns: &Columns,
    mixed: &mut Vec<f32>,
    out: &mut [f32],
) {
    let width = out.len();
    // One more before the first column and two after the last, which repeat the image's edge.
    mixed.resize(width + 3, 0.0);
    let [a, b, c, d] = lines.map(|line| &line[..width]);
    for (x, value) in mixed[1..=width].iter_mut().enumerate() {
        *value = weights[0] * a[x] + weights[1] * b[x] + weights[2] * c[x] + weights[3] * d[x];
    }
    mixed[0] = mixed[1];
    (mixed[width + 1], mixed[width + 2]) = (mixed[width], mixed[width]);
    for &(begin, end, first) in &columns.runs {
        let length = end - begin;
        let [a, b, c, d] = [0, 1, 2, 3].map(|k| &mixed[first + k..][..length]);
        let [s, t, u, v] = [0, 1, 2, 3].map(|k| &columns.weights[k][begin..end]);
        for (x, value) in out[begin..end].iter_mut().enumerate() {
            *value = max(s[x] * a[x] + t[x] * b[x] + u[x] * c[x] + v[x] * d[x], 0.0);
        }
    }
}

/// Magnification of planes, each by its own scale.
pub struct Scaling {
    /// Rows and columns of each plane; None without magnification.
    planes: [Option<(Vec<Taps>, Columns)>; 3],
}

impl Scaling {
    /// Magnification about a center (column, row) [px].
    pub fn new((height, width): (usize, usize), center: [f32; 2], scales: [f32; 3]) -> Self {
        let taps = |&scale: &f32| {
            let columns = Columns::new(&cubic_taps(width, center[0], scale));
            (scale != 1.0).then(|| (cubic_taps(height, center[1], scale), columns))
        };
        Scaling { planes: scales.each_ref().map(taps) }
    }

    /// One row of magnified planes.
    pub fn row(
        &self,
        source: &[f32],
        (height, width): (usize, usize),
        y: usize,
        mixed: &mut Vec<f32>,
        out: &mut Line<'_>,
    ) {
        for (k, plane) in self.planes.iter().enumerate() {
            let from = &source[k * height * width..][..height * width];
            match plane {
                None => out[k].copy_from_slice(&from[y * width..][..width]),
                Some((taps, columns)) => {
                    let (first, weights) = taps[y];
                    let lines = neighbors(first, height).map(|y| &from[y * width..][..width]);
                    scale_row(lines, weights, columns, mixed, out[k]);
                }
            }
        }
    }
}

/// Magnifies each plane about a center (column, row) [px] by its own scale.
///
/// Pixels from outside the image are black. Interpolation is cubic along each axis.
#[pyfunction]
pub fn chromatic_aberration<'py>(
    py: Python<'py>,
    planes: PyReadonlyArray3<'py, f32>,
    center: [f32; 2],
    scales: [f32; 3],
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let (height, width) = size(&planes)?;
    let (source, size) = (planes.as_slice()?, (height, width));
    let mut out = vec![0.0; source.len()];
    on_pool(py, || {
        let scaling = Scaling::new(size, center, scales);
        let lines = rows(&mut out, size).into_par_iter().enumerate();
        lines.for_each_init(Vec::new, |mixed, (y, mut line)| {
            scaling.row(source, size, y, mixed, &mut line);
        });
    });
    Ok(planes_array(py, out, size))
}

/// 8-bit sRGB image [h w 3] of linear planes times one gain each; black where not `lit`.
#[pyfunction]
pub fn develop<'py>(
    py: Python<'py>,
    planes: PyReadonlyArray3<'py, f32>,
    gains: [f32; 3],
    lit: PyReadonlyArray2<'py, bool>,
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let (height, width) = size(&planes)?;
    if lit.shape() != [height, width] {
        return Err(PyValueError::new_err("The mask of lit pixels must fit the planes (h, w)."));
    }
    let (source, lit) = (planes.as_slice()?, lit.as_slice()?);
    let mut out = vec![0u8; source.len()];
    on_pool(py, || {
        out.par_chunks_mut(width * 3).enumerate().for_each(|(y, row)| {
            let mut codes = vec![0u8; 3 * width];
            for (k, codes) in codes.chunks_exact_mut(width).enumerate() {
                let line = &source[(k * height + y) * width..][..width];
                develop_row(line, gains[k], &lit[y * width..][..width], codes);
            }
            let [red, green, blue] = [0, 1, 2].map(|k| &codes[k * width..][..width]);
            interleave([red, green, blue], row);
        });
    });
    Ok(Array3::from_shape_vec((height, width, 3), out)
        .expect("every pixel was filled")
        .into_pyarray(py))
}

/// 8-bit sRGB of one color of a row; 0 where not `lit`.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
pub fn develop_row(values: &[f32], gain: f32, lit: &[bool], codes: &mut [u8]) {
    for ((code, &value), &lit) in codes.iter_mut().zip(values).zip(lit) {
        *code = srgb(value * gain) & u8::from(lit).wrapping_neg();
    }
}

/// Interleaves three colors into pixels.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
pub fn interleave(planes: [&[u8]; 3], out: &mut [u8]) {
    let [red, green, blue] = planes.map(|plane| &plane[..out.len() / 3]);
    for (x, pixel) in out.chunks_exact_mut(3).enumerate() {
        (pixel[0], pixel[1], pixel[2]) = (red[x], green[x], blue[x]);
    }
}
