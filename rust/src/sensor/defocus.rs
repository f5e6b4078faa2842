//! Blur of what is out of focus, by the circle of confusion of a thin lens.

use super::planes::{Line, planes_array, rows, size};
use crate::contents::front::FRONT_BUBBLE;
use crate::cpu::on_pool;
use crate::lanes::{clamp, load, max, min, store};
use numpy::{PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Largest radius of the circle of confusion [px]; one beyond it is taken as this.
const WIDEST: f32 = 15.0;
/// Pixels that share a set of neighbours to look at; above `WIDEST`, so that what reaches into a
/// block lies in it or in one next to it.
const BLOCK: usize = 16;
/// Margin around the image in which there is nothing.
const MARGIN: usize = 16;
/// Rows worked on together.
const ROWS: usize = 4;
/// Radius of what is not seen; its share of the light is 0.
const NOWHERE: f32 = -1e9;

/// Red, green, blue, signed radius and one over its square, with a margin.
pub struct Padded {
    planes: [Vec<f32>; 5],
    size: (usize, usize),
    stride: usize,
    /// Half a pixel less the distance of a neighbour, by rows and columns away from it [px].
    edges: Vec<[f32; MARGIN + 1]>,
}

/// The image seen through an aperture.
///
/// The radius of the circle of confusion at distance d [m] is `reach · |1/focus − 1/d|` [px], where
/// `reach` is half the aperture times the focal length [px·m]. Each pixel spreads over its circle;
/// what is behind another surface spreads over it no wider than that surface itself. Where distance
/// is NaN the pixel stays black.
#[pyfunction]
pub fn defocus<'py>(
    py: Python<'py>,
    planes: PyReadonlyArray3<'py, f32>,
    distance: PyReadonlyArray2<'py, f32>,
    reach: f32,
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
        for (k, line) in padded.lines().into_iter().enumerate() {
            for (plane, row) in line.into_iter().enumerate() {
                row.copy_from_slice(&source[(plane * height + k) * width..][..width]);
            }
        }
        padded.measure(reach, focus, |y, row| {
            row.copy_from_slice(&distance[y * width..][..width]);
        });
        padded.spread(rows(&mut out, (height, width)));
    });
    Ok(planes_array(py, out, (height, width)))
}

impl Padded {
    /// Room for an image of a size, with its margin.
    pub fn new(size: (usize, usize)) -> Self {
        let stride = size.1.div_ceil(BLOCK) * BLOCK + 2 * MARGIN;
        let length = stride * (size.0.div_ceil(ROWS) * ROWS + 2 * MARGIN);
        let nothing = |k: usize| if k == 3 { NOWHERE } else { 0.0 };
        let planes = [0, 1, 2, 3, 4].map(|k| vec![nothing(k); length]);
        let edge = |down: usize, along: usize| 0.5 - ((down * down + along * along) as f32).sqrt();
        let edges = (0..=MARGIN + ROWS).map(|y| std::array::from_fn(|x| edge(y, x))).collect();
        Padded { planes, size, stride, edges }
    }

    /// Where the image goes before it is spread.
    pub fn lines(&mut self) -> Vec<Line<'_>> {
        let ((height, width), stride) = (self.size, self.stride);
        let [red, green, blue, ..] = &mut self.planes;
        let red = red.chunks_mut(stride).skip(MARGIN).take(height);
        let rows = red.zip(green.chunks_mut(stride).skip(MARGIN));
        let rows = rows.zip(blue.chunks_mut(stride).skip(MARGIN));
        let row =
            |((r, g), b): ((_, _), _)| [r, g, b].map(|row: &mut [f32]| &mut row[MARGIN..][..width]);
        rows.map(row).collect()
    }

    /// Takes the distances of what is seen [m], which `distances` writes for one row.
    pub fn measure(
        &mut self,
        reach: f32,
        focus: f32,
        distances: impl Fn(usize, &mut [f32]) + Sync,
    ) {
        let (size, stride) = (self.size, self.stride);
        let [_, _, _, radius, share] = &mut self.planes;
        inner(radius, size, stride)
            .zip(inner(share, size, stride))
            .with_min_len(MIN_ROWS)
            .for_each(|((y, radius), (_, share))| {
                distances(y, radius);
                radii(reach, focus, radius, share);
            });
    }

    /// Fills the lines of an image with the light of this one, spread.
    pub fn spread(&self, mut lines: Vec<Line<'_>>) {
        let width = self.size.1;
        let blocks = width.div_ceil(BLOCK);
        let widest = self.widest();
        lines.par_chunks_mut(ROWS).enumerate().for_each(|(group, lines)| {
            for block in 0..blocks {
                let radius = around(&widest, blocks, group * ROWS, block);
                let mixed = spread_block(self, (group * ROWS, block * BLOCK), radius);
                for (line, values) in lines.iter_mut().zip(&mixed) {
                    for (row, values) in line.iter_mut().zip(values) {
                        store(values, &mut row[block * BLOCK..]);
                    }
                }
            }
        });
    }

    /// Widest radius of each block.
    fn widest(&self) -> Vec<f32> {
        let (height, width) = self.size;
        let blocks = width.div_ceil(BLOCK);
        let mut widest = vec![0.0f32; blocks * height.div_ceil(BLOCK)];
        widest.par_chunks_mut(blocks).enumerate().for_each(|(band, row)| {
            for y in band * BLOCK..((band + 1) * BLOCK).min(height) {
                let line = &self.planes[3][(y + MARGIN) * self.stride + MARGIN..];
                widen(line, row);
            }
        });
        widest
    }
}

