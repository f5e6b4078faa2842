//! Motion blur during the exposure, and rolling shutter.

use super::motion_field::{MotionField, Shutter, Window, whole};
use super::planes::{Line, planes_array, rows, size_of_image};
use crate::pool::on_pool;
use crate::simd::f32x64::{clamp, load, max, min, store};
use numpy::{PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;
use std::ops::Range;

/// Maximum number of positions over which a pixel is averaged.
const MOST_SAMPLES: f32 = 64.0;
/// Shift below which interpolation is skipped [px].
const MIN_SHIFT: f32 = 1e-3;

/// Planes [3 h w] of the image [h w 3], times a factor, as exposed by a moving camera.
///
/// A pixel is the mean over the exposure of its row of the image that moves past it. `motion` is
/// the motion of the image in one frame's time [px] at every `STEP`th pixel of every `STEP`th row
/// [rows columns 2], the first at the center of a square of `STEP` pixels. `shutter` has the times
/// of `Shutter`, in its order. Pixels that are not `lit` stay black and contribute nothing.
#[pyfunction]
pub fn motion_blur<'py>(
    py: Python<'py>,
    image: PyReadonlyArray3<'py, f32>,
    lit: PyReadonlyArray2<'py, bool>,
    motion: PyReadonlyArray3<'py, f32>,
    shutter: (f32, f32, f32),
    factor: f32,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let (height, width) = size_of_image(&image)?;
    let [rows_known, columns, 2] = motion.shape()[..] else {
        return Err(PyValueError::new_err("Motion must be of shape (rows, columns, 2)."));
    };
    if lit.shape() != [height, width] || rows_known * columns == 0 {
        return Err(PyValueError::new_err("Motion and lit must fit the image."));
    }
    let (source, lit) = (image.as_slice()?, lit.as_slice()?);
    let shutter = Shutter::of(shutter);
    let vectors = motion.as_slice()?;
    let mut out = vec![0.0; source.len()];
    on_pool(py, || {
        let motion = MotionField::new(vectors, (rows_known, columns)).at_readout(shutter, height);
        let lit = LitMask::new((height, width), lit);
        let mut planes = lit.framed(source);
        extend_edges(&mut planes, (height, width));
        let sharp = SharpImage::new(&planes, &lit, factor);
        let lines = rows(&mut out, (height, width)).into_par_iter().enumerate();
        lines.for_each(|(y, line)| sharp.blur(y, &motion, shutter, line));
    });
    Ok(planes_array(py, out, (height, width)))
}

/// Number of pixels processed together.
const RUN: usize = 32;
/// Columns and rows around the image, which repeat its edge.
const MARGIN: usize = 16;
/// Maximum number of neighbors on one side for positions of a run that are read together.
const MOST_TAPS: usize = 4;
/// Distance between positions that guarantees no more than these neighbors [px].
const MOST_SPREAD: f32 = (MOST_TAPS - 2) as f32;

type Run = [f32; RUN];

/// Rows and columns of a plane with its margin, for an image of a size.
pub fn with_margin((height, width): (usize, usize)) -> (usize, usize) {
    (height + 2 * MARGIN, width.div_ceil(RUN) * RUN + 2 * MARGIN)
}

/// Range of a row of the image in a plane with a margin.
pub fn inside(y: usize, (height, width): (usize, usize)) -> Range<usize> {
    let start = (y + MARGIN) * with_margin((height, width)).1 + MARGIN;
    start..start + width
}

/// Fills the margin of planes with the edge of the image.
pub fn extend_edges(planes: &mut [f32], size: (usize, usize)) {
    let ((height, width), (rows, stride)) = (size, with_margin(size));
    planes.par_chunks_mut(rows * stride).for_each(|plane| {
        for row in plane.chunks_exact_mut(stride).skip(MARGIN).take(height) {
            let (left, right) = (row[MARGIN], row[MARGIN + width - 1]);
            row[..MARGIN].fill(left);
            row[MARGIN + width..].fill(right);
        }
        let last = (MARGIN + height - 1) * stride;
        for row in 0..MARGIN {
            plane.copy_within(MARGIN * stride..(MARGIN + 1) * stride, row * stride);
            plane.copy_within(last..last + stride, last + (row + 1) * stride);
        }
    });
}

