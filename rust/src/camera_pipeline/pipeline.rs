//! Camera pipeline: all stages of one camera in a frame, in order, without returning to Python in
//! between.

use super::bloom::{Bloom, Scattered};
use super::demosaic::{demosaic_line, mirrored_about};
use super::depth_of_field::{Padded, bring_near};
use super::dome::{Drops, Smears, totals};
use super::isp::Isp;
use super::jpeg::Compression;
use super::motion_blur::{LitMask, SharpImage, extend_edges, inside, with_margin};
use super::motion_field::{MotionField, Shutter};
use super::optical_flow::Points;
use super::planes::{Line, Scaling, amplify, interleave, rows, shade_row};
use super::sensor_noise::{Readout, Sensor, streams};
use super::stages::{
    ColorGains, Distances, FrameParams, FrameStageParams, StageParams, of_image, size_mismatch,
};
use crate::pool::{install, on_pool};
use crate::render::channels::STEP;
use crate::render::lumen::foreground::FOREGROUND_BUBBLE;
use crate::render::ray_table::RayTable;
use crate::simd::f32x64::Vec3;
use numpy::{
    IntoPyArray, PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyReadwriteArray3,
    PyUntypedArrayMethods, ndarray::Array3,
};
use pyo3::{prelude::*, types::PyDict};
use rayon::prelude::*;
use std::sync::Mutex;

/// Lens, sensor and image signal processor of one camera.
#[pyclass(frozen, module = "vrcaps._core")]
pub struct CameraPipeline {
    rays: Py<RayTable>,
    size: (usize, usize),
    lit: Vec<bool>,
    cosine: Vec<f32>,
    shutter: Option<(Shutter, LitMask)>,
    depth_of_field: Option<(f32, f32)>,
    smears: Option<Smears>,
    scaling: Option<Scaling>,
    vignetting: Option<Vec<f32>>,
    bloom: Option<Bloom>,
    sensor: Option<SensorOfCamera>,
    bayer_filter: Option<[usize; 4]>,
    colors: ColorGains,
    isp: Isp,
    jpeg: Option<Compression>,
    /// Buffers of earlier frames, for reuse. No thread waits for the lock: a forked process may
    /// inherit a copy that is locked forever.
    buffers: Mutex<Vec<Buffers>>,
}

/// Readout of a sensor, and the response and offset of its sites.
struct SensorOfCamera {
    readout: Readout,
    pattern: [Vec<f32>; 2],
}

/// Planes of one frame.
struct Buffers {
    padded: Option<Padded>,
    planes: Vec<f32>,
    spare: Vec<f32>,
    codes: Vec<u8>,
}

/// Arrays of a frame, as far as stages use them.
struct Frame<'a> {
    exposure: f32,
    points: Option<Points<'a>>,
    /// Sign of their motion in time.
    sense: f32,
    /// Distance of the wall, depth and label of the foreground.
    distances: Option<Distances<'a>>,
    drops: Option<Drops<'a>>,
    sensor: Option<Sensor<'a>>,
    gains: [f32; 3],
}

#[pymethods]
impl CameraPipeline {
    /// Takes the rays of a camera, the mask of pixels inside the lens's field [h w], the cosine
    /// between each pixel's ray and the axis [h w], and the parameters of stages by name.
    #[new]
    fn new(
        rays: Py<RayTable>,
        lit: PyReadonlyArray2<'_, bool>,
        cosine: PyReadonlyArray2<'_, f32>,
        stages: Bound<'_, PyDict>,
    ) -> PyResult<Self> {
        let [height, width] = lit.shape()[..] else { return Err(size_mismatch()) };
        let (size, given) = ((height, width), StageParams::of(&stages)?);
        if height * width == 0 {
            return Err(size_mismatch());
        }
        let bayer = given.bayer_filter;
        if bayer.is_some_and(|b| height < 3 || width < 3 || b.iter().any(|&c| c > 2)) {
            return Err(size_mismatch());
        }
        let lit = of_image(&lit, size)?.to_vec();
        let isp = Isp::new(&given, size, &lit);
        let mask = |times| (Shutter::of(times), install(|| LitMask::new(size, &lit)));
        let shutter = given.shutter().map(mask);
        let sites = (if bayer.is_some() { height } else { 3 * height }, width);
        Ok(CameraPipeline {
            size,
            rays,
            lit,
            cosine: of_image(&cosine, size)?.to_vec(),
            shutter,
            depth_of_field: given.depth_of_field,
            smears: given.smears.as_ref().map(|smears| Smears::of(smears, size)).transpose()?,
            scaling: given.chromatic_aberration.map(|(center, s)| Scaling::new(size, center, s)),
            vignetting: match &given.vignetting {
                Some(map) => Some(of_image(map, size)?.to_vec()),
                None => None,
            },
            bloom: given.bloom.map(|(fraction, sigma)| Bloom { fraction, sigma }),
            sensor: SensorOfCamera::of(&given, sites)?,
            bayer_filter: bayer,
            colors: given.white_balance.unwrap_or(([1.0; 3], [1.0; 3])),
            isp,
            jpeg: given.jpeg.map(|(quality, max_bytes)| Compression { quality, max_bytes }),
            buffers: Mutex::new(Vec::new()),
        })
    }

