//! Wall textures: base color, roughness and the slope of the relief, with mip levels.

use crate::pool::detached;
use crate::simd::f32x64::*;
use numpy::{PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// One packed texel: square roots of the linear base color in 11, 11 and 10 bits; roughness in 8
/// bits and the two slopes in 12 bits each.
///
/// Square roots distribute the steps like visual perception, and one multiplication inverts them.
#[derive(Clone, Copy, Default)]
pub struct Texel(pub u32, pub u32);

/// An unpacked texel.
#[derive(Clone, Copy, Default)]
struct Sample {
    albedo: Vec3,
    roughness: f32,
    slope: [f32; 2],
}

struct Level {
    width: usize,
    height: usize,
    texels: Vec<Texel>,
}

impl Level {
    /// Mean over 2 × 2 texels; None above a single texel.
    fn halved(&self, slope_step: [f32; 2]) -> Option<Level> {
        if self.texels.len() == 1 {
            return None;
        }
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let mut texels = vec![Texel::default(); width * height];
        texels.par_chunks_exact_mut(width).enumerate().for_each(|(y, out)| {
            let row = |y: usize| &self.texels[y.min(self.height - 1) * self.width..][..self.width];
            let (upper, lower) = (row(2 * y), row(2 * y + 1));
            for (x, texel) in out.iter_mut().enumerate() {
                let (x0, x1) = (2 * x, (2 * x + 1).min(self.width - 1));
                let four = [upper[x0], upper[x1], lower[x0], lower[x1]];
                *texel = Sample::mean(four.map(|t| Sample::unpack(t, slope_step))).pack(slope_step);
            }
        });
        Some(Level { width, height, texels })
    }
}

/// Textures over texture coordinates; row 0 is v = 1, and u and v wrap.
#[pyclass(frozen, module = "vrcaps._core")]
pub struct Texture {
    levels: Vec<Level>,
    /// Relief slope of one step of the packed values, along u and v [m per unit of u or v].
    slope_step: [f32; 2],
}

/// Texture values of a tile's rays.
pub struct Texels {
    /// Linear base color.
    pub albedo: Lane3,
    /// Perceptual roughness.
    pub roughness: Lane,
    /// Slope of the relief along u and v [m per unit of u or v].
    pub slope: [Lane; 2],
}

const SLOPE_STEPS: f32 = 2047.0;
const ALBEDO_STEPS: Vec3 = [2047.0, 2047.0, 1023.0];

impl Sample {
    #[inline(always)]
    fn pack(self, slope_step: [f32; 2]) -> Texel {
        let [r, g, b] = [0, 1, 2].map(|k| color_bits(self.albedo[k], k));
        let roughness = nearest(clamp(self.roughness, 0.0, 1.0) * 255.0);
        let [su, sv] = [0, 1].map(|k| slope_bits(self.slope[k] / slope_step[k]));
        Texel(r | g | b, roughness | su << 8 | sv << 20)
    }

    #[inline(always)]
    fn unpack(Texel(color, rest): Texel, slope_step: [f32; 2]) -> Self {
        let root = |bits: u32, steps: f32| bits as i32 as f32 * (1.0 / steps);
        let roots = [
            root(color & 0x7ff, ALBEDO_STEPS[0]),
            root(color >> 11 & 0x7ff, ALBEDO_STEPS[1]),
            root(color >> 22, ALBEDO_STEPS[2]),
        ];
        let slope = |bits: u32, step: f32| (bits as i32 - 2048) as f32 * step;
        Sample {
            albedo: roots.map(|x| x * x),
            roughness: root(rest & 0xff, 255.0),
            slope: [slope(rest >> 8 & 0xfff, slope_step[0]), slope(rest >> 20, slope_step[1])],
        }
    }

    fn mean(samples: [Sample; 4]) -> Sample {
        let mut sum = Sample::default();
        for sample in samples {
            sum.albedo = add(sum.albedo, scale(sample.albedo, 0.25));
            sum.roughness += 0.25 * sample.roughness;
            for k in 0..2 {
                sum.slope[k] += 0.25 * sample.slope[k];
            }
        }
        sum
    }
}

/// Nearest integer of 0 to 2²²; adding 2²³ leaves it in the low bits.
#[inline(always)]
fn nearest(x: f32) -> u32 {
    (x + 8_388_608.0).to_bits() & 0x7f_ffff
}

/// A linear value of channel `k`, encoded and shifted to its bits in a texel.
#[inline(always)]
fn color_bits(linear: f32, k: usize) -> u32 {
    nearest(clamp(linear, 0.0, 1.0).sqrt() * ALBEDO_STEPS[k]) << (11 * k)
}

/// A slope in steps, encoded for a texel.
#[inline(always)]
fn slope_bits(steps: f32) -> u32 {
    nearest(clamp(steps, -SLOPE_STEPS, SLOPE_STEPS) + 2048.0)
}

/// Images of equal size, row by row, from which texels are packed.
struct Images<'a> {
    width: usize,
    height: usize,
    albedo: &'a [u8],
    roughness: &'a [u8],
    relief: &'a [f32],
}

