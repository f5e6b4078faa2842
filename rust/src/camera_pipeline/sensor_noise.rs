//! Conversion of photons to digital values: shot noise, read noise, fixed pattern, quantization.
//!
//! Random numbers are hashes of (key, site) and depend on nothing else.

use super::planes::size;
use crate::pool::on_pool;
use crate::simd::f32x64::{clamp, exp2, load, log2, max, store};
use numpy::{
    IntoPyArray, PyArray2, PyArrayDyn, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
    ndarray::{Array2, Array3},
};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;
use std::f32::consts::PI;

/// Mean above which a Poisson variable is sampled as a normal one with its skewness; exactly below.
const MANY: f32 = 12.0;
/// Number of sites processed together.
const CHUNK: usize = 64;
/// Inverse of the number of 24-bit integers.
const EVEN: f32 = 1.0 / 16_777_216.0;

/// Bits that depend on all bits of a 32-bit integer (Wellons' `lowbias32`).
#[inline(always)]
fn scramble(x: u32) -> u32 {
    let x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
    let x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// A stream of random numbers, one per site.
#[derive(Clone, Copy)]
pub struct Stream {
    first: u32,
    second: u32,
}

impl Stream {
    /// Stream `index` of a key.
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
        ((self.bits(site) >> 9) as i32 as f32 + 0.5) * (1.0 / 8_388_608.0)
    }

    #[inline(always)]
    fn bits(self, site: u32) -> u32 {
        scramble(scramble(site.wrapping_add(self.first)) ^ self.second)
    }
}

/// The standard normal quantile of `u` in (0, 1) (Giles, GPU Computing Gems 2, 2012, single
/// precision).
#[inline(always)]
fn normal_quantile(u: f32) -> f32 {
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

/// Two independent standard normal numbers of one site (Box and Muller, Ann. Math. Stat. 29, 1958).
#[inline(always)]
fn normal_pair(stream: Stream, site: u32) -> [f32; 2] {
    let bits = stream.bits(site);
    let turn = scramble(bits.wrapping_add(0x9e37_79b9));
    let radius =
        (-2.0 * std::f32::consts::LN_2 * log2(((bits >> 8) as i32 as f32 + 0.5) * EVEN)).sqrt();
    // An angle from minus to plus a quarter turn; the sign selects the other half turn.
    let x = (turn >> 8) as i32 as f32 * EVEN - 0.5;
    let y = x * x;
    let sine = x * (PI - y * (5.167_713 - y * (2.550_164 - y * (0.599_264_5 - y * 0.082_145_89))));
    let cosine = 1.0
        - y * (4.934_802
            - y * (4.058_712 - y * (1.335_262_8 - y * (0.235_330_6 - y * 0.025_806_9))));
    [radius * sine, f32::from_bits((radius * cosine).to_bits() ^ (turn << 31))]
}

/// Poisson quantile of `u` for a small mean, by summation of probabilities.
fn poisson_small(mean: f32, u: f32) -> f32 {
    let mut probability = exp2(-mean * std::f32::consts::LOG2_E);
    let (mut sum, mut count) = (probability, 0.0f32);
    while u > sum && count < 64.0 {
        count += 1.0;
        probability *= mean / count;
        sum += probability;
    }
    count
}

/// Poisson quantile of a large mean from a standard normal number: the Cornish-Fisher expansion to
/// the skewness, rounded.
#[inline(always)]
fn poisson_large(mean: f32, z: f32) -> f32 {
    let count = mean + mean.sqrt() * z + (z * z - 1.0) / 6.0;
    max((count + 0.5).floor(), 0.0)
}

/// Standard normal numbers [h w] of a key's stream.
#[pyfunction]
pub fn standard_normal(
    py: Python<'_>,
    shape: (usize, usize),
    key: u64,
    stream: u64,
) -> Bound<'_, PyArray2<f32>> {
    let stream = Stream::new(key, stream);
    let values: Vec<f32> =
        (0..shape.0 * shape.1).map(|site| normal_quantile(stream.uniform(site as u32))).collect();
    Array2::from_shape_vec(shape, values).expect("every site was filled").into_pyarray(py)
}