/// Mask of the pixels that have a ray.
pub struct LitMask {
    /// 1 for pixels with a ray, 0 for others, with a margin.
    mask: Vec<f32>,
    /// True if all pixels of a square of `RUN` by `RUN` pixels within the image have a ray.
    squares: Vec<bool>,
    size: (usize, usize),
}

impl LitMask {
    /// Mask of an image of a size.
    pub fn new(size: (usize, usize), lit: &[bool]) -> Self {
        let ((height, width), (rows, stride)) = (size, with_margin(size));
        let columns = width.div_ceil(RUN);
        let mut squares = vec![true; columns * height.div_ceil(RUN)];
        let mut mask = vec![0.0; rows * stride];
        for (y, lit) in lit.chunks_exact(width).enumerate() {
            for (x, (&lit, weight)) in lit.iter().zip(&mut mask[inside(y, size)]).enumerate() {
                squares[y / RUN * columns + x / RUN] &= lit;
                *weight = f32::from(u8::from(lit));
            }
        }
        extend_edges(&mut mask, size);
        LitMask { mask, squares, size }
    }

    /// Planes of an image [h w 3] with space for a margin, black where it is not lit.
    fn framed(&self, image: &[f32]) -> Vec<f32> {
        let ((_, width), area) = (self.size, self.mask.len());
        let mut planes = vec![0.0; 3 * area];
        for (y, row) in image.chunks_exact(3 * width).enumerate() {
            for (place, pixel) in inside(y, self.size).zip(row.chunks_exact(3)) {
                for k in 0..3 {
                    planes[k * area + place] = pixel[k] * self.mask[place];
                }
            }
        }
        planes
    }
}

/// The image at one instant.
pub struct SharpImage<'a> {
    /// Red, green, blue, with a margin; 0 where it is not lit.
    colors: [&'a [f32]; 3],
    lit: &'a LitMask,
    factor: f32,
}

impl<'a> SharpImage<'a> {
    /// Image from planes with a filled margin, to be multiplied by a factor.
    pub fn new(planes: &'a [f32], lit: &'a LitMask, factor: f32) -> Self {
        let area = planes.len() / 3;
        SharpImage { colors: [0, 1, 2].map(|k| &planes[k * area..][..area]), lit, factor }
    }

    /// Fills a line of an image with the mean over its exposure, given the motion at readout.
    pub fn blur(&self, y: usize, motion: &MotionField, shutter: Shutter, line: Line<'_>) {
        let mut window = shutter.window(y as f32, self.lit.size.0);
        window.weight *= self.factor;
        blur_row(self, y, motion, window, line);
    }

    /// Index of a pixel of the image or its margin in a plane.
    #[inline(always)]
    fn index(&self, row: isize, column: isize) -> usize {
        MARGIN.wrapping_add_signed(row) * self.stride() + MARGIN.wrapping_add_signed(column)
    }

    #[inline(always)]
    fn stride(&self) -> usize {
        with_margin(self.lit.size).1
    }

    /// Plane of red, green, blue or of the mask.
    #[inline(always)]
    fn plane(&self, plane: usize) -> &[f32] {
        if plane < 3 { self.colors[plane] } else { &self.lit.mask }
    }

    /// Values of a plane from an index on.
    #[inline(always)]
    fn run(&self, plane: usize, start: usize) -> Run {
        load(&self.plane(plane)[start..start + RUN])
    }

    /// Bilinear interpolation between four pixels; the edge of the image is repeated.
    #[inline(always)]
    fn at(&self, x: f32, y: f32) -> [f32; 4] {
        let (height, width) = self.lit.size;
        let (x0, s) = whole(clamp(x, 0.0, width as f32 - 1.0));
        let (y0, t) = whole(clamp(y, 0.0, height as f32 - 1.0));
        let start = self.index(y0 as isize, x0 as isize);
        let mut light = [0.0; 4];
        for (k, light) in light.iter_mut().enumerate() {
            let rows = &self.plane(k)[start..];
            let (above, below) = (&rows[..2], &rows[self.stride()..][..2]);
            let top = above[0] + (above[1] - above[0]) * s;
            let bottom = below[0] + (below[1] - below[0]) * s;
            *light = top + (bottom - top) * t;
        }
        light
    }