impl Images<'_> {
    /// Calls `texel(x, slopes)` along row `y`, with the slopes along u and v by central differences
    /// that wrap [m per unit of u and v].
    #[inline(always)]
    fn slopes(&self, y: usize, mut texel: impl FnMut(usize, [f32; 2])) {
        let (w, h) = (self.width, self.height);
        let row = |y: usize| &self.relief[y % h * w..][..w];
        let (own, above, below) = (row(y), row(y + h - 1), row(y + 1));
        let (per_u, per_v) = (w as f32, h as f32);
        let mut at = |x: usize, left: f32, right: f32| {
            texel(x, [(right - left) * 0.5 * per_u, (above[x] - below[x]) * 0.5 * per_v]);
        };
        at(0, own[w - 1], own[1 % w]);
        for x in 1..w - 1 {
            at(x, own[x - 1], own[x + 1]);
        }
        if w > 1 {
            at(w - 1, own[w - 2], own[0]);
        }
    }

    /// Maximum slopes along u and v.
    fn steepest(&self) -> [f32; 2] {
        let of_row = |y| {
            let mut most = [1e-12f32; 2];
            self.slopes(y, |_, s| most = [0, 1].map(|k| max(most[k], s[k].abs())));
            most
        };
        let rows = (0..self.height).into_par_iter().map(of_row);
        rows.reduce(|| [1e-12; 2], |a, b| [max(a[0], b[0]), max(a[1], b[1])])
    }

    fn pack(&self, slope_step: [f32; 2]) -> Vec<Texel> {
        let table = [0, 1, 2].map(|k| {
            let bits = |value: usize| color_bits(linear(value as u8), k);
            std::array::from_fn::<u32, 256, _>(bits)
        });
        let per_step = slope_step.map(|step| 1.0 / step);
        let mut texels = vec![Texel::default(); self.width * self.height];
        texels.par_chunks_exact_mut(self.width).enumerate().for_each(|(y, out)| {
            let start = y * self.width;
            let roughness = &self.roughness[start..][..self.width];
            let (albedo, _) = self.albedo[3 * start..][..3 * self.width].as_chunks::<3>();
            self.slopes(y, |x, slope| {
                let [su, sv] = [0, 1].map(|k| slope_bits(slope[k] * per_step[k]));
                let [r, g, b] = [0, 1, 2].map(|k| table[k][usize::from(albedo[x][k])]);
                out[x] = Texel(r | g | b, u32::from(roughness[x]) | su << 8 | sv << 20);
            });
        });
        texels
    }
}

/// Linear value of an 8-bit sRGB value (IEC 61966-2-1).
fn linear(value: u8) -> f32 {
    let x = f32::from(value) / 255.0;
    if x <= 0.04045 { x / 12.92 } else { pow((x + 0.055) / 1.055, 2.4) }
}

#[pymethods]
impl Texture {
    /// Packs albedo [h w 3] (sRGB), roughness [h w] and height [h w] in meters, all C-contiguous.
    #[new]
    fn new(
        py: Python<'_>,
        albedo: PyReadonlyArray3<'_, u8>,
        roughness: PyReadonlyArray2<'_, u8>,
        height: PyReadonlyArray2<'_, f32>,
    ) -> PyResult<Self> {
        let (h, w) = (height.shape()[0], height.shape()[1]);
        if albedo.shape() != [h, w, 3] || roughness.shape() != [h, w] || h * w == 0 {
            return Err(PyValueError::new_err(
                "Albedo must be of shape (h, w, 3), roughness and height of shape (h, w).",
            ));
        }
        let images = Images {
            width: w,
            height: h,
            albedo: albedo.as_slice()?,
            roughness: roughness.as_slice()?,
            relief: height.as_slice()?,
        };
        let texture = detached(py, || {
            let is_finite = |row: &[f32]| row.iter().all(|x| x.is_finite());
            images.relief.par_chunks(w).all(is_finite).then(|| {
                let step = images.steepest().map(|s| s / SLOPE_STEPS);
                Texture::with_mips(Level { width: w, height: h, texels: images.pack(step) }, step)
            })
        });
        texture.ok_or_else(|| PyValueError::new_err("Texture heights must be finite numbers."))
    }
}

