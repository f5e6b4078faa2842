//! Defocus blur by the circle of confusion of a thin lens.

use super::dome::totals;
use super::planes::{Line, planes_array, rows, size};
use crate::pool::on_pool;
use crate::render::lumen::foreground::FOREGROUND_BUBBLE;
use crate::simd::f32x64::{Vec3, clamp, load, max, min, store};
use numpy::{PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Maximum radius of the circle of confusion [px]; larger ones are clamped.
const WIDEST: f32 = 15.0;
/// Side of the blocks of pixels that share a set of neighbors; above `WIDEST`, so that only pixels
/// in a block or in adjacent ones reach into it.
const BLOCK: usize = 16;
/// Empty margin around the image.
const MARGIN: usize = 16;
/// Number of rows processed together.
const ROWS: usize = 4;
/// Number of groups of rows that one thread takes at a time, because their costs differ.
const AT_ONCE: usize = 4;
/// Distance in blocks between the processed and the prefetched one.
const AHEAD: usize = 2;
/// Radius of pixels without a surface; their weight is 0.
const NOWHERE: f32 = -1e9;

/// Red, green, blue, signed radius and its inverse square, with a margin.
pub struct Padded {
    planes: [Vec<f32>; 5],
    /// Maximum radii of each block.
    widest: Vec<Widest>,
    size: (usize, usize),
    stride: usize,
    /// Neighbors of a block's rows, the nearest first.
    taps: Vec<Tap>,
    /// Number of neighbors within a distance, by its square [px²].
    within: Vec<usize>,
}

/// A neighbor of a block's rows.
struct Tap {
    /// Offset from the block in a plane.
    offset: isize,
    /// Half a pixel minus its distance from each row [px].
    edges: [f32; ROWS],
}

/// Image through a finite aperture.
///
/// The radius of the circle of confusion at distance d [m] is `radius_scale · |1/focus − 1/d|`
/// [px], where `radius_scale` is half the aperture times the focal length [px·m]. Each pixel
/// spreads over its circle; a surface behind another spreads over it at most by the latter's own
/// radius. Where distance is NaN the pixel stays black.
#[pyfunction]
pub fn depth_of_field<'py>(
    py: Python<'py>,
    planes: PyReadonlyArray3<'py, f32>,
    distance: PyReadonlyArray2<'py, f32>,
    radius_scale: f32,
    focus: f32,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let (height, width) = size(&planes)?;
    if distance.shape() != [height, width] {
        return Err(PyValueError::new_err("Distances must be of the planes' shape (h, w)."));
    }
    let (source, distance) = (planes.as_slice()?, distance.as_slice()?);
    let mut out = vec![0.0; source.len()];
    on_pool(py, || {
        let mut padded = Padded::new((height, width));
        let light = |y: usize, line: Line<'_>| {
            for (plane, row) in line.into_iter().enumerate() {
                row.copy_from_slice(&source[(plane * height + y) * width..][..width]);
            }
        };
        padded.fill((radius_scale, focus), light, |y, row| {
            row.copy_from_slice(&distance[y * width..][..width]);
        });
        padded.spread(rows(&mut out, (height, width)), &mut vec![[0.0; 3]; height]);
    });
    Ok(planes_array(py, out, (height, width)))
}

impl Padded {
    /// Allocates an image of a size, with its margin.
    pub fn new(size: (usize, usize)) -> Self {
        let stride = size.1.div_ceil(BLOCK) * BLOCK + 2 * MARGIN;
        let length = stride * (size.0.div_ceil(ROWS) * ROWS + 2 * MARGIN);
        let nothing = |k: usize| if k == 3 { NOWHERE } else { 0.0 };
        let planes = [0, 1, 2, 3, 4].map(|k| vec![nothing(k); length]);
        let (taps, within) = taps(stride);
        let widest = vec![Widest::default(); size.0.div_ceil(ROWS) * size.1.div_ceil(BLOCK)];
        Padded { planes, widest, size, stride, taps, within }
    }

