//! Image through contamination of the capsule's dome: smears that absorb and scatter, and drops
//! that act as lenses.

use super::planes::{Line, planes_array, rows, size};
use crate::pool::on_pool;
use crate::simd::f32x64::Vec3;
use numpy::{
    PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Smears: for each color the fraction of light that is not absorbed [3 h w], and the fraction of
/// that which is not scattered [h w]. Scattered light is spread uniformly over the lit pixels,
/// whose number is given.
pub type GivenSmears<'py> = (PyReadonlyArray3<'py, f32>, PyReadonlyArray2<'py, f32>, f64);

/// Drops: indices of the affected pixels [m], of the pixels visible through each [m k], and the
/// weights of the latter [m k].
pub type GivenDrops<'py> =
    (PyReadonlyArray1<'py, u32>, PyReadonlyArray2<'py, u32>, PyReadonlyArray2<'py, f32>);

/// `GivenSmears`, as used by the core.
pub struct Smears {
    left: Vec<f32>,
    clear: Vec<f32>,
    lit: f64,
}

/// `GivenDrops`, as used by the core.
pub struct Drops<'a> {
    pixels: &'a [u32],
    seen: &'a [u32],
    weights: &'a [f32],
    count: usize,
}

impl Smears {
    /// Smears over an image of the given size.
    ///
    /// # Errors
    /// If the sizes differ.
    pub fn of(given: &GivenSmears<'_>, (height, width): (usize, usize)) -> PyResult<Self> {
        let (left, clear, lit) = given;
        if left.shape() != [3, height, width] || clear.shape() != [height, width] {
            return Err(PyValueError::new_err("Smears must be of the planes' shape (h, w)."));
        }
        Ok(Smears { left: left.as_slice()?.to_vec(), clear: clear.as_slice()?.to_vec(), lit: *lit })
    }

    /// Scattered light in every pixel of each color, given the `totals` of all rows.
    pub fn veils(&self, rows: &[Vec3]) -> Vec3 {
        let sum = |k: usize| rows.iter().map(|row| f64::from(row[k])).sum::<f64>();
        [0, 1, 2].map(|k| (sum(k) / self.lit.max(1.0)) as f32)
    }

    /// Applies the smears to a row of a plane.
    pub fn cover(&self, row: &mut [f32], (plane, y): (usize, usize), veil: f32) {
        let (width, area) = (row.len(), self.clear.len());
        let left = &self.left[plane * area + y * width..][..width];
        cover_row(row, (left, &self.clear[y * width..][..width]), veil);
    }
}

impl<'a> Drops<'a> {
    /// Drops in front of an image of `area` pixels.
    ///
    /// # Errors
    /// If indices are outside the image.
    pub fn of(given: &'a GivenDrops<'_>, area: usize) -> PyResult<Self> {
        let (pixels, seen, weights) =
            (given.0.as_slice()?, given.1.as_slice()?, given.2.as_slice()?);
        let count = if pixels.is_empty() { 0 } else { seen.len() / pixels.len() };
        let fits = seen.len() == pixels.len() * count && seen.len() == weights.len();
        let inside = |&pixel: &u32| (pixel as usize) < area;
        if !(fits && pixels.iter().all(inside) && seen.iter().all(inside)) {
            return Err(PyValueError::new_err(
                "Drops need as many sources for each of the pixels.",
            ));
        }
        Ok(Drops { pixels, seen, weights, count: count.max(1) })
    }

    /// Composites the drops over planes [3 h w].
    pub fn refract(&self, planes: &mut [f32]) {
        let area = planes.len() / 3;
        // All pixels are read before any of them changes.
        let mut seen = vec![0.0; 3 * self.pixels.len()];
        let source = &*planes;
        seen.par_chunks_mut(3 * PIXELS).enumerate().for_each(|(k, values)| {
            let first = k * PIXELS * self.count;
            let count = values.len() / 3 * self.count;
            let rays = (&self.seen[first..][..count], &self.weights[first..][..count]);
            gather(source, rays, self.count, values);
        });
        for (&pixel, colors) in self.pixels.iter().zip(seen.chunks_exact(3)) {
            for k in 0..3 {
                planes[k * area + pixel as usize] = colors[k];
            }
        }
    }
}

/// Number of pixels behind drops that one thread takes.
const PIXELS: usize = 256;

/// Sum of each color in a row.
pub fn totals(line: &Line<'_>) -> Vec3 {
    line.each_ref().map(|row| total(row))
}

/// Planes [3 h w] seen through drops and smears.
#[pyfunction]
#[pyo3(signature = (planes, smears=None, drops=None))]
pub fn dome<'py>(
    py: Python<'py>,
    planes: PyReadonlyArray3<'py, f32>,
    smears: Option<GivenSmears<'py>>,
    drops: Option<GivenDrops<'py>>,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let (height, width) = size(&planes)?;
    let smears = smears.as_ref().map(|smears| Smears::of(smears, (height, width))).transpose()?;
    let drops = drops.as_ref().map(|drops| Drops::of(drops, height * width)).transpose()?;
    let mut out = planes.as_slice()?.to_vec();
    on_pool(py, || {
        let lines = rows(&mut out, (height, width));
        let veils = smears
            .as_ref()
            .map(|smears| smears.veils(&lines.iter().map(totals).collect::<Vec<_>>()));
        if let Some(drops) = &drops {
            drops.refract(&mut out);
        }
        if let Some((smears, veils)) = smears.as_ref().zip(veils) {
            out.par_chunks_mut(width).enumerate().for_each(|(row, values)| {
                smears.cover(values, (row / height, row % height), veils[row / height]);
            });
        }
    });
    Ok(planes_array(py, out, (height, width)))
}

/// Colors of pixels behind drops, each from several rays.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn gather(planes: &[f32], (seen, weights): (&[u32], &[f32]), count: usize, out: &mut [f32]) {
    let area = planes.len() / 3;
    let planes = [0, 1, 2].map(|k| &planes[k * area..][..area]);
    let rays = seen.chunks_exact(count).zip(weights.chunks_exact(count));
    for (colors, (seen, weights)) in out.chunks_exact_mut(3).zip(rays) {
        let mut sum = [0.0; 3];
        for (&place, &weight) in seen.iter().zip(weights) {
            for k in 0..3 {
                sum[k] += weight * planes[k][place as usize];
            }
        }
        colors.copy_from_slice(&sum);
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn cover_row(row: &mut [f32], (left, clear): (&[f32], &[f32]), veil: f32) {
    for ((value, &left), &clear) in row.iter_mut().zip(left).zip(clear) {
        *value = left * (clear * (*value - veil) + veil);
    }
}

/// Sum of a row; sixteen partial sums keep the loop a vector loop.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn total(row: &[f32]) -> f32 {
    let mut partial = [0.0f32; 16];
    for part in row.chunks(16) {
        for (sum, value) in partial.iter_mut().zip(part) {
            *sum += value;
        }
    }
    partial.iter().sum()
}