    /// True if a run that starts at a position lies within the image and its margin after the given
    /// motion.
    #[inline(always)]
    fn holds(&self, (x, y): (usize, usize), along: [f32; 2], down: [f32; 2]) -> bool {
        let (height, margin) = (self.lit.size.0, MARGIN as f32);
        let (x, y, end) = (x as f32, y as f32, (self.stride() - MARGIN) as f32);
        x + along[0] >= -margin
            && x + along[1] + RUN as f32 <= end
            && y + down[0] >= -margin
            && y + down[1] <= height as f32 - 1.0 + margin
    }

    /// True if all pixels that a run may read during the given motion are lit.
    #[inline(always)]
    fn is_all_lit(&self, (x, y): (usize, usize), along: [f32; 2], down: [f32; 2]) -> bool {
        let (height, width) = self.lit.size;
        let square =
            |place: f32, count: usize| clamp(place, 0.0, count as f32 - 1.0) as usize / RUN;
        let (x, y) = (x as f32, y as f32);
        let (top, bottom) = (square(y + down[0] - 1.0, height), square(y + down[1] + 1.0, height));
        let left = square(x + along[0] - 1.0, width);
        let right = square(x + along[1] + RUN as f32, width);
        let squares = width.div_ceil(RUN);
        let row = |row: usize| &self.lit.squares[row * squares + left..=row * squares + right];
        (top..=bottom).all(|y| row(y).iter().all(|&lit| lit))
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn blur_row(sharp: &SharpImage, y: usize, motion: &MotionField, window: Window, out: Line<'_>) {
    let (shutter, late) = (window.length, window.late);
    let width = sharp.lit.size.1;
    let motion = motion.row(y, width.div_ceil(RUN) * RUN);
    for x in (0..width).step_by(RUN) {
        let mut own = [[0.0; RUN]; 4];
        for plane in 0..4 {
            own[plane] = sharp.run(plane, sharp.index(y as isize, x as isize));
        }
        let near = [load(&motion[0][x..]), load(&motion[1][x..])];
        let ends = [ends(&near[0]), ends(&near[1])];
        let speed = ends.as_flattened().iter().fold(0.0, |most, v: &f32| max(v.abs(), most));
        let mut mean = own;
        if speed * (late.abs() + 0.5 * shutter) >= MIN_SHIFT {
            let count = clamp((speed * shutter).ceil(), 1.0, MOST_SAMPLES);
            let moving = (&near, ends);
            let times = (shutter, late);
            let (along, down) = (swept(ends[0], times), swept(ends[1], times));
            let is_near = sharp.holds((x, y), along, down)
                && max(spread(ends[0], times), spread(ends[1], times)) < MOST_SPREAD;
            if is_near && sharp.is_all_lit((x, y), along, down) {
                let sum = streak::<3, true>(sharp, (x, y), moving, (shutter, late), count);
                let weight = 1.0 / count;
                for k in 0..3 {
                    for i in 0..RUN {
                        mean[k][i] = sum[k][i] * weight;
                    }
                }
            } else {
                let sum = streak::<4, false>(sharp, (x, y), moving, (shutter, late), count);
                mean = mean_of_lit(&sum, &own);
            }
        }
        for k in 0..3 {
            store(&mean[k].map(|light| light * window.weight), &mut out[k][x..]);
        }
    }
}

/// Mean of the lit part of the sum, where a run itself is lit.
#[inline(always)]
fn mean_of_lit(sum: &[Run; 4], own: &[Run; 4]) -> [Run; 4] {
    let mut mean = *own;
    for i in 0..RUN {
        let known = if sum[3][i] > 0.0 { own[3][i] } else { 0.0 };
        let weight = known / max(sum[3][i], 1e-30);
        let rest = own[3][i] - known;
        for k in 0..3 {
            mean[k][i] = sum[k][i] * weight + own[k][i] * rest;
        }
    }
    mean
}

/// Range that a run covers during the exposure, given its minimum and maximum motion.
#[inline(always)]
fn swept([low, high]: [f32; 2], (shutter, late): (f32, f32)) -> [f32; 2] {
    let (first, last) = (late - 0.5 * shutter, late + 0.5 * shutter);
    let (early, late) = (moved([low, high], first), moved([low, high], last));
    [min(0.0, min(early[0], late[0])), max(0.0, max(early[1], late[1]))]
}

/// Maximum distance between the pixels of a run during the exposure, given its minimum and
/// maximum motion.
#[inline(always)]
fn spread([low, high]: [f32; 2], (shutter, late): (f32, f32)) -> f32 {
    (high - low) * (late.abs() + 0.5 * shutter)
}

/// Minimum and maximum of a run.
#[inline(always)]
fn ends(run: &Run) -> [f32; 2] {
    [least(run), -least(&run.map(|x| -x))]
}

/// Minimum of a run, by halves.
#[inline(always)]
fn least(run: &Run) -> f32 {
    let low: [f32; 16] = std::array::from_fn(|i| min(run[i], run[i + 16]));
    let low: [f32; 8] = std::array::from_fn(|i| min(low[i], low[i + 8]));
    let low: [f32; 4] = std::array::from_fn(|i| min(low[i], low[i + 4]));
    min(min(low[0], low[1]), min(low[2], low[3]))
}

/// Sum over the exposure of the image that moves past a run of pixels; `ends` are the minimum and
/// maximum of its motion along rows and columns. It `IS_NEAR` if its positions are never outside
/// the margin, nor farther apart than `MOST_SPREAD`.
#[inline(always)]
fn streak<const PLANES: usize, const IS_NEAR: bool>(
    sharp: &SharpImage,
    (x, y): (usize, usize),
    (motion, ends): (&[Run; 2], [[f32; 2]; 2]),
    (shutter, late): (f32, f32),
    count: f32,
) -> [Run; PLANES] {
    let step = shutter / count;
    let mut time = late - 0.5 * (shutter - step);
    let mut sum = [[0.0f32; RUN]; PLANES];
    for _ in 0..count as u32 {
        let (along, down) = (moved(ends[0], time), moved(ends[1], time));
        let first = [along[0].floor(), down[0].floor()];
        let taps = [along[1].ceil() - first[0], down[1].ceil() - first[1]];
        let is_near = IS_NEAR
            || (sharp.holds((x, y), along, down) && max(taps[0], taps[1]) < MOST_TAPS as f32);
        if is_near {
            let start = sharp.index(y as isize + first[1] as isize, x as isize + first[0] as isize);
            let mut rest = [[0.0; RUN]; 2];
            for k in 0..2 {
                for i in 0..RUN {
                    rest[k][i] = -motion[k][i] * time - first[k];
                }
            }
            let taps = [taps[0] as usize, taps[1] as usize];
            add_shifted(sharp, start, taps, &rest, &mut sum);
        } else {
            for i in 0..RUN {
                let place = [(x + i) as f32 - motion[0][i] * time, y as f32 - motion[1][i] * time];
                let value = sharp.at(place[0], place[1]);
                for k in 0..PLANES {
                    sum[k][i] += value[k];
                }
            }
        }
        time += step;
    }
    sum
}

/// Minimum and maximum shift of the image at a time.
#[inline(always)]
fn moved([low, high]: [f32; 2], time: f32) -> [f32; 2] {
    let (one, other) = (-low * time, -high * time);
    [min(one, other), max(one, other)]
}

/// Adds the image from an index on, each pixel shifted by `rest`: bilinear, with neighbors up to
/// `taps` away.
#[inline(always)]
fn add_shifted<const PLANES: usize>(
    sharp: &SharpImage,
    start: usize,
    taps: [usize; 2],
    rest: &[Run; 2],
    sum: &mut [Run; PLANES],
) {
    let mut across = [[0.0f32; RUN]; MOST_TAPS];
    for (column, across) in across.iter_mut().enumerate().take(taps[0] + 1) {
        for i in 0..RUN {
            across[i] = max(1.0 - (rest[0][i] - column as f32).abs(), 0.0);
        }
    }
    for row in 0..=taps[1] {
        let mut down = [0.0f32; RUN];
        for i in 0..RUN {
            down[i] = max(1.0 - (rest[1][i] - row as f32).abs(), 0.0);
        }
        for (column, across) in across.iter().enumerate().take(taps[0] + 1) {
            for plane in 0..PLANES {
                let values = sharp.run(plane, start + row * sharp.stride() + column);
                for i in 0..RUN {
                    sum[plane][i] += across[i] * down[i] * values[i];
                }
            }
        }
    }
}