    /// Sets the image from lines that `light` writes and distances [m] that `distances` writes, for
    /// a lens with the given `radius_scale` and focus.
    pub fn fill(
        &mut self,
        (radius_scale, focus): (f32, f32),
        light: impl Fn(usize, Line<'_>) + Sync,
        distances: impl Fn(usize, &mut [f32]) + Sync,
    ) {
        let ((height, width), stride) = (self.size, self.stride);
        let [red, green, blue, radius, weight] = self.planes.each_mut().map(|plane| {
            plane[MARGIN * stride..(MARGIN + height) * stride].par_chunks_mut(ROWS * stride)
        });
        let planes = red.zip(green).zip(blue).zip(radius.zip(weight));
        let blocks = self.widest.par_chunks_mut(width.div_ceil(BLOCK));
        let groups = planes.zip(blocks).with_max_len(AT_ONCE).enumerate();
        groups.for_each(|(group, (planes, widest))| {
            let (((red, green), blue), (radius, weight)) = planes;
            widest.fill(Widest::default());
            for row in 0..radius.len() / stride {
                let (y, start) = (group * ROWS + row, row * stride + MARGIN);
                let inside = start..start + width;
                let [red, green, blue] =
                    [&mut *red, &mut *green, &mut *blue].map(|plane| &mut plane[inside.clone()]);
                light(y, [red, green, blue]);
                distances(y, &mut radius[inside.clone()]);
                radii(radius_scale, focus, &mut radius[inside.clone()], &mut weight[inside]);
                widen(&radius[start..], widest);
            }
        });
    }

    /// Fills the lines with the blurred image and computes the `totals` of each.
    pub fn spread(&self, mut lines: Vec<Line<'_>>, sums: &mut [Vec3]) {
        let blocks = self.size.1.div_ceil(BLOCK);
        let widest = &self.widest;
        let nearest = widest.iter().fold(0.0, |most, block| max(block.near, most));
        let groups = (nearest + 0.5) as usize / ROWS + 1;
        let lines = lines.par_chunks_mut(ROWS).zip(sums.par_chunks_mut(ROWS));
        lines.with_max_len(AT_ONCE).enumerate().for_each(|(group, (lines, sums))| {
            for block in 0..blocks {
                let radius = around(widest, blocks, (group, block), groups);
                self.fetch((group * ROWS, (block + AHEAD) * BLOCK), radius);
                let mixed = spread_block(self, (group * ROWS, block * BLOCK), radius);
                for (line, values) in lines.iter_mut().zip(&mixed) {
                    for (row, values) in line.iter_mut().zip(values) {
                        store(values, &mut row[block * BLOCK..]);
                    }
                }
            }
            for (line, sum) in lines.iter().zip(sums) {
                *sum = totals(line);
            }
        });
    }

    /// Prefetches the neighbors within a radius of a block at (row, column), because the processor
    /// cannot predict reads from so many rows.
    fn fetch(&self, (y, x): (usize, usize), radius: f32) {
        let radius_scale = (radius + 0.5) as usize;
        let rows = MARGIN + y - radius_scale..MARGIN + y + ROWS + radius_scale;
        let mut seen = 0;
        for plane in &self.planes {
            for row in rows.clone() {
                seen |= plane.get(row * self.stride + x + MARGIN).map_or(0, |x| x.to_bits());
            }
        }
        std::hint::black_box(seen);
    }
}

/// All neighbors of a block's rows, the nearest first, in planes with the given stride, and the
/// number within each distance.
fn taps(stride: usize) -> (Vec<Tap>, Vec<usize>) {
    let (most, last) = (WIDEST as i32, ROWS as i32 - 1);
    let tap = |down: i32, along: i32| {
        let edge = |row: i32| 0.5 - (((down - row).pow(2) + along.pow(2)) as f32).sqrt();
        let offset = down as isize * stride as isize + along as isize;
        Tap { offset, edges: std::array::from_fn(|row| edge(row as i32)) }
    };
    let square = |down: i32, along: i32| (down.min(0) + (down - last).max(0)).pow(2) + along.pow(2);
    let mut all: Vec<(i32, Tap)> = (-most..=most + last)
        .flat_map(|down| (-most..=most).map(move |along| (down, along)))
        .map(|(down, along)| (square(down, along), tap(down, along)))
        .collect();
    all.sort_by_key(|near| near.0);
    let within = |square: i32| all.partition_point(|near| near.0 <= square);
    let counts = (0..(most + 1).pow(2)).map(within).collect();
    (all.into_iter().map(|near| near.1).collect(), counts)
}

/// Maximum radii in a block of `ROWS` by `BLOCK` pixels [px].
#[derive(Clone, Copy, Default)]
struct Widest {
    /// Maximum over all pixels.
    any: f32,
    /// Maximum over pixels nearer than the focus: only these spread farther than the circle of the
    /// pixel on which they end.
    near: f32,
}

/// Updates the maximum radii of blocks by a row of radii.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn widen(line: &[f32], widest: &mut [Widest]) {
    for (widest, values) in widest.iter_mut().zip(line.chunks_exact(BLOCK)) {
        let (mut any, mut near) = ([0.0f32; BLOCK], [0.0f32; BLOCK]);
        for i in 0..BLOCK {
            let radius = if values[i] == NOWHERE { 0.0 } else { values[i] };
            (any[i], near[i]) = (radius.abs(), -radius);
        }
        for half in [8, 4, 2, 1] {
            for i in 0..half {
                any[i] = max(any[i], any[i + half]);
                near[i] = max(near[i], near[i + half]);
            }
        }
        widest.any = max(any[0], widest.any);
        widest.near = max(near[0], widest.near);
    }
}