    /// Shape of radiance with the margin around the image that motion needs, equally wide on all
    /// sides or wider on the right.
    #[getter]
    fn planes_shape(&self) -> (usize, usize, usize) {
        let (rows, columns) = with_margin(self.size);
        (3, rows, columns)
    }

    /// The camera's 8-bit image [h w 3] of radiance, whose margin is filled; 0 outside the lens's
    /// field.
    fn apply<'py>(
        &self,
        py: Python<'py>,
        mut radiance: PyReadwriteArray3<'py, f32>,
        frame: FrameParams<'py>,
    ) -> PyResult<Bound<'py, PyArray3<u8>>> {
        self.check(radiance.shape())?;
        let stages = FrameStageParams::of(&frame.stages)?;
        if self.depth_of_field.is_some() && stages.depth_of_field.is_none() {
            return Err(size_mismatch());
        }
        let own = self.sensor.as_ref();
        let (readout, gains) = stages.readout(own.map(|sensor| sensor.readout), self.colors);
        let sensor = own.zip(readout.as_ref()).map(|(sensor, readout)| Sensor {
            pattern: [&sensor.pattern[0], &sensor.pattern[1]],
            readout,
            streams: streams(frame.key),
        });
        let points = |given| Points::of(self.rays.get(), given, STEP);
        let frame = Frame {
            exposure: frame.exposure,
            points: frame.points.as_ref().map(points).transpose()?,
            sense: if frame.is_backward { -1.0 } else { 1.0 },
            distances: stages.distances(self.size)?,
            drops: match &stages.droplets {
                Some(drops) => Some(Drops::of(drops, self.lit.len())?),
                None => None,
            },
            sensor,
            gains,
        };
        let light = radiance.as_slice_mut()?;
        let out = on_pool(py, || self.process(light, &frame));
        let (height, width) = self.size;
        let image = Array3::from_shape_vec((height, width, 3), out).expect("every pixel is filled");
        Ok(image.into_pyarray(py))
    }

    /// Mean luminance of radiance with a margin, given its factors, over a subset of the lit
    /// pixels; values are clamped at 1. Motion and contamination of the dome are ignored.
    fn meter(&self, radiance: PyReadonlyArray3<'_, f32>, factors: [f32; 3]) -> PyResult<f64> {
        self.check(radiance.shape())?;
        let (light, (height, width)) = (radiance.as_slice()?, self.size);
        let (mut sum, mut count) = (0.0, 0);
        for y in (STEP.min(height / 2)..height).step_by(2 * STEP) {
            let colors = [0, 1, 2].map(|k| self.row(light, k, y));
            let shutter = self.shutter.as_ref();
            let weight = shutter.map_or(1.0, |(times, _)| times.window(y as f32, height).weight);
            for x in (STEP / 2..width).step_by(STEP) {
                let pixel = y * width + x;
                if self.lit[pixel] {
                    let [r, g, b] = [0, 1, 2].map(|k| factors[k] * colors[k][x]);
                    let shade = weight * self.vignetting.as_ref().map_or(1.0, |map| map[pixel]);
                    sum += f64::from(((r + g + b) * shade).min(1.0));
                    count += 1;
                }
            }
        }
        Ok(sum / f64::from(count.max(1)))
    }
}

impl Frame<'_> {
    /// Motion of an image of `height` rows during their exposure.
    fn motion(&self, shutter: Shutter, height: usize) -> MotionField {
        let Some(points) = &self.points else { return MotionField::new(&[0.0; 2], (1, 1)) };
        let mut vectors = points.flow();
        vectors.iter_mut().for_each(|x| *x *= self.sense);
        MotionField::new(&vectors, points.size()).at_readout(shutter, height)
    }
}