/// Converter and fixed pattern of a sensor, as passed by Python.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct GivenSensor<'py> {
    full_well: f32,
    read_noise: f32,
    white: f32,
    black: f32,
    /// Response and offset of the sensor's sites.
    pub pattern: [PyReadonlyArray2<'py, f32>; 2],
}

/// Conversion of light to digital values.
#[derive(Clone, Copy, FromPyObject)]
#[pyo3(from_item_all)]
pub struct Readout {
    /// Electrons of a green site at the image value 1.
    pub full_well: f32,
    /// Standard deviation of the read noise [electrons].
    pub read_noise: f32,
    /// Light relative to that of the rendered image, and amplification before the converter.
    pub light: f32,
    pub gain: f32,
    /// Maximum value of the converter, and its black level.
    pub white: f32,
    pub black: f32,
    /// Response of red, green and blue sites.
    pub response: [f32; 3],
}

impl GivenSensor<'_> {
    /// Readout at the camera's own light, without gain.
    pub fn readout(&self) -> Readout {
        let GivenSensor { full_well, read_noise, white, black, .. } = *self;
        Readout { full_well, read_noise, white, black, ..Readout::ideal() }
    }
}

impl Readout {
    /// Readout of a sensor without read noise, with 16 bits.
    pub fn ideal() -> Self {
        Readout {
            full_well: 1e6,
            read_noise: 0.0,
            light: 1.0,
            gain: 1.0,
            white: 65535.0,
            black: 0.0,
            response: [1.0; 3],
        }
    }
}

/// The image as read by the sensor's converter, scaled back to image values.
///
/// Each site receives `value · light · response · full_well · pattern[0]` electrons on average;
/// their number is a Poisson variable. The site's offset `pattern[1]` and read noise [electrons]
/// are added; the reading is amplified, rounded to integers and clamped to the converter's range.
/// With a `mosaic`, the colors of 2 × 2 sites, there is one site per pixel and the result is [1 h
/// w]; otherwise there are three and it is [3 h w].
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
        return Err(PyValueError::new_err("The fixed pattern must have one value per photosite."));
    }
    if mosaic.is_some_and(|colors| colors.iter().any(|&c| c > 2)) {
        return Err(PyValueError::new_err("Colors of a mosaic are 0, 1, 2."));
    }
    let source = planes.as_slice()?;
    let sensor = Sensor {
        pattern: [pattern[0].as_slice()?, pattern[1].as_slice()?],
        readout: &readout,
        streams: streams(key),
    };
    let mut out = vec![0.0; count * width];
    on_pool(py, || {
        out.par_chunks_mut(width).enumerate().for_each(|(row, values)| {
            let colors = mosaic.map_or([row / height; 2], |c| [c[row % 2 * 2], c[row % 2 * 2 + 1]]);
            let line = |color: usize| &source[(color * height + row % height) * width..][..width];
            sensor.read([line(colors[0]), line(colors[1])], colors, row, values);
        });
    });
    let planes = if mosaic.is_some() { 1 } else { 3 };
    let array = Array3::from_shape_vec((planes, height, width), out).expect("all sites were read");
    Ok(array.into_dyn().into_pyarray(py))
}

/// Random numbers of a frame.
pub fn streams(key: (u64, u64)) -> [Stream; 2] {
    [0, 1].map(|k| Stream::new(key.0, key.1.wrapping_mul(2).wrapping_add(k)))
}

/// A sensor in one frame.
pub struct Sensor<'a> {
    /// Response of each site relative to the mean, and its offset [electrons].
    pub pattern: [&'a [f32]; 2],
    /// Conversion of light to digital values.
    pub readout: &'a Readout,
    /// Random numbers.
    pub streams: [Stream; 2],
}

