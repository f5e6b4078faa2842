//! Bloom and veiling glare: light that the lens and its dome scatter around its image.

use super::planes::{Line, planes_array, rows, size};
use crate::pool::on_pool;
use numpy::{PyArray3, PyReadonlyArray3};
use pyo3::prelude::*;
use rayon::prelude::*;

/// Side in pixels of the cells in which scattered light is computed, because it varies slowly.
const CELL: usize = 4;
/// Offset of the first cell's center [px].
const HALF: usize = CELL / 2;
/// Weights of the second of two cells at the pixels between their centers.
const WEIGHTS: [f32; CELL] = [0.125, 0.375, 0.625, 0.875];
/// Width of the veil, relative to the halo.
const VEIL: f32 = 4.0;
/// Standard deviation in cells above which a coarser grid of cells is used.
const WIDE: f32 = 8.0;

/// The image with a fraction of its light scattered.
///
/// The point-spread function is `(1 − fraction) δ + fraction (G(σ) + G(4σ)) / 2`, with Gaussians G
/// of standard deviation σ = `sigma` [px]; light that leaves the image is lost.
#[pyfunction]
pub fn bloom<'py>(
    py: Python<'py>,
    planes: PyReadonlyArray3<'py, f32>,
    fraction: f32,
    sigma: f32,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let (height, width) = size(&planes)?;
    let source = planes.as_slice()?;
    let mut out = vec![0.0; source.len()];
    on_pool(py, || {
        let bloom = Bloom { fraction, sigma };
        let scattered = bloom.scattered(source, (height, width));
        rows(&mut out, (height, width)).into_par_iter().enumerate().for_each(|(y, mut line)| {
            for (k, row) in line.iter_mut().enumerate() {
                row.copy_from_slice(&source[(k * height + y) * width..][..width]);
            }
            scattered.mix_into(y, &mut line);
        });
    });
    Ok(planes_array(py, out, (height, width)))
}

/// Fraction of the light that is scattered, and its distance [px].
#[derive(Clone, Copy)]
pub struct Bloom {
    /// Fraction of the light.
    pub fraction: f32,
    /// Standard deviation of the halo.
    pub sigma: f32,
}

/// Scattered light of an image.
pub struct Scattered {
    fraction: f32,
    height: usize,
    /// Planes with one row per row of cells, each as wide as the image, times the fraction.
    planes: [Vec<f32>; 3],
    width: usize,
}

impl Bloom {
    /// Light that an image [3 h w] scatters.
    pub fn scattered(&self, source: &[f32], (height, width): (usize, usize)) -> Scattered {
        let cells = (height.div_ceil(CELL), width.div_ceil(CELL));
        let mut coarse = vec![0.0; 3 * cells.0 * cells.1];
        coarse.par_chunks_mut(cells.1).with_min_len(CELL).enumerate().for_each(|(k, line)| {
            let (plane, row) = (k / cells.0, k % cells.0);
            let image = &source[plane * height * width..][..height * width];
            gather_row(image, (height, width), row, line);
        });
        let planes: Vec<Vec<f32>> = coarse
            .par_chunks(cells.0 * cells.1)
            .map(|coarse| {
                let (halo, veil) = rayon::join(
                    || blurred(coarse, cells, cell_sigma(self.sigma)),
                    || widely_blurred(coarse, cells, cell_sigma(VEIL * self.sigma)),
                );
                let both: Vec<f32> =
                    halo.iter().zip(&veil).map(|(a, b)| 0.5 * self.fraction * (a + b)).collect();
                across(&both, cells, width)
            })
            .collect();
        let [red, green, blue] = planes.try_into().expect("three planes");
        Scattered { fraction: self.fraction, height, planes: [red, green, blue], width }
    }
}

impl Scattered {
    /// Adds scattered light to the unscattered fraction of one row of the image.
    pub fn mix_into(&self, y: usize, line: &mut Line<'_>) {
        let (top, bottom, t) = between(y, self.height.div_ceil(CELL));
        for (plane, row) in self.planes.iter().zip(line) {
            let [top, bottom] = [top, bottom].map(|r| &plane[r * self.width..][..self.width]);
            mix_row((top, bottom, t), 1.0 - self.fraction, row);
        }
    }
}

/// Runs `blurred` for a Gaussian that is wide enough for coarser cells.
fn widely_blurred(cells: &[f32], (rows, columns): (usize, usize), sigma: f32) -> Vec<f32> {
    if sigma < WIDE {
        return blurred(cells, (rows, columns), sigma);
    }
    let coarser = (rows.div_ceil(CELL), columns.div_ceil(CELL));
    let mut gathered = vec![0.0; coarser.0 * coarser.1];
    for (row, line) in gathered.chunks_exact_mut(coarser.1).enumerate() {
        gather_row(cells, (rows, columns), row, line);
    }
    let wide = across(&blurred(&gathered, coarser, cell_sigma(sigma)), coarser, columns);
    let mut out = vec![0.0; rows * columns];
    for (y, row) in out.chunks_exact_mut(columns).enumerate() {
        let (top, bottom, t) = between(y, coarser.0);
        let [top, bottom] = [top, bottom].map(|r| &wide[r * columns..][..columns]);
        mix_row((top, bottom, t), 0.0, row);
    }
    out
}

