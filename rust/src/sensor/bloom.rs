//! Bloom and veiling glare: light that the lens and its dome scatter about its image.

use super::planes::{planes_array, size};
use crate::cpu::on_pool;
use numpy::{PyArray3, PyReadonlyArray3};
use pyo3::prelude::*;
use rayon::prelude::*;

/// Pixels to a side that the scattered light is gathered from: it varies slowly.
const CELL: usize = 4;
/// Numbers summed up together.
const CHUNK: usize = 16;
/// Width of the veil, relative to the halo.
const VEIL: f32 = 4.0;

/// The image with a share of its light scattered.
///
/// The point-spread function is `(1 − share) δ + share (G(σ) + G(4σ)) / 2`, with Gaussians G of
/// standard deviation σ = `sigma` [px]; light that leaves the image is lost.
#[pyfunction]
pub fn bloom<'py>(
    py: Python<'py>,
    planes: PyReadonlyArray3<'py, f32>,
    share: f32,
    sigma: f32,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let (height, width) = size(&planes)?;
    let source = planes.as_slice()?;
    let mut out = vec![0.0; source.len()];
    on_pool(py, || {
        let area = height * width;
        out.par_chunks_mut(area).zip(source.par_chunks(area)).for_each(|(into, from)| {
            let cells = (height.div_ceil(CELL), width.div_ceil(CELL));
            let coarse = gathered(from, width, cells);
            let halo = blurred(&coarse, cells, cell_sigma(sigma));
            let veil = blurred(&coarse, cells, cell_sigma(VEIL * sigma));
            let scattered: Vec<f32> = halo.iter().zip(&veil).map(|(a, b)| 0.5 * (a + b)).collect();
            mix_in(from, &scattered, cells, share, width, into);
        });
    });
    Ok(planes_array(py, out, (height, width)))
}

/// Standard deviation in cells: spreading to cells and interpolating have blurred by c²/6 each.
fn cell_sigma(sigma: f32) -> f32 {
    let cell = CELL as f32;
    (sigma * sigma - cell * cell / 3.0).max(0.0).sqrt() / cell
}

/// The cells on both sides of a pixel, and its share of the second.
fn between(fine: usize, count: usize) -> (usize, usize, f32) {
    let at = ((fine as f32 + 0.5) / CELL as f32 - 0.5).clamp(0.0, count as f32 - 1.0);
    (at as usize, (at as usize + 1).min(count - 1), at - (at as usize) as f32)
}

/// Light by cells, as a mean: each pixel's goes to the nearest cells, so that its place is kept.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn gathered(plane: &[f32], width: usize, (rows, columns): (usize, usize)) -> Vec<f32> {
    // Down first, whole rows at a time, then along what few rows are left.
    let mut tall = vec![0.0f32; rows * width];
    for (y, row) in plane.chunks_exact(width).enumerate() {
        let (top, bottom, t) = between(y, rows);
        for (into, share) in [(top, 1.0 - t), (bottom, t)] {
            let share = share / (CELL * CELL) as f32;
            for (sum, value) in tall[into * width..][..width].iter_mut().zip(row) {
                *sum += share * value;
            }
        }
    }
    let across: Vec<_> = (0..width).map(|x| between(x, columns)).collect();
    let mut cells = vec![0.0f32; rows * columns];
    for (line, row) in cells.chunks_exact_mut(columns).zip(tall.chunks_exact(width)) {
        for (&value, &(left, right, s)) in row.iter().zip(&across) {
            line[left] += value * (1.0 - s);
            line[right] += value * s;
        }
    }
    cells
}

/// Convolution with a Gaussian, dark outside.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn blurred(cells: &[f32], (rows, columns): (usize, usize), sigma: f32) -> Vec<f32> {
    let reach = (4.0 * sigma).ceil() as usize;
    let raw: Vec<f32> = (0..=2 * reach)
        .map(|k| {
            let x = (k as f32 - reach as f32) / sigma.max(1e-6);
            libm::expf(-0.5 * x * x)
        })
        .collect();
    let whole: f32 = raw.iter().sum();
    let kernel: Vec<f32> = raw.iter().map(|w| w / whole).collect();
    // First along, with nothing beside the image, then down, with nothing above and below.
    let stride = columns + 2 * reach;
    let mut wide = vec![0.0; rows * stride];
    for (line, from) in wide.chunks_exact_mut(stride).zip(cells.chunks_exact(columns)) {
        line[reach..reach + columns].copy_from_slice(from);
    }
    let mut tall = vec![0.0; (rows + 2 * reach) * columns];
    let inner = &mut tall[reach * columns..(reach + rows) * columns];
    for (into, line) in inner.chunks_exact_mut(columns).zip(wide.chunks_exact(stride)) {
        convolve(line, &kernel, 1, into);
    }
    let mut out = vec![0.0; cells.len()];
    convolve(&tall, &kernel, columns, &mut out);
    out
}

/// Sums of numbers that are `step` apart, weighted by a kernel.
#[inline(always)]
fn convolve(source: &[f32], kernel: &[f32], step: usize, out: &mut [f32]) {
    for (number, into) in out.chunks_mut(CHUNK).enumerate() {
        let mut sum = [0.0f32; CHUNK];
        if into.len() == CHUNK {
            for (k, weight) in kernel.iter().enumerate() {
                let from = &source[number * CHUNK + k * step..][..CHUNK];
                for i in 0..CHUNK {
                    sum[i] += weight * from[i];
                }
            }
        } else {
            for (k, weight) in kernel.iter().enumerate() {
                let from = &source[number * CHUNK + k * step..][..into.len()];
                for (sum, value) in sum.iter_mut().zip(from) {
                    *sum += weight * value;
                }
            }
        }
        let count = into.len();
        into.copy_from_slice(&sum[..count]);
    }
}

/// Direct light and scattered light, the latter linear between the middles of cells.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn mix_in(
    plane: &[f32],
    cells: &[f32],
    (rows, columns): (usize, usize),
    share: f32,
    width: usize,
    out: &mut [f32],
) {
    // Along first, in the few rows of cells, then down, whole rows at a time.
    let across: Vec<_> = (0..width).map(|x| between(x, columns)).collect();
    let mut wide = vec![0.0f32; rows * width];
    for (row, line) in wide.chunks_exact_mut(width).zip(cells.chunks_exact(columns)) {
        for (value, &(left, right, s)) in row.iter_mut().zip(&across) {
            *value = share * (line[left] * (1.0 - s) + line[right] * s);
        }
    }
    for (y, (into, from)) in out.chunks_exact_mut(width).zip(plane.chunks_exact(width)).enumerate()
    {
        let (top, bottom, t) = between(y, rows);
        let (top, bottom) = (&wide[top * width..][..width], &wide[bottom * width..][..width]);
        for x in 0..width {
            into[x] = (1.0 - share) * from[x] + (top[x] + (bottom[x] - top[x]) * t);
        }
    }
}
