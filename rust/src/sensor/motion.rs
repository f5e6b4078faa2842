//! Motion while the shutter is open, and rows that are read one after another.

use super::planes::{planes_array, rows, size_of_image};
use crate::cpu::on_pool;
use crate::lanes::{clamp, max, min};
use numpy::{PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;
use std::cell::Cell;

/// Most places a pixel is averaged over.
const MOST_SAMPLES: f32 = 64.0;
/// Shift that is not worth interpolating [px].
const STILL: f32 = 1e-3;

/// Most steps in which the place that a late row sees is found, and the change of its motion at
/// which it is [px per frame].
const FIXED_POINT_STEPS: usize = 4;
const SETTLED: f32 = 1e-2;

/// A field of motion at some pixels [px per frame], with no place unknown.
struct Motion {
    vectors: Vec<[f32; 2]>,
    size: (usize, usize),
    /// Pixels from one to the next; the first is in the middle of a square of so many.
    step: usize,
}

impl Motion {
    /// Fills unknown places (NaN) next to known ones with their mean, up to three cells away;
    /// elsewhere nothing moves.
    fn new(given: &[f32], size: (usize, usize), step: usize) -> Self {
        let (height, width) = size;
        let mut vectors: Vec<[f32; 2]> = given.chunks_exact(2).map(|v| [v[0], v[1]]).collect();
        let known = |v: &[f32; 2]| v[0].is_finite() && v[1].is_finite();
        for _ in 0..3 {
            let before = vectors.clone();
            for (k, vector) in vectors.iter_mut().enumerate().filter(|(_, v)| !known(v)) {
                let (y, x) = (k / width, k % width);
                let (mut sum, mut count) = ([0.0f32; 2], 0.0f32);
                for row in y.saturating_sub(1)..(y + 2).min(height) {
                    for near in &before[row * width..][x.saturating_sub(1)..(x + 2).min(width)] {
                        if known(near) {
                            sum = [sum[0] + near[0], sum[1] + near[1]];
                            count += 1.0;
                        }
                    }
                }
                if count > 0.0 {
                    *vector = [sum[0] / count, sum[1] / count];
                }
            }
        }
        for vector in &mut vectors {
            if !known(vector) {
                *vector = [0.0; 2];
            }
        }
        Motion { vectors, size, step }
    }

    /// Of each place the motion of what is there when its row is read, `readout` after the first of
    /// `height` rows at the last: with v of an instant, `from + v(from) late = here`.
    fn when_read(self, readout: f32, height: usize) -> Self {
        if readout == 0.0 {
            return self;
        }
        let place = |number: usize| (number * self.step + self.step / 2) as f32;
        let read = |k: usize| {
            let (x, y) = (place(k % self.size.1), place(k / self.size.1));
            let late = lateness(readout, y, height);
            let mut v = self.vectors[k];
            for _ in 0..FIXED_POINT_STEPS {
                let before = v;
                v = self.at(x - v[0] * late, y - v[1] * late);
                if max((v[0] - before[0]).abs(), (v[1] - before[1]).abs()) < SETTLED {
                    break;
                }
            }
            v
        };
        let all = (0..self.vectors.len()).into_par_iter().with_min_len(512);
        Motion { vectors: all.map(read).collect(), ..self }
    }

    /// The vector at a place of the image [px].
    fn at(&self, x: f32, y: f32) -> [f32; 2] {
        let (rows, columns) = self.size;
        let (row, t) = self.between(y, rows);
        let (column, s) = self.between(x, columns);
        let right = (column + 1).min(columns - 1);
        let line = |r: usize| {
            let line = &self.vectors[r * columns..(r + 1) * columns];
            mix(&line[column], &line[right], s)
        };
        mix(&line(row), &line((row + 1).min(rows - 1)), t)
    }

    /// The vectors of all pixels of one row: columns, then rows.
    fn row(&self, y: usize, width: usize) -> [Vec<f32>; 2] {
        let (rows, columns) = self.size;
        let (first, t) = self.between(y as f32, rows);
        let line = |r: usize| &self.vectors[r * columns..(r + 1) * columns];
        let (above, below) = (line(first), line((first + 1).min(rows - 1)));
        [0, 1].map(|k| {
            let known = |c: usize| above[c][k] + (below[c][k] - above[c][k]) * t;
            let mut last = known(0);
            let mut all = Vec::with_capacity(width + self.step);
            all.resize(self.step / 2, last);
            for column in 1..columns {
                let next = known(column);
                let slope = (next - last) / self.step as f32;
                all.extend((0..self.step).map(|i| last + slope * i as f32));
                last = next;
            }
            all.resize(all.len().max(width), last);
            all
        })
    }

    /// The number of the known place before a place [px], and how far it is towards the next.
    #[inline(always)]
    fn between(&self, place: f32, count: usize) -> (usize, f32) {
        let number = (place - (self.step / 2) as f32) / self.step as f32;
        whole(clamp(number, 0.0, count as f32 - 1.0))
    }
}

/// How late a row is, after the row in the middle.
fn lateness(readout: f32, row: f32, height: usize) -> f32 {
    readout * ((row + 0.5) / height as f32 - 0.5)
}

#[inline(always)]
fn mix(a: &[f32; 2], b: &[f32; 2], t: f32) -> [f32; 2] {
    [a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t]
}

/// Planes [3 h w] of the image [h w 3], times a factor, as a camera takes it that moves while it
/// exposes.
///
/// A pixel is the mean over the time its row is open of what moves past it. `motion` is an array
/// [rows columns 2] and a number n: the motion of the image in one frame's time [px] at every nth
/// pixel of every nth row, the first in the middle of a square of so many. `open` is the time a row is
/// open, and that from the first row's middle of exposure to the last one's, as shares of a frame's
/// time; the row in the middle has its exposure about the instant of the image. What is not `lit`
/// stays black and is mixed into nothing.
#[pyfunction]
pub fn blur_motion<'py>(
    py: Python<'py>,
    image: PyReadonlyArray3<'py, f32>,
    lit: PyReadonlyArray2<'py, bool>,
    motion: (PyReadonlyArray3<'py, f32>, usize),
    open: (f32, f32),
    factor: f32,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let (height, width) = size_of_image(&image)?;
    let [rows_known, columns, 2] = motion.0.shape()[..] else {
        return Err(PyValueError::new_err("Motion must be of shape (rows, columns, 2)."));
    };
    if lit.shape() != [height, width] || rows_known * columns == 0 || motion.1 == 0 {
        return Err(PyValueError::new_err("Motion and lit must fit the image."));
    }
    let (source, lit) = (image.as_slice()?, lit.as_slice()?);
    let ((vectors, step), (shutter, readout)) = ((motion.0.as_slice()?, motion.1), open);
    let mut out = vec![0.0; source.len()];
    on_pool(py, || {
        let motion = Motion::new(vectors, (rows_known, columns), step).when_read(readout, height);
        let mut still = ROOM.take().of_size((height, width));
        still.fill(source, lit, factor);
        rows(&mut out, (height, width)).into_par_iter().enumerate().for_each(|(y, row)| {
            let late = lateness(readout, y as f32, height);
            blur_row(&still, y, &motion.row(y, width), (shutter, late), row);
        });
        ROOM.set(still);
    });
    Ok(planes_array(py, out, (height, width)))
}

/// Pixels worked on together.
const RUN: usize = 16;
/// Columns beside the image that may be looked at, and rows below it; they are black.
const MARGIN: usize = 2 * RUN;
/// Most neighbours to a side that the places of a run are taken from together.
const MOST_TAPS: usize = 4;

type Run = [f32; RUN];

thread_local! {
    /// Image of an earlier call, whose memory is used again.
    static ROOM: Cell<Still> = Cell::new(Still::default());
}

/// The image at its instant: red, green, blue, and 1 where it is lit; all 0 elsewhere.
#[derive(Default)]
struct Still {
    planes: [Vec<f32>; 4],
    size: (usize, usize),
    stride: usize,
}

impl Still {
    /// Room for an image of a size, with its margin.
    fn of_size(self, size: (usize, usize)) -> Self {
        if self.size == size {
            return self;
        }
        let stride = size.1.div_ceil(RUN) * RUN + 2 * MARGIN;
        let planes = [0; 4].map(|_| vec![0.0; stride * (size.0.div_ceil(RUN) * RUN + MARGIN)]);
        Still { planes, size, stride }
    }

    fn fill(&mut self, image: &[f32], lit: &[bool], factor: f32) {
        let (width, stride) = (self.size.1, self.stride);
        let [red, green, blue, share] = &mut self.planes;
        let rows = red.par_chunks_mut(stride).zip(green.par_chunks_mut(stride));
        let rows = rows.zip(blue.par_chunks_mut(stride)).zip(share.par_chunks_mut(stride));
        rows.take(self.size.0).enumerate().for_each(|(y, (((red, green), blue), share))| {
            let [red, green, blue, share] =
                [red, green, blue, share].map(|row| &mut row[MARGIN..MARGIN + width]);
            let (colors, lit) = (&image[y * width * 3..][..width * 3], &lit[y * width..][..width]);
            for (x, color) in colors.chunks_exact(3).enumerate() {
                let seen = f32::from(u8::from(lit[x]));
                let factor = factor * seen;
                (red[x], green[x], blue[x]) =
                    (color[0] * factor, color[1] * factor, color[2] * factor);
                share[x] = seen;
            }
        });
    }

    /// Numbers of a plane from a place on.
    #[inline(always)]
    fn run(&self, plane: usize, row: usize, column: isize) -> Run {
        let mut values = [0.0; RUN];
        let start = row * self.stride + MARGIN.wrapping_add_signed(column);
        values.copy_from_slice(&self.planes[plane][start..start + RUN]);
        values
    }

    /// Bilinear between four pixels; the image goes on as at its edge.
    #[inline(always)]
    fn at(&self, x: f32, y: f32) -> [f32; 4] {
        let (height, width) = self.size;
        let (x0, s) = whole(clamp(x, 0.0, width as f32 - 1.0));
        let (y0, t) = whole(clamp(y, 0.0, height as f32 - 1.0));
        let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
        [0, 1, 2, 3].map(|plane| {
            let value = |y: usize, x: usize| self.planes[plane][y * self.stride + MARGIN + x];
            let top = value(y0, x0) + (value(y0, x1) - value(y0, x0)) * s;
            let bottom = value(y1, x0) + (value(y1, x1) - value(y1, x0)) * s;
            top + (bottom - top) * t
        })
    }

    /// Whether a run that starts at a place lies within the image when it has moved so far.
    fn holds(&self, (x, y): (usize, usize), along: [f32; 2], down: [f32; 2]) -> bool {
        let (x, y) = (x as f32, y as f32);
        x + along[0] >= 0.0
            && x + along[1] + RUN as f32 <= self.size.1 as f32
            && y + down[0] >= 0.0
            && y + down[1] <= self.size.0 as f32 - 1.0
    }
}

/// A number from 0 to 2²² as a whole one and the rest, 0 to 1.
#[inline(always)]
fn whole(x: f32) -> (usize, f32) {
    // Adding 1.5 · 2²³ rounds to a whole number and leaves it in the low bits.
    let shifted = (x - 0.5) + 12_582_912.0;
    ((shifted.to_bits() & 0x003f_ffff) as usize, x - (shifted - 12_582_912.0))
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn blur_row(
    still: &Still,
    y: usize,
    motion: &[Vec<f32>; 2],
    (shutter, late): (f32, f32),
    out: [&mut [f32]; 3],
) {
    let width = still.size.1;
    for x in (0..width).step_by(RUN) {
        let mut own = [[0.0; RUN]; 4];
        for plane in 0..4 {
            own[plane] = still.run(plane, y, x as isize);
        }
        let mut near = [[0.0; RUN]; 2];
        for k in 0..2 {
            // Beyond the row its last vector goes on.
            for i in 0..RUN {
                near[k][i] = motion[k][(x + i).min(width - 1)];
            }
        }
        let speed = near.as_flattened().iter().fold(0.0, |most, v: &f32| max(v.abs(), most));
        let mut mean = own;
        if speed * (late.abs() + 0.5 * shutter) >= STILL {
            let count = clamp((speed * shutter).ceil(), 1.0, MOST_SAMPLES);
            let sum = streak(still, (x, y), &near, (shutter, late), count);
            for i in 0..RUN {
                let known = if sum[3][i] > 0.0 { own[3][i] } else { 0.0 };
                let share = known / max(sum[3][i], 1e-30);
                let rest = own[3][i] - known;
                for k in 0..3 {
                    mean[k][i] = sum[k][i] * share + own[k][i] * rest;
                }
            }
        }
        let count = (width - x).min(RUN);
        for k in 0..3 {
            out[k][x..x + count].copy_from_slice(&mean[k][..count]);
        }
    }
}

/// Sum over the exposure of what moves past a run of pixels.
#[inline(always)]
fn streak(
    still: &Still,
    (x, y): (usize, usize),
    motion: &[Run; 2],
    (shutter, late): (f32, f32),
    count: f32,
) -> [Run; 4] {
    let ends = motion.map(|v| {
        v.iter().fold([f32::MAX, f32::MIN], |ends, &v| [min(v, ends[0]), max(v, ends[1])])
    });
    let step = shutter / count;
    let mut time = late - 0.5 * (shutter - step);
    let mut sum = [[0.0f32; RUN]; 4];
    for _ in 0..count as u32 {
        let [along, down] = ends.map(|[low, high]| {
            let far = [-low * time, -high * time];
            [min(far[0], far[1]), max(far[0], far[1])]
        });
        let first = [along[0].floor(), down[0].floor()];
        let taps = [along[1].ceil() - first[0], down[1].ceil() - first[1]];
        if still.holds((x, y), along, down) && max(taps[0], taps[1]) < MOST_TAPS as f32 {
            let start = (y.wrapping_add_signed(first[1] as isize), x as isize + first[0] as isize);
            let mut rest = [[0.0; RUN]; 2];
            for k in 0..2 {
                for i in 0..RUN {
                    rest[k][i] = -motion[k][i] * time - first[k];
                }
            }
            add_shifted(still, start, taps.map(|count| count as usize), &rest, &mut sum);
        } else {
            for i in 0..RUN {
                let place = [(x + i) as f32 - motion[0][i] * time, y as f32 - motion[1][i] * time];
                let value = still.at(place[0], place[1]);
                for k in 0..4 {
                    sum[k][i] += value[k];
                }
            }
        }
        time += step;
    }
    sum
}

/// Adds what is seen from a place (row, column) on, each pixel `rest` farther: bilinear, where
/// neighbours are up to `taps` away.
#[inline(always)]
fn add_shifted(
    still: &Still,
    start: (usize, isize),
    taps: [usize; 2],
    rest: &[Run; 2],
    sum: &mut [Run; 4],
) {
    for row in 0..=taps[1] {
        for column in 0..=taps[0] {
            let place = (start.0 + row, start.1 + column as isize);
            let mut share = [0.0f32; RUN];
            for i in 0..RUN {
                let across = max(1.0 - (rest[0][i] - column as f32).abs(), 0.0);
                share[i] = across * max(1.0 - (rest[1][i] - row as f32).abs(), 0.0);
            }
            for plane in 0..4 {
                let values = still.run(plane, place.0, place.1);
                for i in 0..RUN {
                    sum[plane][i] += share[i] * values[i];
                }
            }
        }
    }
}
