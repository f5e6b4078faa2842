//! Blur of what is out of focus, by the circle of confusion of a thin lens.

use super::planes::{planes_array, rows, size};
use crate::lanes::{clamp, max};
use numpy::{PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;
use std::cell::Cell;

/// Largest radius of the circle of confusion [px]; one beyond it is taken as this.
const WIDEST: f32 = 15.0;
/// Pixels that share a set of neighbours to look at; above `WIDEST`, so that what reaches into a
/// block lies in it or in one next to it.
const BLOCK: usize = 16;
/// Margin around the image in which there is nothing.
const MARGIN: usize = 16;

thread_local! {
    /// Planes of an earlier call, whose memory is used again.
    static ROOM: Cell<[Vec<f32>; 5]> = const { Cell::new([const { Vec::new() }; 5]) };
}

/// Red, green, blue, signed radius and one over its square, with a margin; the radius of what is
/// not seen is NaN.
struct Padded {
    planes: [Vec<f32>; 5],
    width: usize,
}

/// One neighbour: how far on in the padded planes, and its distance [px].
struct Tap {
    offset: isize,
    distance: f32,
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
    py.detach(|| {
        let padded = Padded::new(source, distance, (height, width), reach, focus);
        let blocks = width.div_ceil(BLOCK);
        let widest = padded.widest((height, width));
        let taps = taps(padded.width);
        rows(&mut out, (height, width)).into_par_iter().enumerate().for_each(|(y, row)| {
            let near: Vec<&[Tap]> = (0..blocks)
                .map(|block| {
                    let radius = around(&widest, blocks, y / BLOCK, block);
                    &taps[..taps.partition_point(|tap| tap.distance < radius + 0.5)]
                })
                .collect();
            spread_row(&padded, y, &near, row);
        });
        ROOM.set(padded.planes);
    });
    Ok(planes_array(py, out, (height, width)))
}

impl Padded {
    fn new(
        source: &[f32],
        distance: &[f32],
        (height, width): (usize, usize),
        reach: f32,
        focus: f32,
    ) -> Self {
        let stride = width.div_ceil(BLOCK) * BLOCK + 2 * MARGIN;
        let mut planes = ROOM.take();
        for (k, plane) in planes.iter_mut().enumerate() {
            plane.clear();
            let nothing = if k == 3 { f32::NAN } else { 0.0 };
            plane.resize(stride * (height + 2 * MARGIN), nothing);
            let rows = plane.par_chunks_mut(stride).skip(MARGIN).take(height);
            rows.enumerate().for_each(|(y, row)| {
                let row = &mut row[MARGIN..MARGIN + width];
                if k < 3 {
                    row.copy_from_slice(&source[(k * height + y) * width..][..width]);
                } else {
                    radii(&distance[y * width..][..width], reach, focus, k == 4, row);
                }
            });
        }
        Padded { planes, width: stride }
    }

    /// Widest radius of each block.
    fn widest(&self, (height, width): (usize, usize)) -> Vec<f32> {
        let blocks = width.div_ceil(BLOCK);
        let mut widest = vec![0.0f32; blocks * height.div_ceil(BLOCK)];
        widest.par_chunks_mut(blocks).enumerate().for_each(|(band, row)| {
            for y in band * BLOCK..((band + 1) * BLOCK).min(height) {
                let line = &self.planes[3][(y + MARGIN) * self.width + MARGIN..];
                for (most, values) in row.iter_mut().zip(line.chunks_exact(BLOCK)) {
                    // NaN is never larger.
                    *most = values.iter().fold(*most, |most, r| max(r.abs(), most));
                }
            }
        });
        widest
    }
}

/// Signed radii [px] at distances [m]; NaN where there is none. As a `weight` one over the square,
/// 0 where there is none.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn radii(distance: &[f32], reach: f32, focus: f32, weight: bool, out: &mut [f32]) {
    for (radius, &d) in out.iter_mut().zip(distance) {
        let wide = clamp(reach * (1.0 / focus - 1.0 / d), -WIDEST, WIDEST);
        let across = max(wide.abs(), 0.5);
        let value = if weight { 1.0 / (across * across) } else { wide };
        let nothing = if weight { 0.0 } else { f32::NAN };
        *radius = if d.is_nan() { nothing } else { value };
    }
}

/// Widest radius in a block and those next to it.
fn around(widest: &[f32], blocks: usize, row: usize, column: usize) -> f32 {
    let rows = widest.len() / blocks;
    let mut most = 0.0;
    for r in row.saturating_sub(1)..(row + 2).min(rows) {
        for c in column.saturating_sub(1)..(column + 2).min(blocks) {
            most = max(widest[r * blocks + c], most);
        }
    }
    most
}

/// All neighbours that may count, nearest first.
fn taps(stride: usize) -> Vec<Tap> {
    let reach = MARGIN as isize - 1;
    let mut all = Vec::new();
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            let distance = ((dx * dx + dy * dy) as f32).sqrt();
            all.push(Tap { offset: dy * stride as isize + dx, distance });
        }
    }
    all.sort_by(|a, b| a.distance.total_cmp(&b.distance));
    all
}

fn spread_row(padded: &Padded, y: usize, near: &[&[Tap]], mut out: [&mut [f32]; 3]) {
    for (block, taps) in near.iter().enumerate() {
        let start = (y + MARGIN) * padded.width + MARGIN + block * BLOCK;
        let mixed = spread_block(padded, start, taps);
        let columns = block * BLOCK..((block + 1) * BLOCK).min(out[0].len());
        for (row, values) in out.iter_mut().zip(&mixed) {
            let length = columns.len();
            row[columns.clone()].copy_from_slice(&values[..length]);
        }
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn spread_block(padded: &Padded, start: usize, taps: &[Tap]) -> [[f32; BLOCK]; 3] {
    let at = |plane: usize, from: usize| -> [f32; BLOCK] {
        let mut values = [0.0; BLOCK];
        values.copy_from_slice(&padded.planes[plane][from..from + BLOCK]);
        values
    };
    let (own, own_share) = (at(3, start), at(4, start));
    let (mut sums, mut total) = ([[0.0f32; BLOCK]; 3], [0.0f32; BLOCK]);
    for tap in taps {
        let from = start.wrapping_add_signed(tap.offset);
        let (near, share, colors) = (at(3, from), at(4, from), [0, 1, 2].map(|k| at(k, from)));
        for i in 0..BLOCK {
            let hidden = (near[i] > own[i]) & (near[i].abs() > own[i].abs());
            let width = if hidden { own[i].abs() } else { near[i].abs() };
            let share = if hidden { own_share[i] } else { share[i] };
            // Of NaN this is 0.
            let weight = clamp(width + 0.5 - tap.distance, 0.0, 1.0) * share;
            total[i] += weight;
            for k in 0..3 {
                sums[k][i] += weight * colors[k][i];
            }
        }
    }
    for k in 0..3 {
        for i in 0..BLOCK {
            sums[k][i] = if own[i].is_nan() { 0.0 } else { sums[k][i] / total[i] };
        }
    }
    sums
}
