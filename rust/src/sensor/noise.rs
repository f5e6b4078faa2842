//! Photons to numbers: shot noise, read noise, fixed pattern, quantisation.
//!
//! Random numbers are hashes of (key, site), so that they depend on nothing else.

use super::planes::size;
use crate::lanes::{clamp, exp2, log2, max};
use numpy::{
    IntoPyArray, PyArray2, PyArrayDyn, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
    ndarray::{Array2, Array3},
};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Mean from which a Poisson variable is drawn as a normal one with its skewness; below it, exactly.
const MANY: f32 = 12.0;
/// Sites worked on together.
const CHUNK: usize = 64;

/// Bits that depend on all of a 32-bit number (Wellons' `lowbias32`).
#[inline(always)]
fn scramble(x: u32) -> u32 {
    let x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
    let x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// A stream of numbers, one a site.
#[derive(Clone, Copy)]
struct Stream {
    first: u32,
    second: u32,
}

impl Stream {
    /// Of a key, number `index`.
    fn new(key: u64, index: u64) -> Self {
        // SplitMix64 (Steele, Lea, Flood, OOPSLA 2014).
        let mut z = key.wrapping_add(index.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^= z >> 31;
        Stream { first: z as u32, second: (z >> 32) as u32 }
    }

    /// Uniform in (0, 1), in steps of 2⁻²³.
    #[inline(always)]
    fn uniform(self, site: u32) -> f32 {
        let bits = scramble(scramble(site.wrapping_add(self.first)) ^ self.second);
        ((bits >> 9) as f32 + 0.5) * (1.0 / 8_388_608.0)
    }
}

/// The standard normal quantile of `u` in (0, 1) (Giles, GPU Computing Gems 2, 2012, single
/// precision).
#[inline(always)]
fn quantile(u: f32) -> f32 {
    let w = -std::f32::consts::LN_2 * log2(4.0 * u * (1.0 - u));
    let a = w - 2.5;
    let middle = 1.501_409_4
        + a * (0.246_640_73
            + a * (-0.004_177_681_6
                + a * (-0.001_253_725
                    + a * (0.000_218_580_87
                        + a * (-4.391_506_5e-6
                            + a * (-3.523_387_7e-6
                                + a * (3.432_739_4e-7 + a * 2.810_226_4e-8)))))));
    let b = max(w, 0.0).sqrt() - 3.0;
    let tail = 2.832_976_8
        + b * (1.001_674
            + b * (0.009_438_87
                + b * (-0.007_622_461_3
                    + b * (0.005_739_507_7
                        + b * (-0.003_673_428_4
                            + b * (0.001_349_343_2
                                + b * (0.000_100_950_56 + b * -0.000_200_214_26)))))));
    let inverse = if w < 5.0 { middle } else { tail };
    std::f32::consts::SQRT_2 * inverse * (2.0 * u - 1.0)
}

/// The Poisson quantile of `u` for a small mean, by adding up probabilities.
fn few(mean: f32, u: f32) -> f32 {
    let mut probability = exp2(-mean * std::f32::consts::LOG2_E);
    let (mut sum, mut count) = (probability, 0.0f32);
    while u > sum && count < 64.0 {
        count += 1.0;
        probability *= mean / count;
        sum += probability;
    }
    count
}

/// The Poisson quantile of a large mean, from a standard normal number: Cornish and Fisher's series
/// to the skewness, rounded.
#[inline(always)]
fn many(mean: f32, z: f32) -> f32 {
    let count = mean + mean.sqrt() * z + (z * z - 1.0) / 6.0;
    max((count + 0.5).floor(), 0.0)
}

/// Standard normal numbers [h w] of a key's stream.
#[pyfunction]
pub fn normals(
    py: Python<'_>,
    shape: (usize, usize),
    key: u64,
    stream: u64,
) -> Bound<'_, PyArray2<f32>> {
    let stream = Stream::new(key, stream);
    let values: Vec<f32> =
        (0..shape.0 * shape.1).map(|site| quantile(stream.uniform(site as u32))).collect();
    Array2::from_shape_vec(shape, values).expect("every site was filled").into_pyarray(py)
}

/// What turns light into numbers.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Readout {
    /// Electrons of a green site at the image value 1.
    full_well: f32,
    /// Standard deviation of a reading [electrons].
    read_noise: f32,
    /// Amplification before the converter.
    gain: f32,
    /// Largest number of the converter, and its number for no light.
    white: f32,
    black: f32,
    /// Response of red, green and blue sites.
    response: [f32; 3],
}

