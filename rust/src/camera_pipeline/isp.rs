//! Image signal processor after demosaicing: gains, color matrix, sRGB encoding with a tone curve,
//! denoising and sharpening.
//!
//! Filters act on encoded luma and chroma (ITU-R BT.601, full range, as in JPEG) of 0 to 255. They
//! are Gaussian and normalized over the pixels that the lens lights, so that the dark border around
//! the image circle does not spread into the image.

use super::bloom::convolve;
use super::planes::{Line, develop_row, interleave, rows, size};
use super::stages::StageParams;
use crate::pool::on_pool;
use crate::render::channels::encode;
use crate::simd::f32x64::{clamp, max, pow};
use numpy::{
    IntoPyArray, PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
    ndarray::Array3,
};
use pyo3::{exceptions::PyValueError, prelude::*, types::PyDict};
use rayon::prelude::*;

/// Number of standard deviations to each side at which a Gaussian is truncated.
const REACH: f32 = 3.0;
/// Encoded value of white.
const WHITE: f32 = 255.0;

/// Rows of a matrix that acts on linear red, green, blue.
pub type Matrix = [[f32; 3]; 3];

/// Stages between the sensor and compression.
pub struct Isp {
    matrix: Option<Matrix>,
    /// Exponent and factor of the tone curve.
    tone: Option<(f32, f32)>,
    /// Low-pass filters of luma and chroma.
    denoising: Option<[Option<Blur>; 2]>,
    sharpening: Option<Sharpening>,
}

/// Unsharp mask.
struct Sharpening {
    blur: Blur,
    amount: f32,
    threshold: f32,
}

/// Gaussian filter normalized over lit pixels.
struct Blur {
    kernel: Vec<f32>,
    /// Reciprocal of the weight of lit pixels around each pixel [h w]; 0 where the pixel is unlit.
    scale: Vec<f32>,
}

impl Isp {
    /// Stages for an image of a size with a mask of lit pixels.
    pub fn new(given: &StageParams<'_>, size: (usize, usize), lit: &[bool]) -> Self {
        let blur = |sigma: f32| (sigma > 0.0).then(|| Blur::new(sigma, size, lit));
        Isp {
            matrix: given.color_matrix,
            tone: given.tone_curve,
            denoising: given.denoising.map(|(luma, chroma)| [blur(luma), blur(chroma)]),
            sharpening: given.sharpening.map(|(amount, sigma, threshold)| Sharpening {
                blur: Blur::new(sigma, size, lit),
                amount,
                threshold,
            }),
        }
    }

    fn is_filtered(&self) -> bool {
        self.denoising.is_some() || self.sharpening.is_some()
    }

