//! An image as three planes, and what acts on each plane by itself.

use crate::channels::srgb;
use crate::cpu::on_pool;
use crate::lanes::max;
use numpy::{
    IntoPyArray, PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
    ndarray::Array3,
};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Height and width of three planes.
///
/// # Errors
/// If they are not three.
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

/// The rows of three planes: for each row its red, green and blue.
pub fn rows(pixels: &mut [f32], (height, width): (usize, usize)) -> Vec<[&mut [f32]; 3]> {
    let (red, rest) = pixels.split_at_mut(height * width);
    let (green, blue) = rest.split_at_mut(height * width);
    red.chunks_mut(width)
        .zip(green.chunks_mut(width))
        .zip(blue.chunks_mut(width))
        .map(|((r, g), b)| [r, g, b])
        .collect()
}

/// Planes [3 h w] of an image [h w 3], times a factor.
#[pyfunction]
pub fn to_planes<'py>(
    py: Python<'py>,
    image: PyReadonlyArray3<'py, f32>,
    factor: f32,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let (height, width) = size_of_image(&image)?;
    let source = image.as_slice()?;
    let mut out = vec![0.0; 3 * height * width];
    on_pool(py, || {
        rows(&mut out, (height, width)).into_par_iter().enumerate().for_each(|(y, [r, g, b])| {
            let row = &source[y * width * 3..(y + 1) * width * 3];
            for (x, pixel) in row.chunks_exact(3).enumerate() {
                (r[x], g[x], b[x]) = (pixel[0] * factor, pixel[1] * factor, pixel[2] * factor);
            }
        });
    });
    Ok(planes_array(py, out, (height, width)))
}

/// Planes times a map [h w].
#[pyfunction]
pub fn shade_planes<'py>(
    py: Python<'py>,
    planes: PyReadonlyArray3<'py, f32>,
    map: PyReadonlyArray2<'py, f32>,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let (height, width) = size(&planes)?;
    if map.shape() != [height, width] {
        return Err(PyValueError::new_err("A map must be of the planes' shape (h, w)."));
    }
    let (source, map) = (planes.as_slice()?, map.as_slice()?);
    let mut out = vec![0.0; source.len()];
    on_pool(py, || {
        out.par_chunks_mut(width).enumerate().for_each(|(k, row)| {
            let values = &source[k * width..(k + 1) * width];
            let factors = &map[k % height * width..(k % height + 1) * width];
            for x in 0..width {
                row[x] = values[x] * factors[x];
            }
        });
    });
    Ok(planes_array(py, out, (height, width)))
}

/// Where a scaled axis takes its values from: first of four neighbours, and their weights.
fn cubic_taps(length: usize, center: f32, scale: f32) -> Vec<(usize, [f32; 4])> {
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
            // Catmull-Rom: passes through the values, and is exact for parabolas.
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

/// The four neighbours from one before `first`, kept within the length.
#[inline(always)]
fn neighbours(first: usize, length: usize) -> [usize; 4] {
    let last = length - 1;
    [first.saturating_sub(1), first, (first + 1).min(last), (first + 2).min(last)]
}

/// Taps of a row's columns: runs of columns whose neighbours are neighbours too, and all weights.
struct Columns {
    /// First column, one past the last, and the first neighbour of the first.
    runs: Vec<(usize, usize, usize)>,
    weights: [Vec<f32>; 4],
}

impl Columns {
    fn new(taps: &[(usize, [f32; 4])]) -> Self {
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

/// One row from the four about it, given their weights.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn scale_row(lines: [&[f32]; 4], weights: [f32; 4], columns: &Columns, out: &mut [f32]) {
    let width = out.len();
    // One more before the first column and two after the last, as the image goes on.
    let mut mixed = vec![0.0f32; width + 3];
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

/// Magnifies each plane about a centre (column, row) [px] by its own scale.
///
/// What moves in from beyond the image is black. Interpolation is cubic along each axis.
#[pyfunction]
pub fn scale_planes<'py>(
    py: Python<'py>,
    planes: PyReadonlyArray3<'py, f32>,
    center: [f32; 2],
    scales: [f32; 3],
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let (height, width) = size(&planes)?;
    let source = planes.as_slice()?;
    let mut out = vec![0.0; source.len()];
    on_pool(py, || {
        let area = height * width;
        for (plane, &scale) in scales.iter().enumerate() {
            let from = &source[plane * area..(plane + 1) * area];
            let into = &mut out[plane * area..(plane + 1) * area];
            if scale == 1.0 {
                into.copy_from_slice(from);
                continue;
            }
            let columns = Columns::new(&cubic_taps(width, center[0], scale));
            let taps = cubic_taps(height, center[1], scale);
            into.par_chunks_mut(width).zip(taps).for_each(|(row, (first, weights))| {
                let lines = neighbours(first, height).map(|y| &from[y * width..][..width]);
                scale_row(lines, weights, &columns, row);
            });
        }
    });
    Ok(planes_array(py, out, (height, width)))
}

/// 8-bit sRGB image [h w 3] of linear planes times a gain each; black where not `lit`.
#[pyfunction]
pub fn develop<'py>(
    py: Python<'py>,
    planes: PyReadonlyArray3<'py, f32>,
    gains: [f32; 3],
    lit: PyReadonlyArray2<'py, bool>,
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let (height, width) = size(&planes)?;
    if lit.shape() != [height, width] {
        return Err(PyValueError::new_err("What is lit must be of the planes' shape (h, w)."));
    }
    let (source, lit) = (planes.as_slice()?, lit.as_slice()?);
    let mut out = vec![0u8; source.len()];
    on_pool(py, || {
        out.par_chunks_mut(width * 3).enumerate().for_each(|(y, row)| {
            let at = |plane: usize| &source[(plane * height + y) * width..][..width];
            develop_row([at(0), at(1), at(2)], gains, &lit[y * width..][..width], row);
        });
    });
    Ok(Array3::from_shape_vec((height, width, 3), out)
        .expect("every pixel was filled")
        .into_pyarray(py))
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn develop_row(planes: [&[f32]; 3], gains: [f32; 3], lit: &[bool], out: &mut [u8]) {
    let mut encoded = vec![0u8; lit.len()];
    for (k, plane) in planes.into_iter().enumerate() {
        for ((code, &value), &lit) in encoded.iter_mut().zip(plane).zip(lit) {
            *code = srgb(value * gains[k]) & u8::from(lit).wrapping_neg();
        }
        for (pixel, &code) in out.chunks_exact_mut(3).zip(&encoded) {
            pixel[k] = code;
        }
    }
}