/// The image as the sensor's converter gives it, scaled back to image values.
///
/// Of each site the light is `value · response · full_well · pattern[0]` electrons on average; their
/// number is a Poisson variable. To it come the site's offset `pattern[1]` and read noise
/// [electrons]; amplified, rounded to whole numbers and cut to the converter's range it is the
/// reading. With a `mosaic`, the colours of 2 by 2 sites, there is one site a pixel and the result
/// is [1 h w], else there are three and it is [3 h w].
#[pyfunction]
pub fn read_sensor<'py>(
    py: Python<'py>,
    planes: PyReadonlyArray3<'py, f32>,
    pattern: [PyReadonlyArray2<'py, f32>; 2],
    readout: Readout,
    mosaic: Option<[usize; 4]>,
    key: (u64, u64),
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    let (height, width) = size(&planes)?;
    let count = if mosaic.is_some() { height } else { 3 * height };
    if pattern.iter().any(|p| p.shape() != [count, width]) {
        return Err(PyValueError::new_err("The fixed pattern must have one number a site."));
    }
    if mosaic.is_some_and(|colors| colors.iter().any(|&c| c > 2)) {
        return Err(PyValueError::new_err("Colours of a mosaic are 0, 1, 2."));
    }
    let source = planes.as_slice()?;
    let (factor, offset) = (pattern[0].as_slice()?, pattern[1].as_slice()?);
    let streams = [0, 1].map(|k| Stream::new(key.0, key.1.wrapping_mul(2).wrapping_add(k)));
    let mut out = vec![0.0; count * width];
    py.detach(|| {
        out.par_chunks_mut(width).enumerate().for_each(|(row, values)| {
            let colors = mosaic.map_or([row / height; 2], |c| [c[row % 2 * 2], c[row % 2 * 2 + 1]]);
            let line = |color: usize| &source[(color * height + row % height) * width..][..width];
            let sites = row * width..(row + 1) * width;
            let pattern = (&factor[sites.clone()], &offset[sites.clone()]);
            let light = [line(colors[0]), line(colors[1])];
            read_row(light, colors, pattern, &readout, streams, sites.start, values);
        });
    });
    let planes = if mosaic.is_some() { 1 } else { 3 };
    let array = Array3::from_shape_vec((planes, height, width), out).expect("all sites were read");
    Ok(array.into_dyn().into_pyarray(py))
}

/// Readings of one row, whose even and odd sites see two colours.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn read_row(
    light: [&[f32]; 2],
    colors: [usize; 2],
    pattern: (&[f32], &[f32]),
    readout: &Readout,
    streams: [Stream; 2],
    first: usize,
    out: &mut [f32],
) {
    let response = colors.map(|c| readout.response[c]);
    let step = readout.gain * (readout.white - readout.black) / readout.full_well;
    let back = response.map(|r| 1.0 / (r * (readout.white - readout.black)));
    for (chunk, values) in out.chunks_mut(CHUNK).enumerate() {
        let begin = chunk * CHUNK;
        let (mut mean, mut count) = ([0.0f32; CHUNK], [0.0f32; CHUNK]);
        let (mut uniform, mut noise) = ([0.5f32; CHUNK], [0.0f32; CHUNK]);
        for i in 0..values.len() {
            let x = begin + i;
            let color = x & 1;
            let value = if color == 0 { light[0][x] } else { light[1][x] };
            let most = 4.0 * readout.full_well; // far beyond what the converter can show
            let electrons = value * response[color] * readout.full_well * pattern.0[x];
            mean[i] = clamp(electrons, 0.0, most);
        }
        for i in 0..CHUNK {
            let site = (first + begin + i) as u32;
            uniform[i] = streams[0].uniform(site);
            count[i] = many(mean[i], quantile(uniform[i]));
            noise[i] = readout.read_noise * quantile(streams[1].uniform(site));
        }
        for (i, value) in values.iter_mut().enumerate() {
            if mean[i] < MANY {
                count[i] = few(mean[i], uniform[i]);
            }
            let x = begin + i;
            let number = (count[i] + pattern.1[x] + noise[i]) * step + readout.black;
            let number = clamp((number + 0.5).floor(), 0.0, readout.white);
            *value = (number - readout.black) * back[x & 1];
        }
    }
}
