//! All stages of one camera in a frame, in their order, without a way back to Python between them.

use super::bayer::{demosaic_line, mirrored_about};
use super::bloom::{Bloom, Scattered};
use super::defocus::{Padded, bring_near};
use super::dome::{Drops, Film, totals};
use super::field::{Field, Shutter};
use super::flow::Points;
use super::given::{Distances, Given, Shot, misfit, of_image};
use super::jpeg::Compression;
use super::motion::{Lit, Still, go_on, inside, with_margin};
use super::noise::{Sensor, streams};
use super::planes::{Line, Scaling, amplify, develop_row, interleave, rows, shade_row};
use crate::cpu::on_pool;
use crate::lumen::foreground::FRONT_BUBBLE;
use crate::render::channels::STEP;
use crate::render::ray_table::RayTable;
use crate::simd::f32x64::Vec3;
use numpy::{
    IntoPyArray, PyArray3, PyReadonlyArray3, PyReadwriteArray3, PyUntypedArrayMethods,
    ndarray::Array3,
};
use pyo3::prelude::*;
use rayon::prelude::*;
use std::sync::Mutex;

/// Lens and sensor of one camera.
#[pyclass(frozen, module = "vrcaps._core")]
pub struct CameraStages {
    rays: Py<RayTable>,
    size: (usize, usize),
    lit: Vec<bool>,
    cosine: Vec<f32>,
    shutter: Option<(Shutter, Lit)>,
    defocus: Option<(f32, f32)>,
    film: Option<Film>,
    scaling: Option<Scaling>,
    shade: Option<Vec<f32>>,
    bloom: Option<Bloom>,
    pattern: [Vec<f32>; 2],
    mosaic: Option<[usize; 4]>,
    jpeg: Option<Compression>,
    /// Planes of earlier frames, whose memory is used again.
    rooms: Mutex<Vec<Room>>,
}

/// Planes of one frame.
struct Room {
    padded: Option<Padded>,
    planes: Vec<f32>,
    spare: Vec<f32>,
    codes: Vec<u8>,
}

/// A frame's arrays, as far as stages use them.
struct Frame<'a> {
    factor: f32,
    points: Option<Points<'a>>,
    /// Sense of their motion in time.
    sense: f32,
    /// Distance of the wall, depth and label of what is in front.
    distance: Option<Distances<'a>>,
    drops: Option<Drops<'a>>,
    sensor: Option<Sensor<'a>>,
    gains: [f32; 3],
}

#[pymethods]
impl CameraStages {
    /// Takes what stays as it is.
    #[new]
    fn new(given: Given<'_>) -> PyResult<Self> {
        let [height, width] = given.lit.shape()[..] else { return Err(misfit()) };
        let size = (height, width);
        let sites = if given.mosaic.is_some() { height } else { 3 * height };
        if height * width == 0 || given.pattern.iter().any(|p| p.shape() != [sites, width]) {
            return Err(misfit());
        }
        if given.mosaic.is_some_and(|m| height < 3 || width < 3 || m.iter().any(|&c| c > 2)) {
            return Err(misfit());
        }
        let [response, offset] =
            given.pattern.each_ref().map(|p| p.as_slice().map(<[f32]>::to_vec));
        let lit = of_image(&given.lit, size)?.to_vec();
        let shutter = given.shutter.map(|times| (Shutter::of(times), Lit::new(size, &lit)));
        Ok(CameraStages {
            size,
            rays: given.rays,
            lit,
            cosine: of_image(&given.cosine, size)?.to_vec(),
            shutter,
            defocus: given.defocus,
            film: given.film.as_ref().map(|film| Film::of(film, size)).transpose()?,
            scaling: given.scales.map(|(center, scales)| Scaling::new(size, center, scales)),
            shade: match &given.shade {
                Some(shade) => Some(of_image(shade, size)?.to_vec()),
                None => None,
            },
            bloom: given.bloom.map(|(share, sigma)| Bloom { share, sigma }),
            pattern: [response?, offset?],
            mosaic: given.mosaic,
            jpeg: given.jpeg.map(|(quality, most_bytes)| Compression { quality, most_bytes }),
            rooms: Mutex::new(Vec::new()),
        })
    }

    /// Shape of radiance with the margin about the image that motion needs, as wide on all sides or
    /// wider on the right.
    #[getter]
    fn room(&self) -> (usize, usize, usize) {
        let (rows, columns) = with_margin(self.size);
        (3, rows, columns)
    }

