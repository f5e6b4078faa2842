//! Loss and file size of JPEG (ITU-T T.81, baseline, color at half the resolution). The file itself
//! is not written: Huffman coding is lossless, so only its length is computed, to 2 %: the 0 that a
//! file stores after each byte 255 is not counted.

use super::dct::{Basis, Block, bases, transform_2d};
use super::jpeg_tables::{AC_BITS_CHROMINANCE, AC_BITS_LUMINANCE, DC_BITS, STEPS};
use super::planes::interleave;
use crate::pool::on_pool;
use crate::simd::f32x64::clamp;
use numpy::{IntoPyArray, PyArray3, PyReadonlyArray3, PyUntypedArrayMethods, ndarray::Array3};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Number of bytes besides the image data: markers and tables of a color file.
const HEADER: usize = 623;

/// Order in which the coefficients of a block are coded.
const ZIGZAG: [u8; 64] = [
    0, 1, 8, 16, 9, 2, 3, 10, 17, 24, 32, 25, 18, 11, 4, 5, 12, 19, 26, 33, 40, 48, 41, 34, 27, 20,
    13, 6, 7, 14, 21, 28, 35, 42, 49, 56, 57, 50, 43, 36, 29, 22, 15, 23, 30, 37, 44, 51, 58, 59,
    52, 45, 38, 31, 39, 46, 53, 60, 61, 54, 47, 55, 62, 63,
];

/// The image [h w 3] after JPEG compression and decompression.
#[pyfunction]
pub fn jpeg<'py>(
    py: Python<'py>,
    image: PyReadonlyArray3<'py, u8>,
    quality: u32,
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let (source, size) = checked(&image, quality)?;
    let mut pixels = vec![0; source.len()];
    on_pool(py, || decode(&planes_of(source), size, &both_steps(quality), &mut pixels));
    let shape = (size.0, size.1, 3);
    Ok(Array3::from_shape_vec(shape, pixels).expect("every pixel was filled").into_pyarray(py))
}

/// Size of the JPEG file of an image [h w 3] [bytes].
#[pyfunction]
pub fn jpeg_bytes(
    py: Python<'_>,
    image: PyReadonlyArray3<'_, u8>,
    quality: u32,
) -> PyResult<usize> {
    let (source, size) = checked(&image, quality)?;
    Ok(on_pool(py, || Spectrum::new(&planes_of(source), size).bytes(&both_steps(quality))))
}

/// Highest quality up to `quality` at which the JPEG file fits into the given bytes, 1 if there is
/// none.
#[pyfunction]
pub fn jpeg_quality(
    py: Python<'_>,
    image: PyReadonlyArray3<'_, u8>,
    quality: u32,
    max_bytes: usize,
) -> PyResult<u32> {
    let (source, size) = checked(&image, quality)?;
    Ok(on_pool(py, || Spectrum::new(&planes_of(source), size).best_quality(quality, max_bytes)))
}

/// Pixels, height and width of an image.
fn checked<'a>(
    image: &'a PyReadonlyArray3<'_, u8>,
    quality: u32,
) -> PyResult<(&'a [u8], (usize, usize))> {
    let [height, width, 3] = image.shape()[..] else {
        return Err(PyValueError::new_err("An image must be of shape (h, w, 3)."));
    };
    if height * width == 0 || !(1..=100).contains(&quality) {
        return Err(PyValueError::new_err("JPEG is of an image, with a quality from 1 to 100."));
    }
    Ok((image.as_slice()?, (height, width)))
}

/// Planes [3 h w] of an image [h w 3].
fn planes_of(image: &[u8]) -> Vec<u8> {
    (0..3).flat_map(|k| image.iter().skip(k).step_by(3).copied()).collect()
}

/// Compression settings of an image.
#[derive(Clone, Copy)]
pub struct Compression {
    /// Quality, 1 to 100.
    pub quality: u32,
    /// Maximum file size [bytes].
    pub max_bytes: Option<usize>,
}