/// Fewest rows that one thread takes.
const MIN_ROWS: usize = 64;

/// Takes a row of radii into the widest of its blocks.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn widen(line: &[f32], widest: &mut [f32]) {
    for (most, values) in widest.iter_mut().zip(line.chunks_exact(BLOCK)) {
        let mut wide = [0.0f32; BLOCK];
        for i in 0..BLOCK {
            wide[i] = if values[i] == NOWHERE { 0.0 } else { values[i].abs() };
        }
        for half in [8, 4, 2, 1] {
            for i in 0..half {
                wide[i] = max(wide[i], wide[i + half]);
            }
        }
        *most = max(wide[0], *most);
    }
}

/// Rows of a padded plane without its margin.
fn inner(
    plane: &mut [f32],
    (height, width): (usize, usize),
    stride: usize,
) -> impl IndexedParallelIterator<Item = (usize, &mut [f32])> {
    let rows = plane.par_chunks_mut(stride).skip(MARGIN).take(height);
    rows.map(move |row| &mut row[MARGIN..MARGIN + width]).enumerate()
}

/// Makes of distances [m] signed radii [px], and one over their squares.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn radii(reach: f32, focus: f32, radius: &mut [f32], share: &mut [f32]) {
    for (radius, share) in radius.iter_mut().zip(share) {
        let d = *radius;
        let wide = clamp(reach * (1.0 / focus - 1.0 / d), -WIDEST, WIDEST);
        let across = max(wide.abs(), 0.5);
        *radius = if d.is_nan() { NOWHERE } else { wide };
        *share = if d.is_nan() { 0.0 } else { 1.0 / (across * across) };
    }
}

/// Widest radius in a block and those next to it; of those above and below, if it reaches the rows
/// from `top` on.
fn around(widest: &[f32], blocks: usize, top: usize, column: usize) -> f32 {
    let (rows, own) = (widest.len() / blocks, top / BLOCK);
    let mut most = 0.0;
    for r in own.saturating_sub(1)..(own + 2).min(rows) {
        let above = top.saturating_sub(r * BLOCK + BLOCK - 1);
        let gap = above.max((r * BLOCK).saturating_sub(top + ROWS - 1));
        for c in column.saturating_sub(1)..(column + 2).min(blocks) {
            let radius = widest[r * blocks + c];
            most = if radius + 0.5 > gap as f32 { max(radius, most) } else { most };
        }
    }
    most
}

type Run = [f32; BLOCK];

/// Light of a block's rows from a place (row, column) on, given the widest radius about.
///
/// A neighbour is loaded once for all rows that it may reach.
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
    let [own, own_share] = own;
    let (mut sums, mut total) = ([[[0.0f32; BLOCK]; 3]; ROWS], [[0.0f32; BLOCK]; ROWS]);
    let reach = radius + 0.5;
    let most = reach as i32;
    for down in -most..most + ROWS as i32 {
        let beside = max(0.0, max(-down as f32, (down - ROWS as i32 + 1) as f32));
        let side = max(reach * reach - beside * beside, 0.0).sqrt() as i32;
        for along in -side..=side {
            let offset = down as isize * padded.stride as isize + along as isize;
            let from = start.wrapping_add_signed(offset);
            let (near, share) = (at(3, from), at(4, from));
            let colors = [at(0, from), at(1, from), at(2, from)];
            for r in 0..ROWS {
                let edge =
                    padded.edges[down.abs_diff(r as i32) as usize][along.unsigned_abs() as usize];
                if radius + edge <= 0.0 {
                    continue; // out of reach
                }
                for i in 0..BLOCK {
                    // What is farther and wider is hidden beyond the pixel's own circle.
                    let wide = min(near[i], own_wide[r][i]).abs();
                    let share = chosen(near[i] > own_wide[r][i], own_share[r][i], share[i]);
                    let weight = clamp(wide + edge, 0.0, 1.0) * share;
                    total[r][i] += weight;
                    for k in 0..3 {
                        sums[r][k][i] += weight * colors[k][i];
                    }
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

/// One number or the other. Written as a choice of bits: of an `if` the compiler makes a choice of
/// where to load from, lane by lane.
#[inline(always)]
fn chosen(first: bool, one: f32, other: f32) -> f32 {
    let mask = u32::from(first).wrapping_neg();
    f32::from_bits((one.to_bits() & mask) | (other.to_bits() & !mask))
}

/// Puts the distance of bubbles in place of that of what is behind them.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
pub fn bring_near(row: &mut [f32], front: &[u8], (depth, cosine): (&[f32], &[f32])) {
    for (((distance, &front), depth), cosine) in row.iter_mut().zip(front).zip(depth).zip(cosine) {
        let along = depth / cosine;
        let is_nearer = (front == FRONT_BUBBLE) & (along > 0.0);
        *distance = if is_nearer { along } else { *distance };
    }
}
