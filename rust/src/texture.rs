//! Wall textures: base colour, roughness and the slope of the relief, with mip levels.

use crate::lanes::*;
use numpy::{PyReadonlyArray2, PyReadonlyArray3};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// One texel, packed: square roots of the linear base colour in 11, 11 and 10 bits; roughness in 8
/// bits and the two slopes in 12 bits each.
///
/// Square roots spread the steps as the eye does, and cost one multiplication to undo.
#[derive(Clone, Copy, Default)]
pub struct Texel(pub u32, pub u32);

/// A texel in numbers.
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

/// Textures over texture coordinates; row 0 is v = 1, and u and v wrap.
#[pyclass(frozen, module = "vrcaps._core")]
pub struct Texture {
    levels: Vec<Level>,
    /// Relief slope of one step of the packed numbers, along u and v [m per unit of u or v].
    slope_step: [f32; 2],
}

/// What a tile's rays find in the texture.
pub struct Texels {
    /// Linear base colour.
    pub albedo: Lane3,
    /// Perceptual roughness.
    pub roughness: Lane,
    /// Slope of the relief along u and v [m per unit of u or v].
    pub slope: [Lane; 2],
}

const SLOPE_STEPS: f32 = 2047.0;
const ALBEDO_STEPS: Vec3 = [2047.0, 2047.0, 1023.0];