impl Compression {
    /// Writes the image [h w 3] that remains of planes [3 h w].
    pub fn apply(&self, planes: &[u8], size: (usize, usize), out: &mut [u8]) {
        let fitting = |most| Spectrum::new(planes, size).best_quality(self.quality, most);
        let quality = self.max_bytes.map_or(self.quality, fitting);
        decode(planes, size, &both_steps(quality), out);
    }
}

/// Quantization steps of both tables.
fn both_steps(quality: u32) -> [Block; 2] {
    [0, 1].map(|table| steps(table, quality))
}

/// Quantization steps of a table at a quality, scaled as by the Independent JPEG Group's library.
fn steps(table: usize, quality: u32) -> Block {
    let percent = if quality < 50 { 5000 / quality } else { 200 - 2 * quality };
    STEPS[table].map(|s| ((u32::from(s) * percent + 50) / 100).clamp(1, 255) as f32)
}

/// Nearest integer.
#[inline(always)]
fn nearest(x: f32) -> f32 {
    (x + 12_582_912.0) - 12_582_912.0
}

/// Coefficients of the three components, in bands of 16 rows of pixels.
struct Spectrum {
    /// For each band: blocks of luminance, four per square of 16 pixels, then of both colors.
    bands: Vec<Band>,
}

struct Band {
    luminance: Vec<Block>,
    colors: [Vec<Block>; 2],
}

impl Spectrum {
    fn new(pixels: &[u8], size: (usize, usize)) -> Self {
        let forth = bases().0;
        let bands = (0..size.0.div_ceil(16)).into_par_iter();
        Spectrum { bands: bands.map(|b| analyzed(pixels, size, b, &forth)).collect() }
    }

    /// File size [bytes].
    fn bytes(&self, steps: &[Block; 2]) -> usize {
        let numbers = |block: &Block, table: usize| quantized(block, &steps[table]);
        let mut bits = 0;
        let mut last = [0i32; 3];
        for band in &self.bands {
            for (square, four) in band.luminance.chunks_exact(4).enumerate() {
                for block in four {
                    bits += block_bits(&numbers(block, 0), 0, &mut last[0]);
                }
                for (k, color) in band.colors.iter().enumerate() {
                    bits += block_bits(&numbers(&color[square], 1), 1, &mut last[k + 1]);
                }
            }
        }
        HEADER + bits.div_ceil(8)
    }

    fn best_quality(&self, highest: u32, max_bytes: usize) -> u32 {
        let (mut good, mut bad) = (1, highest + 1);
        while bad - good > 1 {
            let middle = (good + bad) / 2;
            let fits = self.bytes(&both_steps(middle)) <= max_bytes;
            if fits { good = middle } else { bad = middle }
        }
        good
    }
}

/// Decodes the compressed image of planes, band by band.
fn decode(pixels: &[u8], size: (usize, usize), steps: &[Block; 2], out: &mut [u8]) {
    let (height, width) = size;
    let (forth, back) = bases();
    let squares = width.div_ceil(16);
    let band = |number: usize| {
        let band = analyzed(pixels, size, number, &forth);
        synthesized(&band, steps, &back, squares)
    };
    let planes: Vec<[Vec<f32>; 3]> = (0..height.div_ceil(16)).into_par_iter().map(band).collect();
    out.par_chunks_mut(16 * width * 3).enumerate().for_each(|(band, rows)| {
        let mut colors = [0; 2].map(|_| vec![0.0; squares * 16]);
        let mut codes = vec![0; 3 * width];
        for (line, row) in rows.chunks_exact_mut(width * 3).enumerate() {
            let y = band * 16 + line;
            let light = &planes[band][0][line * squares * 16..][..width];
            for (k, color) in colors.iter_mut().enumerate() {
                finer(lines_about(&planes, k + 1, y, height, squares * 8), width, color);
            }
            write_row(light, [&colors[0], &colors[1]], &mut codes, row);
        }
    });
}

/// Rows of a half-resolution color nearest to a row of the image, the second farther away.
fn lines_about(
    planes: &[[Vec<f32>; 3]],
    plane: usize,
    y: usize,
    height: usize,
    stride: usize,
) -> [&[f32]; 2] {
    let last = height.div_ceil(2) - 1;
    let near = y / 2;
    let far = if y.is_multiple_of(2) { near.saturating_sub(1) } else { (near + 1).min(last) };
    [near, far].map(|row| &planes[row / 8][plane][row % 8 * stride..][..stride])
}