impl Texture {
    /// Adds the levels above the finest, each half the size of the previous one.
    fn with_mips(finest: Level, slope_step: [f32; 2]) -> Self {
        let mut levels = vec![finest];
        while let Some(coarser) = levels.last().and_then(|level| level.halved(slope_step)) {
            levels.push(coarser);
        }
        Texture { levels, slope_step }
    }

    /// Texels of every lane: bilinear in the level whose texels match the pixel's footprint best.
    ///
    /// `footprint` is the fraction of the texture's width and height that a pixel covers; `streak` is
    /// a factor on the width of the texels, at least 1.
    #[inline(always)]
    pub fn fetch(&self, uv: &[Lane; 2], footprint: &[Lane; 2], streak: &Lane) -> Texels {
        let numbers = self.level_numbers(footprint, streak);
        let (mut colors, mut rests) = ([[0u32; LANES]; 4], [[0u32; LANES]; 4]);
        let mut weights = [[0.0; LANES]; 2];
        for i in 0..LANES {
            let level = &self.levels[numbers[i] as usize];
            let (x, x0, x1) = neighbors(uv[0][i], level.width);
            let (y, y0, y1) = neighbors(1.0 - uv[1][i], level.height);
            let (row0, row1) = (y0 * level.width, y1 * level.width);
            for (c, place) in [row0 + x0, row0 + x1, row1 + x0, row1 + x1].into_iter().enumerate() {
                let Texel(color, rest) = level.texels[place];
                colors[c][i] = color;
                rests[c][i] = rest;
            }
            weights[0][i] = x;
            weights[1][i] = y;
        }
        self.blend(&colors, &rests, &weights)
    }

    #[inline(always)]
    fn level_numbers(&self, footprint: &[Lane; 2], streak: &Lane) -> [u32; LANES] {
        let (width, height) = (self.levels[0].width as f32, self.levels[0].height as f32);
        let last = self.levels.len() as u32 - 1;
        let mut numbers = [0u32; LANES];
        for i in 0..LANES {
            let texels = max(max(footprint[0][i] * width, footprint[1][i] * height), 1.0);
            let texels = texels * streak[i];
            // The exponent of √2·x is log₂ x rounded to the nearest integer.
            let nearest = ((texels * std::f32::consts::SQRT_2).to_bits() >> 23) - 127;
            numbers[i] = if nearest < last { nearest } else { last };
        }
        numbers
    }

    #[inline(always)]
    fn blend(
        &self,
        colors: &[[u32; LANES]; 4],
        rests: &[[u32; LANES]; 4],
        weights: &[Lane; 2],
    ) -> Texels {
        let mut out =
            Texels { albedo: [[0.0; LANES]; 3], roughness: [0.0; LANES], slope: [[0.0; LANES]; 2] };
        for c in 0..4 {
            for i in 0..LANES {
                let (x, y) = (weights[0][i], weights[1][i]);
                let w =
                    (if c & 1 == 0 { 1.0 - x } else { x }) * if c & 2 == 0 { 1.0 - y } else { y };
                let sample = Sample::unpack(Texel(colors[c][i], rests[c][i]), self.slope_step);
                for k in 0..3 {
                    out.albedo[k][i] += w * sample.albedo[k];
                }
                out.roughness[i] += w * sample.roughness;
                for k in 0..2 {
                    out.slope[k][i] += w * sample.slope[k];
                }
            }
        }
        out
    }
}

/// Weight of the second neighbor, and both neighbors, of a wrapped coordinate 0 to 1.
#[inline(always)]
fn neighbors(coordinate: f32, size: usize) -> (f32, usize, usize) {
    let wrapped = coordinate - coordinate.floor();
    let place = wrapped * size as f32 + 0.5;
    let second = (place as usize).min(size);
    let first = if second == 0 { size - 1 } else { second - 1 };
    (place - second as f32, first, if second == size { 0 } else { second })
}