impl Sample {
    fn pack(self, slope_step: [f32; 2]) -> Texel {
        let [r, g, b] = [0, 1, 2]
            .map(|k| (clamp(self.albedo[k], 0.0, 1.0).sqrt() * ALBEDO_STEPS[k]).round() as u32);
        let [su, sv] = [0, 1].map(|k| {
            let steps = (self.slope[k] / slope_step[k]).round();
            (clamp(steps, -SLOPE_STEPS, SLOPE_STEPS) + 2048.0) as u32
        });
        let roughness = (clamp(self.roughness, 0.0, 1.0) * 255.0).round() as u32;
        Texel(r | g << 11 | b << 22, roughness | su << 8 | sv << 20)
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

/// Linear value of an 8-bit sRGB number (IEC 61966-2-1).
fn linear(value: u8) -> f32 {
    let x = f32::from(value) / 255.0;
    if x <= 0.04045 { x / 12.92 } else { pow((x + 0.055) / 1.055, 2.4) }
}

#[pymethods]
impl Texture {
    /// Packs albedo [h w 3] (sRGB), roughness [h w] and height [h w] in metres.
    #[new]
    fn new(
        py: Python<'_>,
        albedo: PyReadonlyArray3<'_, u8>,
        roughness: PyReadonlyArray2<'_, u8>,
        height: PyReadonlyArray2<'_, f32>,
    ) -> PyResult<Self> {
        let (albedo, roughness, height) =
            (albedo.as_array(), roughness.as_array(), height.as_array());
        let (h, w, components) = albedo.dim();
        if components != 3 || h * w == 0 || roughness.dim() != (h, w) || height.dim() != (h, w) {
            return Err(PyValueError::new_err(
                "Albedo must be of shape (h, w, 3), roughness and height of shape (h, w).",
            ));
        }
        if !height.iter().all(|x| x.is_finite()) {
            return Err(PyValueError::new_err("Texture heights must be finite numbers."));
        }
        let table: Vec<f32> = (0..=255).map(linear).collect();
        let sample = |y: usize, x: usize| {
            let across = height[[y, (x + 1) % w]] - height[[y, (x + w - 1) % w]];
            let along = height[[(y + h - 1) % h, x]] - height[[(y + 1) % h, x]];
            Sample {
                albedo: [0, 1, 2].map(|k| table[albedo[[y, x, k]] as usize]),
                roughness: f32::from(roughness[[y, x]]) / 255.0,
                slope: [across * 0.5 * w as f32, along * 0.5 * h as f32],
            }
        };
        Ok(py.detach(|| {
            let samples: Vec<Sample> =
                (0..h * w).into_par_iter().map(|i| sample(i / w, i % w)).collect();
            Texture::from_samples(samples, w, h)
        }))
    }
}

impl Texture {
    fn from_samples(mut samples: Vec<Sample>, mut width: usize, mut height: usize) -> Self {
        let largest = |k: usize| samples.iter().fold(1e-12f32, |m, s| max(m, s.slope[k].abs()));
        let slope_step = [largest(0) / SLOPE_STEPS, largest(1) / SLOPE_STEPS];
        let mut levels = Vec::new();
        loop {
            let texels = samples.par_iter().map(|s| s.pack(slope_step)).collect();
            levels.push(Level { width, height, texels });
            if width == 1 && height == 1 {
                return Texture { levels, slope_step };
            }
            (samples, width, height) = halve(&samples, width, height);
        }
    }

    /// Texels of every lane: bilinear in the level whose texels are nearest the pixel's footprint.
    ///
    /// `footprint` is the share of the texture's width and height that a pixel covers.
    #[inline(always)]
    pub fn fetch(&self, uv: &[Lane; 2], footprint: &[Lane; 2]) -> Texels {
        let mut corners = [[Texel::default(); LANES]; 4];
        let mut weights = [[0.0; LANES]; 2];
        for i in 0..LANES {
            let level = self.level(footprint[0][i], footprint[1][i]);
            let (x, x0, x1) = neighbours(uv[0][i], level.width);
            let (y, y0, y1) = neighbours(1.0 - uv[1][i], level.height);
            let (row0, row1) = (y0 * level.width, y1 * level.width);
            corners[0][i] = level.texels[row0 + x0];
            corners[1][i] = level.texels[row0 + x1];
            corners[2][i] = level.texels[row1 + x0];
            corners[3][i] = level.texels[row1 + x1];
            weights[0][i] = x;
            weights[1][i] = y;
        }
        self.blend(&corners, &weights)
    }

    #[inline(always)]
    fn level(&self, across: f32, along: f32) -> &Level {
        let first = &self.levels[0];
        let texels = max(across * first.width as f32, along * first.height as f32);
        // The exponent of √2·x is log₂ x rounded to the nearest whole number.
        let nearest =
            ((max(texels, 1.0) * std::f32::consts::SQRT_2).to_bits() >> 23) as usize - 127;
        &self.levels[nearest.min(self.levels.len() - 1)]
    }

    #[inline(always)]
    fn blend(&self, corners: &[[Texel; LANES]; 4], weights: &[Lane; 2]) -> Texels {
        let mut out =
            Texels { albedo: [[0.0; LANES]; 3], roughness: [0.0; LANES], slope: [[0.0; LANES]; 2] };
        for (c, texels) in corners.iter().enumerate() {
            for i in 0..LANES {
                let (x, y) = (weights[0][i], weights[1][i]);
                let w =
                    (if c & 1 == 0 { 1.0 - x } else { x }) * if c & 2 == 0 { 1.0 - y } else { y };
                let Texel(color, rest) = texels[i];
                let r = (color & 0x7ff) as i32 as f32 * (1.0 / 2047.0);
                let g = (color >> 11 & 0x7ff) as i32 as f32 * (1.0 / 2047.0);
                let b = (color >> 22) as i32 as f32 * (1.0 / 1023.0);
                out.albedo[0][i] += w * (r * r);
                out.albedo[1][i] += w * (g * g);
                out.albedo[2][i] += w * (b * b);
                out.roughness[i] += w * ((rest & 0xff) as i32 as f32 * (1.0 / 255.0));
                out.slope[0][i] +=
                    w * (((rest >> 8 & 0xfff) as i32 - 2048) as f32 * self.slope_step[0]);
                out.slope[1][i] += w * (((rest >> 20) as i32 - 2048) as f32 * self.slope_step[1]);
            }
        }
        out
    }
}

/// Weight of the second neighbour, and both neighbours, of a wrapped coordinate 0 to 1.
#[inline(always)]
fn neighbours(coordinate: f32, size: usize) -> (f32, usize, usize) {
    let wrapped = coordinate - coordinate.floor();
    let place = wrapped * size as f32 + 0.5;
    let second = (place as usize).min(size);
    let first = if second == 0 { size - 1 } else { second - 1 };
    (place - second as f32, first, if second == size { 0 } else { second })
}

fn halve(samples: &[Sample], width: usize, height: usize) -> (Vec<Sample>, usize, usize) {
    let (w, h) = ((width / 2).max(1), (height / 2).max(1));
    let sample = |i: usize| {
        let (x, y) = (i % w * 2, i / w * 2);
        let (x1, y1) = ((x + 1).min(width - 1), (y + 1).min(height - 1));
        Sample::mean([(x, y), (x1, y), (x, y1), (x1, y1)].map(|(x, y)| samples[y * width + x]))
    };
    ((0..w * h).into_par_iter().map(sample).collect(), w, h)
}