impl Sensor<'_> {
    /// Reads a row of sites, whose even and odd ones have two colors.
    #[inline]
    pub fn read(&self, light: [&[f32]; 2], colors: [usize; 2], row: usize, out: &mut [f32]) {
        let sites = row * out.len()..(row + 1) * out.len();
        let pattern = (&self.pattern[0][sites.clone()], &self.pattern[1][sites.clone()]);
        read_row(light, colors, pattern, self.readout, self.streams, sites.start, out);
    }
}

/// Readings of one row, whose even and odd sites have two colors.
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
    let range = readout.white - readout.black;
    let step = readout.gain * range / readout.full_well;
    let (mut electrons, mut back) = ([0.0f32; CHUNK], [0.0f32; CHUNK]);
    for i in 0..CHUNK {
        let response = readout.response[colors[i & 1]];
        electrons[i] = response * readout.full_well * readout.light;
        back[i] = 1.0 / (response * range);
    }
    let most = 4.0 * readout.full_well; // far above the range of the converter
    let hides = readout.read_noise * readout.read_noise >= MANY;
    for begin in (0..out.len()).step_by(CHUNK) {
        let mut mean: [f32; CHUNK] = load(&light[0][begin..]);
        if colors[0] != colors[1] {
            let other: [f32; CHUNK] = load(&light[1][begin..]);
            for i in 0..CHUNK / 2 {
                mean[2 * i + 1] = other[2 * i + 1];
            }
        }
        let factor: [f32; CHUNK] = load(&pattern.0[begin..]);
        let offset: [f32; CHUNK] = load(&pattern.1[begin..]);
        for i in 0..CHUNK {
            mean[i] = clamp(mean[i] * electrons[i] * factor[i], 0.0, most);
        }
        let site = (first + begin) as u32;
        let mut read = if hides {
            read_joint(&mean, readout.read_noise, streams[0], site)
        } else {
            read_separate(&mean, readout.read_noise, streams, site)
        };
        for i in 0..CHUNK {
            let number = (read[i] + offset[i]) * step + readout.black;
            let number = clamp((number + 0.5).floor(), 0.0, readout.white);
            read[i] = (number - readout.black) * back[i];
        }
        store(&read, &mut out[begin..]);
    }
}

/// Samples numbers of electrons of the given means, and read noise separately.
#[inline(always)]
fn read_separate(
    mean: &[f32; CHUNK],
    read_noise: f32,
    streams: [Stream; 2],
    first: u32,
) -> [f32; CHUNK] {
    let (mut count, mut uniform, mut noise) = ([0.0f32; CHUNK], [0.5f32; CHUNK], [0.0f32; CHUNK]);
    for i in 0..CHUNK {
        let site = first + i as u32;
        uniform[i] = streams[0].uniform(site);
        count[i] = poisson_large(mean[i], normal_quantile(uniform[i]));
        noise[i] = read_noise * normal_quantile(streams[1].uniform(site));
    }
    for i in 0..CHUNK {
        noise[i] += if mean[i] < MANY { poisson_small(mean[i], uniform[i]) } else { count[i] };
    }
    noise
}

/// Samples both together where read noise hides the discreteness of electrons: one variable, whose
/// variance is the sum of theirs and whose third moment is that of the electrons.
#[inline(always)]
fn read_joint(mean: &[f32; CHUNK], read_noise: f32, stream: Stream, first: u32) -> [f32; CHUNK] {
    let mut normal = [0.0f32; CHUNK];
    for i in 0..CHUNK / 2 {
        [normal[i], normal[i + CHUNK / 2]] = normal_pair(stream, first + i as u32);
    }
    let mut read = [0.0f32; CHUNK];
    for i in 0..CHUNK {
        let (variance, z) = (mean[i] + read_noise * read_noise, normal[i]);
        read[i] = mean[i] + variance.sqrt() * z + (z * z - 1.0) * mean[i] / (6.0 * variance);
    }
    read
}