    /// Develops one row of linear planes to codes, or, if filters follow, to encoded luma and
    /// chroma in place. Codes are 0 where not `lit`.
    pub fn develop(
        &self,
        line: &mut Line<'_>,
        gains: [f32; 3],
        lit: &[bool],
        codes: &mut Line<'_, u8>,
    ) {
        if self.matrix.is_none() && self.tone.is_none() && !self.is_filtered() {
            for k in 0..3 {
                develop_row(line[k], gains[k], lit, codes[k]);
            }
            return;
        }
        let [a, b, c] = self.matrix.unwrap_or([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        let scaled = |row: [f32; 3]| [0, 1, 2].map(|k| row[k] * gains[k]);
        mix_colors(line, [scaled(a), scaled(b), scaled(c)]);
        for row in line.iter_mut() {
            encode_row(row, self.tone);
        }
        if self.is_filtered() {
            to_luma_chroma(line, lit);
        } else {
            round_row(line, lit, codes);
        }
    }

    /// Denoises and sharpens developed rows; `spare` is a buffer of the same size.
    pub fn filter(
        &self,
        planes: &mut [f32],
        spare: &mut [f32],
        lit: &[bool],
        (codes, size): (&mut [u8], (usize, usize)),
    ) {
        if !self.is_filtered() {
            return;
        }
        let width = size.1;
        let denoised = &mut *spare;
        let (source, room) = match &self.denoising {
            Some(filters) => {
                let source = &*planes;
                rows(denoised, size).into_par_iter().enumerate().for_each_init(
                    Vec::new,
                    |room, (y, mut line)| {
                        for (k, row) in line.iter_mut().enumerate() {
                            let plane = &source[k * size.0 * width..][..size.0 * width];
                            match &filters[k.min(1)] {
                                Some(blur) => blur.row(plane, size, y, (room, row)),
                                None => row.copy_from_slice(&plane[y * width..][..width]),
                            }
                        }
                    },
                );
                (&*denoised, planes)
            }
            None => (&*planes, denoised),
        };
        let lines = rows(room, size).into_par_iter().zip(rows(codes, size)).enumerate();
        lines.for_each_init(Vec::new, |buffer, (y, (mut line, mut codes))| {
            for (k, row) in line.iter_mut().enumerate() {
                row.copy_from_slice(&source[(k * size.0 + y) * width..][..width]);
            }
            if let Some(sharpening) = &self.sharpening {
                let mut blurred = vec![0.0; width];
                let luma = &source[..size.0 * width];
                sharpening.blur.row(luma, size, y, (buffer, &mut blurred));
                sharpen_row(line[0], &blurred, (sharpening.amount, sharpening.threshold));
            }
            from_luma_chroma(&mut line);
            round_row(&line, &lit[y * width..][..width], &mut codes);
        });
    }
}

impl Blur {
    fn new(sigma: f32, size: (usize, usize), lit: &[bool]) -> Self {
        let reach = (REACH * sigma).ceil() as i32;
        let weight = |x: i32| libm::expf(-0.5 * (x as f32 / sigma) * (x as f32 / sigma));
        let raw: Vec<f32> = (-reach..=reach).map(weight).collect();
        let sum: f32 = raw.iter().sum();
        let kernel = raw.iter().map(|w| w / sum).collect();
        let mut blur = Blur { kernel, scale: vec![1.0; lit.len()] };
        let mask: Vec<f32> = lit.iter().map(|&lit| f32::from(u8::from(lit))).collect();
        let (mut room, mut weights) = (Vec::new(), vec![0.0; lit.len()]);
        for (y, row) in weights.chunks_exact_mut(size.1).enumerate() {
            blur.row(&mask, size, y, (&mut room, row));
        }
        let inverse = |(weight, &lit): (f32, &bool)| if lit { 1.0 / weight } else { 0.0 };
        blur.scale = weights.into_iter().zip(lit).map(inverse).collect();
        blur
    }

    /// One row of a filtered plane, which is 0 where unlit.
    fn row(
        &self,
        plane: &[f32],
        (height, width): (usize, usize),
        y: usize,
        (room, out): (&mut Vec<f32>, &mut [f32]),
    ) {
        let reach = self.kernel.len() / 2;
        room.clear();
        room.resize(width + 2 * reach, 0.0);
        let first = y.saturating_sub(reach);
        for row in first..(y + reach + 1).min(height) {
            let weight = self.kernel[row + reach - y];
            add_row(&plane[row * width..][..width], weight, &mut room[reach..reach + width]);
        }
        convolve_row(room, &self.kernel, out);
        scale_row(out, &self.scale[y * width..][..width]);
    }
}

/// 8-bit image [h w 3] of linear planes after the stages given by name.
#[pyfunction]
pub fn isp<'py>(
    py: Python<'py>,
    planes: PyReadonlyArray3<'py, f32>,
    gains: [f32; 3],
    lit: PyReadonlyArray2<'py, bool>,
    stages: Bound<'py, PyDict>,
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let (height, width) = size(&planes)?;
    if lit.shape() != [height, width] {
        return Err(PyValueError::new_err("The mask of lit pixels must fit the planes (h, w)."));
    }
    let (lit, size) = (lit.as_slice()?, (height, width));
    let isp = Isp::new(&StageParams::of(&stages)?, size, lit);
    let mut light = planes.as_slice()?.to_vec();
    let (mut spare, mut codes) = (light.clone(), vec![0u8; light.len()]);
    on_pool(py, || {
        let lines = rows(&mut light, size).into_par_iter().zip(rows(&mut codes, size)).enumerate();
        lines.for_each(|(y, (mut line, mut codes))| {
            isp.develop(&mut line, gains, &lit[y * width..][..width], &mut codes);
        });
        isp.filter(&mut light, &mut spare, lit, (&mut codes, size));
    });
    let mut image = vec![0; codes.len()];
    for (line, row) in rows(&mut codes, size).into_iter().zip(image.chunks_exact_mut(3 * width)) {
        interleave(line.each_ref().map(|row| &**row), row);
    }
    Ok(Array3::from_shape_vec((height, width, 3), image)
        .expect("every pixel was filled")
        .into_pyarray(py))
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn add_row(row: &[f32], weight: f32, sum: &mut [f32]) {
    for (sum, value) in sum.iter_mut().zip(row) {
        *sum += weight * value;
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn convolve_row(line: &[f32], kernel: &[f32], out: &mut [f32]) {
    convolve(line, kernel, 1, out);
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn scale_row(row: &mut [f32], scale: &[f32]) {
    for (value, scale) in row.iter_mut().zip(scale) {
        *value *= scale;
    }
}

/// A matrix times the colors of a row.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn mix_colors(line: &mut Line<'_>, matrix: Matrix) {
    let [red, green, blue] = line;
    let width = red.len();
    let (green, blue) = (&mut green[..width], &mut blue[..width]);
    for x in 0..width {
        let color = [red[x], green[x], blue[x]];
        let mixed = |m: [f32; 3]| m[0] * color[0] + m[1] * color[1] + m[2] * color[2];
        (red[x], green[x], blue[x]) = (mixed(matrix[0]), mixed(matrix[1]), mixed(matrix[2]));
    }
}

/// sRGB encoding of a row, and a tone curve: `1 / (1 + factor ((1 − v) / v)^exponent)` of the
/// encoded value v.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn encode_row(row: &mut [f32], tone: Option<(f32, f32)>) {
    match tone {
        None => {
            for value in row.iter_mut() {
                *value = WHITE * encode(*value);
            }
        }
        Some((exponent, factor)) => {
            for value in row.iter_mut() {
                let v = max(encode(*value), 1e-6);
                let ratio = max((1.0 - v) / v, 1e-12);
                *value = WHITE / (1.0 + factor * pow(ratio, exponent));
            }
        }
    }
}

/// Encoded colors to luma and chroma; 0 where unlit.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn to_luma_chroma(line: &mut Line<'_>, lit: &[bool]) {
    let [red, green, blue] = line;
    let width = red.len();
    let (green, blue, lit) = (&mut green[..width], &mut blue[..width], &lit[..width]);
    for x in 0..width {
        let (r, g, b) = (red[x], green[x], blue[x]);
        let keep = f32::from(u8::from(lit[x]));
        red[x] = keep * (0.299 * r + 0.587 * g + 0.114 * b);
        green[x] = keep * (-0.168_735_9 * r - 0.331_264_1 * g + 0.5 * b);
        blue[x] = keep * (0.5 * r - 0.418_687_6 * g - 0.081_312_4 * b);
    }
}

/// Luma and chroma to encoded colors.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn from_luma_chroma(line: &mut Line<'_>) {
    let [red, green, blue] = line;
    let width = red.len();
    let (green, blue) = (&mut green[..width], &mut blue[..width]);
    for x in 0..width {
        let (y, cb, cr) = (red[x], green[x], blue[x]);
        red[x] = y + 1.402 * cr;
        green[x] = y - 0.344_136_3 * cb - 0.714_136_3 * cr;
        blue[x] = y + 1.772 * cb;
    }
}

/// Adds the difference between a row and its blurred copy, reduced by a threshold.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn sharpen_row(row: &mut [f32], blurred: &[f32], (amount, threshold): (f32, f32)) {
    for (value, blurred) in row.iter_mut().zip(blurred) {
        let detail = *value - blurred;
        *value += amount * (detail - clamp(detail, -threshold, threshold));
    }
}

/// Rounds a row of encoded colors to integers; 0 where not `lit`.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn round_row(line: &Line<'_>, lit: &[bool], codes: &mut Line<'_, u8>) {
    for (row, codes) in line.iter().zip(codes) {
        for ((code, &value), &lit) in codes.iter_mut().zip(row.iter()).zip(lit) {
            // Adding 2²³ rounds to an integer and leaves it in the low bits.
            let byte = (clamp(value, 0.0, WHITE) + 8_388_608.0).to_bits() as u8;
            *code = byte & u8::from(lit).wrapping_neg();
        }
    }
}