/// Coefficients of one band of 16 rows; the last pixels are repeated beyond the image.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn analyzed(
    pixels: &[u8],
    (height, width): (usize, usize),
    band: usize,
    basis: &[Basis; 2],
) -> Band {
    let stride = width.div_ceil(16) * 16;
    let [mut light, mut blue, mut red] = [0; 3].map(|_| vec![0.0f32; 16 * stride]);
    let mut colors = [0; 3].map(|_| vec![0.0f32; stride]);
    for line in 0..16 {
        let y = (band * 16 + line).min(height - 1);
        for (k, color) in colors.iter_mut().enumerate() {
            let row = &pixels[(k * height + y) * width..][..width];
            for (value, &code) in color.iter_mut().zip(row) {
                *value = f32::from(code);
            }
            let last = color[width - 1];
            color[width..].fill(last);
        }
        let [r, g, b] = &colors;
        let inside = line * stride..(line + 1) * stride;
        let (light, blue, red) =
            (&mut light[inside.clone()], &mut blue[inside.clone()], &mut red[inside]);
        for x in 0..stride {
            light[x] = nearest(0.299 * r[x] + 0.587 * g[x] + 0.114 * b[x]) - 128.0;
            blue[x] = nearest(-0.168_735_9 * r[x] - 0.331_264_1 * g[x] + 0.5 * b[x]);
            red[x] = nearest(0.5 * r[x] - 0.418_687_6 * g[x] - 0.081_312_4 * b[x]);
        }
    }
    let mut luminance = Vec::with_capacity(stride / 4);
    for x in (0..stride).step_by(16) {
        for (v, u) in [(0, 0), (0, 8), (8, 0), (8, 8)] {
            luminance.push(transformed(&light, stride, (v, x + u), basis));
        }
    }
    let mut colors = [Vec::with_capacity(stride / 16), Vec::with_capacity(stride / 16)];
    for (blocks, plane) in colors.iter_mut().zip([blue, red]) {
        let half = halved(&plane, stride);
        for x in (0..stride / 2).step_by(8) {
            blocks.push(transformed(&half, stride / 2, (0, x), basis));
        }
    }
    Band { luminance, colors }
}

/// Coefficients of the block at a row and column of a plane.
#[inline(always)]
fn transformed(plane: &[f32], stride: usize, (y, x): (usize, usize), basis: &[Basis; 2]) -> Block {
    let mut values = [0.0; 64];
    for k in 0..8 {
        values[k * 8..k * 8 + 8].copy_from_slice(&plane[(y + k) * stride + x..][..8]);
    }
    transform_2d(&basis[0], &basis[1], &values)
}

/// Means of 2 × 2 pixels of 16 rows, rounded up and down alternately.
#[inline(always)]
fn halved(plane: &[f32], stride: usize) -> Vec<f32> {
    let mut out = vec![0.0; 8 * stride / 2];
    for (y, row) in out.chunks_exact_mut(stride / 2).enumerate() {
        let (top, bottom) = (&plane[2 * y * stride..], &plane[(2 * y + 1) * stride..]);
        for (x, value) in row.iter_mut().enumerate() {
            let sum = top[2 * x] + top[2 * x + 1] + bottom[2 * x] + bottom[2 * x + 1];
            *value = (0.25 * (sum + (1 + x % 2) as f32)).floor();
        }
    }
    out
}

#[inline(always)]
fn quantized(block: &Block, steps: &Block) -> Block {
    let mut numbers = [0.0; 64];
    for k in 0..64 {
        numbers[k] = nearest(block[k] / steps[k]);
    }
    numbers
}