    /// The 8-bit image [h w 3] that the camera makes of radiance, whose margin is filled; it is 0
    /// where the camera sees nothing.
    fn apply<'py>(
        &self,
        py: Python<'py>,
        mut radiance: PyReadwriteArray3<'py, f32>,
        shot: Shot<'py>,
    ) -> PyResult<Bound<'py, PyArray3<u8>>> {
        self.check(radiance.shape())?;
        if self.defocus.is_some() && shot.distance.is_none() {
            return Err(misfit());
        }
        let sensor = |readout| Sensor {
            pattern: [&self.pattern[0], &self.pattern[1]],
            readout,
            streams: streams(shot.key),
        };
        let points = |given| Points::of(self.rays.get(), given, STEP);
        let frame = Frame {
            factor: shot.factor,
            points: shot.points.as_ref().map(points).transpose()?,
            sense: if shot.is_backward { -1.0 } else { 1.0 },
            distance: shot.distance(self.size)?,
            drops: match &shot.drops {
                Some(drops) => Some(Drops::of(drops, self.lit.len())?),
                None => None,
            },
            sensor: shot.readout.as_ref().map(sensor),
            gains: shot.gains,
        };
        let light = radiance.as_slice_mut()?;
        let out = on_pool(py, || self.take(light, &frame));
        let (height, width) = self.size;
        let image = Array3::from_shape_vec((height, width, 3), out).expect("every pixel is filled");
        Ok(image.into_pyarray(py))
    }

    /// Mean of the luminance of radiance with a margin, given its factors, over every few lit
    /// pixels of every few rows; each is cut at 1. As if nothing moved nor lay on the dome.
    fn meter(&self, radiance: PyReadonlyArray3<'_, f32>, factors: [f32; 3]) -> PyResult<f64> {
        self.check(radiance.shape())?;
        let (light, (height, width)) = (radiance.as_slice()?, self.size);
        let (mut sum, mut count) = (0.0, 0);
        for y in (STEP.min(height / 2)..height).step_by(2 * STEP) {
            let colors = [0, 1, 2].map(|k| self.row(light, k, y));
            let shutter = self.shutter.as_ref();
            let share = shutter.map_or(1.0, |(times, _)| times.window(y as f32, height).share);
            for x in (STEP / 2..width).step_by(STEP) {
                let pixel = y * width + x;
                if self.lit[pixel] {
                    let [r, g, b] = [0, 1, 2].map(|k| factors[k] * colors[k][x]);
                    let shade = share * self.shade.as_ref().map_or(1.0, |shade| shade[pixel]);
                    sum += f64::from(((r + g + b) * shade).min(1.0));
                    count += 1;
                }
            }
        }
        Ok(sum / f64::from(count.max(1)))
    }
}

impl Frame<'_> {
    /// Motion of the image of so many rows, as they take light.
    fn motion(&self, shutter: Shutter, height: usize) -> Field {
        let Some(points) = &self.points else { return Field::new(&[0.0; 2], (1, 1)) };
        let mut vectors = points.flow();
        vectors.iter_mut().for_each(|x| *x *= self.sense);
        Field::new(&vectors, points.size()).when_read(shutter, height)
    }
}

impl CameraStages {
    fn check(&self, radiance: &[usize]) -> PyResult<()> {
        let (colors, rows, columns) = self.room();
        if radiance == [colors, rows, columns] { Ok(()) } else { Err(misfit()) }
    }

