//! Motion while the shutter is open, and rows that are read one after another.

use super::planes::size_of_image;
use crate::lanes::{clamp, max};
use glam::Vec4;
use numpy::{
    IntoPyArray, PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
    ndarray::Array3,
};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;
use std::cell::Cell;

/// Most places a pixel is averaged over.
const MOST_SAMPLES: f32 = 64.0;
/// Shift that is not worth interpolating [px].
const STILL: f32 = 1e-3;

/// Steps in which the place that a late row sees is found.
const FIXED_POINT_STEPS: usize = 4;

/// A field of motion on a coarse grid [px per frame], with no place unknown.
struct Motion {
    vectors: Vec<[f32; 2]>,
    size: (usize, usize),
    /// Cells to a pixel of the image.
    scale: f32,
}

impl Motion {
    /// Fills unknown places (NaN) next to known ones with their mean, up to three cells away;
    /// elsewhere nothing moves.
    fn new(given: &[f32], size: (usize, usize), cell: f32) -> Self {
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
        Motion { vectors, size, scale: 1.0 / cell }
    }

    /// Of each cell the motion of what is there when its row is read, `readout` after the first of
    /// `height` rows at the last: with v of an instant, `from + v(from) late = here`.
    fn when_read(self, readout: f32, height: usize) -> Self {
        if readout == 0.0 {
            return self;
        }
        let columns = self.size.1;
        let vectors = (0..self.vectors.len())
            .map(|k| {
                let middle = |cell: usize| (cell as f32 + 0.5) / self.scale - 0.5;
                let (x, y) = (middle(k % columns), middle(k / columns));
                let late = lateness(readout, y, height);
                let mut v = self.vectors[k];
                for _ in 0..FIXED_POINT_STEPS {
                    v = self.at(x - v[0] * late, y - v[1] * late);
                }
                v
            })
            .collect();
        Motion { vectors, ..self }
    }

    /// The vector at a place of the image [px].
    fn at(&self, x: f32, y: f32) -> [f32; 2] {
        let (rows, columns) = self.size;
        let (row, t) = between(y, self.scale, rows);
        let (column, s) = between(x, self.scale, columns);
        let right = (column + 1).min(columns - 1);
        let line = |r: usize| {
            let line = &self.vectors[r * columns..(r + 1) * columns];
            mix(&line[column], &line[right], s)
        };
        mix(&line(row), &line((row + 1).min(rows - 1)), t)
    }

    /// The vectors of one row of the image's height, still coarse along it.
    fn row(&self, y: usize) -> Vec<[f32; 2]> {
        let (rows, columns) = self.size;
        let (first, t) = between(y as f32, self.scale, rows);
        let line = |r: usize| &self.vectors[r * columns..(r + 1) * columns];
        line(first).iter().zip(line((first + 1).min(rows - 1))).map(|(a, b)| mix(a, b, t)).collect()
    }
}

/// How late a row is, after the row in the middle.
fn lateness(readout: f32, row: f32, height: usize) -> f32 {
    readout * ((row + 0.5) / height as f32 - 0.5)
}

/// The cell whose middle is before a place [px], and how far the place is towards the next.
#[inline(always)]
fn between(place: f32, scale: f32, cells: usize) -> (usize, f32) {
    whole(clamp((place + 0.5) * scale - 0.5, 0.0, cells as f32 - 1.0))
}

#[inline(always)]
fn mix(a: &[f32; 2], b: &[f32; 2], t: f32) -> [f32; 2] {
    [a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t]
}