impl SensorOfCamera {
    /// Sensor of a camera with the given rows and columns of sites; `None` if it has no effect.
    /// Without noise, one step of its digital values is 1/65535.
    fn of(given: &StageParams<'_>, (rows, columns): (usize, usize)) -> PyResult<Option<Self>> {
        let Some(noise) = &given.sensor_noise else {
            let pattern = [vec![1.0; rows * columns], vec![0.0; rows * columns]];
            let ideal = || SensorOfCamera { readout: Readout::ideal(), pattern };
            return Ok(given.bayer_filter.map(|_| ideal()));
        };
        let [response, offset] = noise.pattern.each_ref().map(|p| of_image(p, (rows, columns)));
        let pattern = [response?.to_vec(), offset?.to_vec()];
        Ok(Some(SensorOfCamera { readout: noise.readout(), pattern }))
    }
}

impl CameraPipeline {
    fn check(&self, radiance: &[usize]) -> PyResult<()> {
        let (colors, rows, columns) = self.planes_shape();
        if radiance == [colors, rows, columns] { Ok(()) } else { Err(size_mismatch()) }
    }

    /// A row of one color of radiance.
    fn row<'a>(&self, light: &'a [f32], color: usize, y: usize) -> &'a [f32] {
        &light[color * (light.len() / 3)..][inside(y, self.size)]
    }

    fn process(&self, light: &mut [f32], frame: &Frame<'_>) -> Vec<u8> {
        let kept = self.buffers.try_lock().ok().and_then(|mut buffers| buffers.pop());
        let mut buffers = kept.unwrap_or_else(|| self.new_buffers());
        let mut out = vec![0; 3 * self.lit.len()];
        let totals = self.expose(light, frame, &mut buffers);
        self.apply_dome(frame, &totals, &mut buffers.planes);
        self.apply_chromatic_aberration_and_vignetting(&mut buffers);
        let scattered = self.bloom.map(|bloom| bloom.scattered(&buffers.planes, self.size));
        self.read_sensor(frame, scattered.as_ref(), &mut buffers);
        let codes = &buffers.codes;
        match &self.jpeg {
            Some(jpeg) => jpeg.apply(codes, self.size, &mut out),
            None => {
                let (width, area) = (self.size.1, self.lit.len());
                out.par_chunks_mut(3 * width).enumerate().for_each(|(y, row)| {
                    let line = |k: usize| &codes[k * area + y * width..][..width];
                    interleave([line(0), line(1), line(2)], row);
                });
            }
        }
        if let Ok(mut kept) = self.buffers.try_lock() {
            kept.push(buffers);
        }
        out
    }

    fn new_buffers(&self) -> Buffers {
        let area = self.lit.len();
        Buffers {
            padded: self.depth_of_field.map(|_| Padded::new(self.size)),
            planes: vec![0.0; 3 * area],
            spare: vec![0.0; 3 * area],
            codes: vec![0; 3 * area],
        }
    }

    /// Applies motion blur, rolling shutter and depth of field; returns the light of each row.
    fn expose(&self, light: &mut [f32], frame: &Frame<'_>, buffers: &mut Buffers) -> Vec<Vec3> {
        let (size, Buffers { padded, planes, .. }) = (self.size, buffers);
        let moving = self.shutter.as_ref().map(|(shutter, lit)| {
            let find = || frame.motion(*shutter, size.0);
            let ((), motion) = rayon::join(|| extend_edges(light, size), find);
            (motion, *shutter, lit)
        });
        let light = &*light;
        let moving = moving.map(|(motion, shutter, lit)| {
            (SharpImage::new(light, lit, frame.exposure), motion, shutter)
        });
        let exposed = |y: usize, line: Line<'_>| match &moving {
            Some((sharp, motion, shutter)) => sharp.blur(y, motion, *shutter, line),
            None => {
                for (k, row) in line.into_iter().enumerate() {
                    amplify(self.row(light, k, y), frame.exposure, row);
                }
            }
        };
        let mut sums = vec![[0.0; 3]; size.0];
        if let Some((padded, lens)) = padded.as_mut().zip(self.depth_of_field) {
            padded.fill(lens, exposed, |y, row| self.distances(frame, y, row));
            padded.spread(rows(planes, size), &mut sums);
        } else {
            let lines = rows(planes, size).into_par_iter().zip(&mut sums).enumerate();
            lines.for_each(|(y, (mut line, sum))| {
                exposed(y, line.each_mut().map(|row| &mut **row));
                *sum = totals(&line);
            });
        }
        sums
    }

    /// Distance along the ray to the bubble or otherwise the wall in the pixels of a row [m].
    fn distances(&self, frame: &Frame<'_>, y: usize, row: &mut [f32]) {
        let Some((wall, depth, front)) = frame.distances else { return };
        let pixels = y * row.len()..(y + 1) * row.len();
        row.copy_from_slice(&wall[pixels.clone()]);
        let front = &front[pixels.clone()];
        if !front.contains(&FOREGROUND_BUBBLE) {
            return;
        }
        bring_near(row, front, (&depth[pixels.clone()], &self.cosine[pixels]));
    }

    /// Applies droplets and smears, given the light of each row before them.
    fn apply_dome(&self, frame: &Frame<'_>, totals: &[Vec3], planes: &mut [f32]) {
        let (height, width) = self.size;
        if let Some(drops) = &frame.drops {
            drops.refract(planes);
        }
        let Some(smears) = &self.smears else { return };
        let veils = smears.veils(totals);
        planes.par_chunks_mut(width).enumerate().for_each(|(row, values)| {
            smears.cover(values, (row / height, row % height), veils[row / height]);
        });
    }

    /// Applies lateral chromatic aberration and vignetting.
    fn apply_chromatic_aberration_and_vignetting(&self, buffers: &mut Buffers) {
        let width = self.size.1;
        let shaded = |y: usize, row: &mut [f32]| {
            if let Some(map) = &self.vignetting {
                shade_row(row, &map[y * width..][..width]);
            }
        };
        if let Some(scaling) = &self.scaling {
            let Buffers { planes, spare, .. } = buffers;
            let lines = rows(spare, self.size).into_par_iter().enumerate();
            lines.for_each_init(Vec::new, |mixed, (y, mut line)| {
                scaling.row(planes, self.size, y, mixed, &mut line);
                line.into_iter().for_each(|row| shaded(y, row));
            });
            std::mem::swap(planes, spare);
        } else if self.vignetting.is_some() {
            rows(&mut buffers.planes, self.size).into_par_iter().enumerate().for_each(
                |(y, line)| {
                    line.into_iter().for_each(|row| shaded(y, row));
                },
            );
        }
    }

    /// Applies bloom, sensor and image signal processor up to 8 bits.
    fn read_sensor(&self, frame: &Frame<'_>, scattered: Option<&Scattered>, buffers: &mut Buffers) {
        let (size, Buffers { planes, spare, codes, .. }) = (self.size, buffers);
        let (height, width) = size;
        let lines = rows(planes, size).into_par_iter().enumerate();
        let mosaic = frame.sensor.as_ref().zip(self.bayer_filter);
        if let Some((sensor, colors)) = mosaic {
            lines.zip(spare.par_chunks_mut(width)).for_each(|((y, mut line), read)| {
                if let Some(scattered) = scattered {
                    scattered.mix_into(y, &mut line);
                }
                let [first, second] = [0, 1].map(|k| colors[y % 2 * 2 + k]);
                sensor.read([&*line[first], &*line[second]], [first, second], y, read);
            });
            let padded = mirrored_about(&spare[..height * width], size);
            let lines = rows(planes, size).into_par_iter().zip(rows(codes, size)).enumerate();
            lines.for_each(|(y, (mut line, mut codes))| {
                demosaic_line(&padded, y, colors, &mut line);
                self.isp.develop(&mut line, frame.gains, self.lit_row(y), &mut codes);
            });
        } else {
            lines.zip(rows(codes, size)).for_each_init(
                || vec![0.0; width],
                |read, ((y, mut line), mut codes)| {
                    if let Some(scattered) = scattered {
                        scattered.mix_into(y, &mut line);
                    }
                    if let Some(sensor) = &frame.sensor {
                        for (k, row) in line.iter_mut().enumerate() {
                            sensor.read([&**row; 2], [k; 2], k * height + y, read);
                            row.copy_from_slice(read);
                        }
                    }
                    self.isp.develop(&mut line, frame.gains, self.lit_row(y), &mut codes);
                },
            );
        }
        self.isp.filter(planes, spare, &self.lit, (codes, size));
    }

    fn lit_row(&self, y: usize) -> &[bool] {
        &self.lit[y * self.size.1..][..self.size.1]
    }
}