    /// A row of one colour of radiance.
    fn row<'a>(&self, light: &'a [f32], color: usize, y: usize) -> &'a [f32] {
        &light[color * (light.len() / 3)..][inside(y, self.size)]
    }

    fn take(&self, light: &mut [f32], frame: &Frame<'_>) -> Vec<u8> {
        let kept = self.rooms.lock().ok().and_then(|mut rooms| rooms.pop());
        let mut room = kept.unwrap_or_else(|| self.new_room());
        let mut out = vec![0; 3 * self.lit.len()];
        let totals = self.expose(light, frame, &mut room);
        self.look_through_dome(frame, &totals, &mut room.planes);
        self.part_colors(&mut room);
        let scattered = self.bloom.map(|bloom| bloom.scattered(&room.planes, self.size));
        self.read(frame, scattered.as_ref(), &mut room);
        let codes = &room.codes;
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
        if let Ok(mut rooms) = self.rooms.lock() {
            rooms.push(room);
        }
        out
    }

    fn new_room(&self) -> Room {
        let area = self.lit.len();
        Room {
            padded: self.defocus.map(|_| Padded::new(self.size)),
            planes: vec![0.0; 3 * area],
            spare: vec![0.0; 3 * area],
            codes: vec![0; 3 * area],
        }
    }

    /// Motion blur, rolling shutter, depth of field; the light of each row.
    fn expose(&self, light: &mut [f32], frame: &Frame<'_>, room: &mut Room) -> Vec<Vec3> {
        let (size, Room { padded, planes, .. }) = (self.size, room);
        let moving = self.shutter.as_ref().map(|(shutter, lit)| {
            let find = || frame.motion(*shutter, size.0);
            let ((), motion) = rayon::join(|| go_on(light, size), find);
            (motion, *shutter, lit)
        });
        let light = &*light;
        let moving = moving
            .map(|(motion, shutter, lit)| (Still::new(light, lit, frame.factor), motion, shutter));
        let exposed = |y: usize, line: Line<'_>| match &moving {
            Some((still, motion, shutter)) => still.blur(y, motion, *shutter, line),
            None => {
                for (k, row) in line.into_iter().enumerate() {
                    amplify(self.row(light, k, y), frame.factor, row);
                }
            }
        };
        let mut sums = vec![[0.0; 3]; size.0];
        if let Some((padded, lens)) = padded.as_mut().zip(self.defocus) {
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

    /// Distance along the ray of the bubble or else the wall that the pixels of a row see [m].
    fn distances(&self, frame: &Frame<'_>, y: usize, row: &mut [f32]) {
        let Some((wall, depth, front)) = frame.distance else { return };
        let pixels = y * row.len()..(y + 1) * row.len();
        row.copy_from_slice(&wall[pixels.clone()]);
        let front = &front[pixels.clone()];
        if !front.contains(&FRONT_BUBBLE) {
            return;
        }
        bring_near(row, front, (&depth[pixels.clone()], &self.cosine[pixels]));
    }

    /// Droplets and smears, given the light of each row before them.
    fn look_through_dome(&self, frame: &Frame<'_>, totals: &[Vec3], planes: &mut [f32]) {
        let (height, width) = self.size;
        if let Some(drops) = &frame.drops {
            drops.refract(planes);
        }
        let Some(film) = &self.film else { return };
        let veils = film.veils(totals);
        planes.par_chunks_mut(width).enumerate().for_each(|(row, values)| {
            film.cover(values, (row / height, row % height), veils[row / height]);
        });
    }

    /// Lateral colour and vignette.
    fn part_colors(&self, room: &mut Room) {
        let width = self.size.1;
        let shaded = |y: usize, row: &mut [f32]| {
            if let Some(shade) = &self.shade {
                shade_row(row, &shade[y * width..][..width]);
            }
        };
        if let Some(scaling) = &self.scaling {
            let Room { planes, spare, .. } = room;
            let lines = rows(spare, self.size).into_par_iter().enumerate();
            lines.for_each_init(Vec::new, |mixed, (y, mut line)| {
                scaling.row(planes, self.size, y, mixed, &mut line);
                line.into_iter().for_each(|row| shaded(y, row));
            });
            std::mem::swap(planes, spare);
        } else if self.shade.is_some() {
            rows(&mut room.planes, self.size).into_par_iter().enumerate().for_each(|(y, line)| {
                line.into_iter().for_each(|row| shaded(y, row));
            });
        }
    }

    /// Bloom, sensor, white balance and 8 bits.
    fn read(&self, frame: &Frame<'_>, scattered: Option<&Scattered>, room: &mut Room) {
        let ((height, width), size) = (self.size, self.size);
        let Room { planes, spare, codes, .. } = room;
        let lit = |y: usize| &self.lit[y * width..][..width];
        let lines = rows(planes, size).into_par_iter().enumerate();
        let mosaic = frame.sensor.as_ref().zip(self.mosaic);
        let Some((sensor, colors)) = mosaic else {
            lines.zip(rows(codes, size)).for_each_init(
                || vec![0.0; width],
                |read, ((y, mut line), codes)| {
                    if let Some(scattered) = scattered {
                        scattered.mix_into(y, &mut line);
                    }
                    for (k, codes) in codes.into_iter().enumerate() {
                        let mut values = &*line[k];
                        if let Some(sensor) = &frame.sensor {
                            sensor.read([values; 2], [k; 2], k * height + y, read);
                            values = read;
                        }
                        develop_row(values, frame.gains[k], lit(y), codes);
                    }
                },
            );
            return;
        };
        lines.zip(spare.par_chunks_mut(width)).for_each(|((y, mut line), read)| {
            if let Some(scattered) = scattered {
                scattered.mix_into(y, &mut line);
            }
            let [first, second] = [0, 1].map(|k| colors[y % 2 * 2 + k]);
            sensor.read([&*line[first], &*line[second]], [first, second], y, read);
        });
        let padded = mirrored_about(&spare[..height * width], size);
        let lines = rows(planes, size).into_par_iter().zip(rows(codes, size)).enumerate();
        lines.for_each(|(y, (mut line, codes))| {
            demosaic_line(&padded, y, colors, &mut line);
            for (k, codes) in codes.into_iter().enumerate() {
                develop_row(line[k], frame.gains[k], lit(y), codes);
            }
        });
    }
}