/// Converts distances [m] to signed radii [px], and computes their inverse squares.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn radii(radius_scale: f32, focus: f32, radius: &mut [f32], weight: &mut [f32]) {
    for (radius, weight) in radius.iter_mut().zip(weight) {
        let d = *radius;
        let wide = clamp(radius_scale * (1.0 / focus - 1.0 / d), -WIDEST, WIDEST);
        let across = max(wide.abs(), 0.5);
        *radius = if d.is_nan() { NOWHERE } else { wide };
        *weight = if d.is_nan() { 0.0 } else { 1.0 / (across * across) };
    }
}

/// Maximum radius that affects a block (row, column): its own, or that of near pixels that reach
/// into it from up to `rows` rows of blocks away.
fn around(widest: &[Widest], blocks: usize, place: (usize, usize), rows: usize) -> f32 {
    let (group, column) = place;
    let mut most = widest[group * blocks + column].any;
    for row in group.saturating_sub(rows)..(group + rows + 1).min(widest.len() / blocks) {
        let down = gap(row.abs_diff(group), ROWS);
        for c in column.saturating_sub(1)..(column + 2).min(blocks) {
            let (along, near) = (gap(c.abs_diff(column), BLOCK), widest[row * blocks + c].near);
            let radius_scale = near + 0.5;
            let is_within = radius_scale * radius_scale > along * along + down * down;
            most = if is_within { max(near, most) } else { most };
        }
    }
    most
}

/// Minimum distance between pixels of blocks whose indices differ by `blocks`, each `wide` [px].
fn gap(blocks: usize, wide: usize) -> f32 {
    (blocks * wide).saturating_sub(if blocks == 0 { 0 } else { wide - 1 }) as f32
}

type Run = [f32; BLOCK];

/// Light of a block's rows at (row, column), given the maximum radius around it.
///
/// A neighbor is loaded once for all rows and gets weight zero if out of reach, which is faster
/// than a branch.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn spread_block(padded: &Padded, place: (usize, usize), radius: f32) -> [[Run; 3]; ROWS] {
    let at = |plane: usize, from: usize| -> Run { load(&padded.planes[plane][from..from + BLOCK]) };
    let start = (place.0 + MARGIN) * padded.stride + place.1 + MARGIN;
    let mut own = [[[0.0f32; BLOCK]; ROWS]; 2];
    let mut own_wide = [[0.0f32; BLOCK]; ROWS];
    for r in 0..ROWS {
        for k in 0..2 {
            own[k][r] = at(3 + k, start + r * padded.stride);
        }
        for i in 0..BLOCK {
            own_wide[r][i] = own[0][r][i].abs();
        }
    }
    let [own, own_fraction] = own;
    let (mut sums, mut total) = ([[[0.0f32; BLOCK]; 3]; ROWS], [[0.0f32; BLOCK]; ROWS]);
    let radius_scale = radius + 0.5;
    for tap in &padded.taps[..padded.within[(radius_scale * radius_scale) as usize]] {
        let from = start.wrapping_add_signed(tap.offset);
        let (near, weight) = (at(3, from), at(4, from));
        let colors = [at(0, from), at(1, from), at(2, from)];
        for r in 0..ROWS {
            for i in 0..BLOCK {
                // Light from farther and wider pixels is occluded beyond the pixel's own circle.
                let wide = min(near[i], own_wide[r][i]).abs();
                let weight = chosen(near[i] > own_wide[r][i], own_fraction[r][i], weight[i]);
                let weight = clamp(wide + tap.edges[r], 0.0, 1.0) * weight;
                total[r][i] += weight;
                for k in 0..3 {
                    sums[r][k][i] += weight * colors[k][i];
                }
            }
        }
    }
    let mut mean = [[[0.0f32; BLOCK]; 3]; ROWS];
    for r in 0..ROWS {
        for i in 0..BLOCK {
            let seen = if own[r][i] == NOWHERE { 0.0 } else { 1.0 };
            let inverse = seen / max(total[r][i], 1e-30);
            for k in 0..3 {
                mean[r][k][i] = sums[r][k][i] * inverse;
            }
        }
    }
    mean
}

/// Selects one of two values by bit operations: the compiler turns an `if` into a choice of load
/// addresses for each lane.
#[inline(always)]
fn chosen(first: bool, one: f32, other: f32) -> f32 {
    let mask = u32::from(first).wrapping_neg();
    f32::from_bits((one.to_bits() & mask) | (other.to_bits() & !mask))
}

/// Replaces the distance of the surfaces behind bubbles by that of the bubbles.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
pub fn bring_near(row: &mut [f32], front: &[u8], (depth, cosine): (&[f32], &[f32])) {
    for (((distance, &front), depth), cosine) in row.iter_mut().zip(front).zip(depth).zip(cosine) {
        let along = depth / cosine;
        let is_nearer = (front == FOREGROUND_BUBBLE) & (along > 0.0);
        *distance = if is_nearer { along } else { *distance };
    }
}