/// Number of bits of a block's coefficients; `last` is the DC coefficient of the previous block.
fn block_bits(numbers: &Block, table: usize, last: &mut i32) -> usize {
    let size = |number: i32| (32 - number.unsigned_abs().leading_zeros()) as usize;
    let constant = numbers[0] as i32;
    let change = size(constant - *last);
    *last = constant;
    let mut bits = usize::from(DC_BITS[table][change.min(11)]) + change;
    let codes = if table == 0 { &AC_BITS_LUMINANCE } else { &AC_BITS_CHROMINANCE };
    let mut run = 0;
    for &place in &ZIGZAG[1..] {
        let number = numbers[place as usize] as i32;
        if number == 0 {
            run += 1;
            continue;
        }
        bits += run / 16 * usize::from(codes[15][0]);
        let length = size(number).min(10);
        bits += usize::from(codes[run % 16][length]) + length;
        run = 0;
    }
    if run > 0 { bits + usize::from(codes[0][0]) } else { bits }
}

/// Planes of a band: 16 rows of luminance, 8 of each color.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn synthesized(
    band: &Band,
    steps: &[Block; 2],
    back: &[Basis; 2],
    squares: usize,
) -> [Vec<f32>; 3] {
    let (wide, narrow) = (squares * 16, squares * 8);
    let mut planes = [vec![0.0; 16 * wide], vec![0.0; 8 * narrow], vec![0.0; 8 * narrow]];
    let restored = |block: &Block, table: usize| {
        let mut numbers = quantized(block, &steps[table]);
        for k in 0..64 {
            numbers[k] *= steps[table][k];
        }
        let mut values = transform_2d(&back[0], &back[1], &numbers);
        for value in &mut values {
            // A decoder has 8-bit integers.
            *value = nearest(clamp(*value, -128.0, 127.0));
        }
        values
    };
    for (square, four) in band.luminance.chunks_exact(4).enumerate() {
        for (k, block) in four.iter().enumerate() {
            let values = restored(block, 0);
            let place = (k / 2 * 8) * wide + square * 16 + k % 2 * 8;
            for (y, row) in values.chunks_exact(8).enumerate() {
                planes[0][place + y * wide..][..8].copy_from_slice(row);
            }
        }
    }
    for (k, color) in band.colors.iter().enumerate() {
        for (square, block) in color.iter().enumerate() {
            for (y, row) in restored(block, 1).chunks_exact(8).enumerate() {
                planes[k + 1][y * narrow + square * 8..][..8].copy_from_slice(row);
            }
        }
    }
    planes
}

/// One row of a color at full resolution: linear, 3 to 1, between neighbors.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn finer([near, far]: [&[f32]; 2], width: usize, out: &mut [f32]) {
    let columns = width.div_ceil(2);
    // One more at each end, which repeats the edge of the image.
    let mut mixed = vec![0.0; columns + 2];
    for ((value, near), far) in mixed[1..=columns].iter_mut().zip(near).zip(far) {
        *value = 0.75 * near + 0.25 * far;
    }
    (mixed[0], mixed[columns + 1]) = (mixed[1], mixed[columns]);
    let (left, right) = (&mixed[..columns], &mixed[2..]);
    let (own, pairs) = (&mixed[1..=columns], out.chunks_exact_mut(2));
    for (((pair, own), left), right) in pairs.zip(own).zip(left).zip(right) {
        pair[0] = 0.75 * own + 0.25 * left;
        pair[1] = 0.75 * own + 0.25 * right;
    }
}

/// One row of pixels; `codes` is a buffer for its planes.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn write_row(light: &[f32], [blue, red]: [&[f32]; 2], codes: &mut [u8], out: &mut [u8]) {
    let count = light.len();
    let (blue, red) = (&blue[..count], &red[..count]);
    let (r, rest) = codes.split_at_mut(count);
    let (g, b) = rest.split_at_mut(count);
    let b = &mut b[..count];
    // Adding 2²³ rounds to an integer and leaves it in the low bits.
    let byte = |value: f32| (clamp(value, 0.0, 255.0) + 8_388_608.0).to_bits() as u8;
    for x in 0..count {
        let y = light[x] + 128.0;
        r[x] = byte(y + 1.402 * red[x]);
        g[x] = byte(y - 0.344_136_3 * blue[x] - 0.714_136_3 * red[x]);
        b[x] = byte(y + 1.772 * blue[x]);
    }
    interleave([r, g, b], out);
}