/// Standard deviation in cells: downsampling and interpolation have blurred by c²/6 each.
fn cell_sigma(sigma: f32) -> f32 {
    let cell = CELL as f32;
    (sigma * sigma - cell * cell / 3.0).max(0.0).sqrt() / cell
}

/// Cells on both sides of a pixel, and the weight of the second.
fn between(fine: usize, count: usize) -> (usize, usize, f32) {
    let at = ((fine as f32 + 0.5) / CELL as f32 - 0.5).clamp(0.0, count as f32 - 1.0);
    (at as usize, (at as usize + 1).min(count - 1), at - (at as usize) as f32)
}

/// Mean light of a row of cells: each pixel's light goes to the nearest cells, so that its position
/// is kept.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn gather_row(plane: &[f32], (height, width): (usize, usize), cell: usize, line: &mut [f32]) {
    let (rows, columns) = (height.div_ceil(CELL), line.len());
    // Whole rows are summed vertically first, then the resulting row horizontally.
    let mut tall = vec![0.0f32; width];
    let (first, last) =
        ((cell * CELL).saturating_sub(HALF), ((cell + 1) * CELL + HALF).min(height));
    for (y, row) in (first..last).zip(plane[first * width..].chunks_exact(width)) {
        let (top, bottom, t) = between(y, rows);
        let fraction = |into: usize, fraction: f32| if into == cell { fraction } else { 0.0 };
        let fraction = (fraction(top, 1.0 - t) + fraction(bottom, t)) / (CELL * CELL) as f32;
        for (sum, value) in tall.iter_mut().zip(row) {
            *sum += fraction * value;
        }
    }
    line.fill(0.0);
    let (first, rest) = tall.split_at(HALF.min(width));
    line[0] += first.iter().sum::<f32>();
    for (left, part) in rest.chunks(CELL).enumerate() {
        let (mut whole, mut beyond) = (0.0, 0.0);
        for (value, fraction) in part.iter().zip(WEIGHTS) {
            whole += value;
            beyond += value * fraction;
        }
        line[left] += whole - beyond;
        line[(left + 1).min(columns - 1)] += beyond;
    }
}

/// Convolution with a Gaussian, 0 outside the image.
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
    // Horizontally first, then vertically, with zeros outside the image.
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

/// Weighted sums of values at a distance of `step`, by a kernel.
#[inline(always)]
pub fn convolve(source: &[f32], kernel: &[f32], step: usize, out: &mut [f32]) {
    let begin = sums::<64>(source, kernel, step, 0, out);
    let begin = sums::<16>(source, kernel, step, begin, out);
    sums::<1>(source, kernel, step, begin, out);
}

/// Computes sums from one index on, N at a time as long as N are left; returns the next index.
#[inline(always)]
fn sums<const N: usize>(
    source: &[f32],
    kernel: &[f32],
    step: usize,
    mut begin: usize,
    out: &mut [f32],
) -> usize {
    while begin + N <= out.len() {
        let mut sum = [0.0f32; N];
        for (k, weight) in kernel.iter().enumerate() {
            let from = &source[begin + k * step..][..N];
            for i in 0..N {
                sum[i] += weight * from[i];
            }
        }
        out[begin..begin + N].copy_from_slice(&sum);
        begin += N;
    }
    begin
}

/// Rows of cells at full width, interpolated linearly between the centers of cells.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn across(cells: &[f32], (rows, columns): (usize, usize), width: usize) -> Vec<f32> {
    let mut wide = vec![0.0f32; rows * width];
    for (row, line) in wide.chunks_exact_mut(width).zip(cells.chunks_exact(columns)) {
        let (first, rest) = row.split_at_mut(HALF.min(width));
        first.fill(line[0]);
        for (left, part) in rest.chunks_mut(CELL).enumerate() {
            let (own, next) = (line[left], line[(left + 1).min(columns - 1)]);
            for (value, fraction) in part.iter_mut().zip(WEIGHTS) {
                *value = own + (next - own) * fraction;
            }
        }
    }
    wide
}

/// Blends a fraction of a row with the interpolation of two rows.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn mix_row((top, bottom, t): (&[f32], &[f32], f32), fraction: f32, row: &mut [f32]) {
    let (top, bottom) = (&top[..row.len()], &bottom[..row.len()]);
    for x in 0..row.len() {
        row[x] = fraction * row[x] + (top[x] + (bottom[x] - top[x]) * t);
    }
}