/// The image [h w 3] as a camera takes it that moves while it exposes.
///
/// A pixel is the mean over the time its row is open of what moves past it. `motion` [rows columns 2]
/// is the motion of the image in one frame's time [px], one for each square of `cell` pixels; `shutter` is the time a row is open
/// and `readout` that from the first row's middle of exposure to the last one's, as shares of a
/// frame's time; the row in the middle has its exposure about the instant of the image. What is not
/// `lit` stays black and is mixed into nothing.
#[pyfunction]
pub fn blur_motion<'py>(
    py: Python<'py>,
    image: PyReadonlyArray3<'py, f32>,
    lit: PyReadonlyArray2<'py, bool>,
    motion: PyReadonlyArray3<'py, f32>,
    cell: f32,
    shutter: f32,
    readout: f32,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let (height, width) = size_of_image(&image)?;
    let [rows, columns, 2] = motion.shape()[..] else {
        return Err(PyValueError::new_err("Motion must be of shape (rows, columns, 2)."));
    };
    if lit.shape() != [height, width] || rows * columns == 0 {
        return Err(PyValueError::new_err("Motion and lit must fit the image."));
    }
    let (source, lit) = (image.as_slice()?, lit.as_slice()?);
    let motion = Motion::new(motion.as_slice()?, (rows, columns), cell).when_read(readout, height);
    let mut out = vec![0.0; source.len()];
    py.detach(|| {
        let still = Still::new(source, lit, (height, width));
        out.par_chunks_mut(width * 3).enumerate().for_each(|(y, row)| {
            let late = lateness(readout, y as f32, height);
            blur_row(&still, y, &motion, (shutter, late), row);
        });
        ROOM.set(still.pixels);
    });
    let shape = (height, width, 3);
    Ok(Array3::from_shape_vec(shape, out).expect("every pixel was filled").into_pyarray(py))
}

thread_local! {
    /// Pixels of an earlier call, whose memory is used again.
    static ROOM: Cell<Vec<Vec4>> = const { Cell::new(Vec::new()) };
}

/// The image at its instant. A pixel is red, green, blue and 1 where it is lit, all 0 elsewhere; its
/// last column and row are there twice, so that every place lies between four pixels.
struct Still {
    pixels: Vec<Vec4>,
    size: (usize, usize),
}

impl Still {
    fn new(image: &[f32], lit: &[bool], (height, width): (usize, usize)) -> Self {
        let mut pixels = ROOM.take();
        pixels.clear();
        pixels.resize((height + 1) * (width + 1), Vec4::ZERO);
        pixels.par_chunks_mut(width + 1).enumerate().for_each(|(y, row)| {
            let start = y.min(height - 1) * width;
            for x in 0..=width {
                let from = start + x.min(width - 1);
                if lit[from] {
                    row[x] =
                        Vec4::new(image[3 * from], image[3 * from + 1], image[3 * from + 2], 1.0);
                }
            }
        });
        Still { pixels, size: (height, width) }
    }

    /// Bilinear between four pixels; the image goes on as at its edge.
    #[inline(always)]
    fn at(&self, x: f32, y: f32) -> Vec4 {
        let (height, width) = self.size;
        let (x0, s) = whole(clamp(x, 0.0, width as f32 - 1.0));
        let (y0, t) = whole(clamp(y, 0.0, height as f32 - 1.0));
        let first = y0 * (width + 1) + x0;
        let top = &self.pixels[first..first + 2];
        let bottom = &self.pixels[first + width + 1..first + width + 3];
        let (above, below) =
            (top[0] + (top[1] - top[0]) * s, bottom[0] + (bottom[1] - bottom[0]) * s);
        above + (below - above) * t
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
    motion: &Motion,
    (shutter, late): (f32, f32),
    out: &mut [f32],
) {
    let row = motion.row(y);
    let own = &still.pixels[y * (still.size.1 + 1)..];
    for (x, pixel) in out.chunks_exact_mut(3).enumerate() {
        if own[x].w == 0.0 {
            continue;
        }
        let (first, t) = between(x as f32, motion.scale, row.len());
        let v = mix(&row[first], &row[(first + 1).min(row.len() - 1)], t);
        let speed = max(v[0].abs(), v[1].abs());
        if speed * (late.abs() + 0.5 * shutter) < STILL {
            pixel.copy_from_slice(&own[x].to_array()[..3]);
            continue;
        }
        let count = clamp((speed * shutter).ceil(), 1.0, MOST_SAMPLES);
        let step = shutter / count;
        let mut time = late - 0.5 * (shutter - step);
        let mut sum = Vec4::ZERO;
        for _ in 0..count as u32 {
            sum += still.at(x as f32 - v[0] * time, y as f32 - v[1] * time);
            time += step;
        }
        let mean = if sum.w > 0.0 { sum * (1.0 / sum.w) } else { own[x] };
        pixel.copy_from_slice(&mean.to_array()[..3]);
    }
}
