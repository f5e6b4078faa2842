//! Rasterization: the face at each texel of a chart layout, with padding around the charts.

use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering};

/// Marker of a texel without a face.
pub const NO_FACE: u32 = u32::MAX;

/// Texture size in texels.
#[derive(Clone, Copy)]
pub struct Size {
    /// Columns, along u.
    pub width: usize,
    /// Rows, against v (row 0 is v = 1).
    pub height: usize,
}

/// Corners of a face in texel coordinates; texel centers are integers.
pub type Corners = [[f64; 2]; 3];

impl Size {
    /// Texel coordinates from texture coordinates.
    pub fn corners(self, uv: &[f64]) -> Corners {
        [0, 1, 2].map(|c| {
            [uv[2 * c] * self.width as f64 - 0.5, (1.0 - uv[2 * c + 1]) * self.height as f64 - 0.5]
        })
    }
}

/// Twice the signed area of a face in texels.
pub fn doubled_area(t: &Corners) -> f64 {
    (t[1][0] - t[0][0]) * (t[2][1] - t[0][1]) - (t[2][0] - t[0][0]) * (t[1][1] - t[0][1])
}

/// Index of the face that covers each texel's center (the lowest of several), and around the
/// charts, up to `padding` texels away, that of the nearest covered texel.
pub fn face_map(uv: &[f64], size: Size, padding: usize) -> Vec<u32> {
    let map: Vec<AtomicU32> =
        (0..size.width * size.height).into_par_iter().map(|_| AtomicU32::new(NO_FACE)).collect();
    uv.par_chunks_exact(6)
        .enumerate()
        .for_each(|(face, uv)| cover(&map, size, &size.corners(uv), face as u32));
    let covered: Vec<u32> = map.into_par_iter().map(AtomicU32::into_inner).collect();
    pad(&covered, size, padding)
}

fn cover(map: &[AtomicU32], size: Size, t: &Corners, face: u32) {
    let area = doubled_area(t);
    if area == 0.0 || !area.is_finite() {
        return;
    }
    let bound = |axis: usize| {
        let values = [t[0][axis], t[1][axis], t[2][axis]];
        let low = values.iter().copied().fold(f64::INFINITY, f64::min);
        let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        (low.ceil() as i64, high.floor() as i64)
    };
    let ((x0, x1), (y0, y1)) = (bound(0), bound(1));
    let turn = area.signum();
    for y in y0..=y1 {
        let row = wrapped(y, size.height) * size.width;
        // Side of a texel relative to each edge: `rise - (x - start) * run`.
        let edges = [0, 1, 2].map(|c| {
            let (a, b) = (t[c], t[(c + 1) % 3]);
            ((b[0] - a[0]) * (y as f64 - a[1]), a[0], b[1] - a[1])
        });
        for x in x0..=x1 {
            let is_inside = edges
                .iter()
                .all(|&(rise, start, run)| (rise - (x as f64 - start) * run) * turn >= -1e-9);
            if is_inside {
                let texel = &map[row + wrapped(x, size.width)];
                texel.fetch_min(face, Ordering::Relaxed);
            }
        }
    }
}

/// Index of a texel that wraps at the texture's border, without division where possible.
#[inline(always)]
fn wrapped(value: i64, period: usize) -> usize {
    let inside = usize::try_from(value).is_ok_and(|value| value < period);
    if inside { value as usize } else { value.rem_euclid(period as i64) as usize }
}

/// Offset that marks a texel without a covered texel near it in its row; it exceeds any padding.
const FAR: i8 = i8::MAX;

/// Exact Euclidean dilation by rows, then columns (Saito and Toriwaki 1994), with wrap-around.
fn pad(covered: &[u32], size: Size, padding: usize) -> Vec<u32> {
    let width = size.width;
    let mut along_row = vec![FAR; covered.len()];
    along_row
        .par_chunks_exact_mut(width)
        .zip(covered.par_chunks_exact(width))
        .for_each(|(offsets, row)| row_offsets(offsets, row, padding));
    let mut map = covered.to_vec();
    map.par_chunks_exact_mut(width).enumerate().for_each(|(y, texels)| {
        pad_row(texels, covered, &along_row, size, (y, padding));
    });
    map
}

/// Assigns to the uncovered texels of row `y` the nearest covered texel of the rows around it.
fn pad_row(
    texels: &mut [u32],
    covered: &[u32],
    along_row: &[i8],
    size: Size,
    (y, padding): (usize, usize),
) {
    let reach = padding as i64;
    let rows: Vec<(i64, usize)> = (-reach..=reach)
        .map(|dy| (dy * dy, wrapped(y as i64 + dy, size.height) * size.width))
        .collect();
    for (x, texel) in texels.iter_mut().enumerate().filter(|(_, texel)| **texel == NO_FACE) {
        let mut best = reach * reach + 1;
        for &(square, row) in &rows {
            let dx = i64::from(along_row[row + x]);
            if dx * dx + square < best {
                best = dx * dx + square;
                *texel = covered[row + wrapped(x as i64 + dx, size.width)];
            }
        }
    }
}

fn row_offsets(offsets: &mut [i8], row: &[u32], padding: usize) {
    let width = row.len();
    if row.iter().all(|&face| face == NO_FACE) {
        return;
    }
    let mut sweep = |step: i64| {
        let mut gap = padding + 1;
        for turn in (0..width).chain((0..padding).map(|turn| turn % width)) {
            let x = if step > 0 { turn } else { width - 1 - turn };
            gap = if row[x] == NO_FACE { gap + 1 } else { 0 };
            if gap <= padding && (gap as i64) < i64::from(offsets[x]).abs() {
                offsets[x] = (-step * gap as i64) as i8;
            }
        }
    };
    sweep(1);
    sweep(-1);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn padding_takes_the_nearest_covered_texel_across_the_border() {
        let size = Size { width: 16, height: 12 };
        let mut covered = vec![NO_FACE; 16 * 12];
        covered[5 * 16 + 1] = 3;
        covered[5 * 16 + 9] = 4;
        let padded = pad(&covered, size, 4);
        for y in 0..12i64 {
            for x in 0..16i64 {
                let wrapped = |to: i64| {
                    let dx = (x - to).rem_euclid(16).min((to - x).rem_euclid(16));
                    dx * dx + (y - 5) * (y - 5)
                };
                let (left, right) = (wrapped(1), wrapped(9));
                let face = padded[(y * 16 + x) as usize];
                if left.min(right) > 16 {
                    assert_eq!(face, NO_FACE);
                } else if left != right {
                    assert_eq!(face, if left < right { 3 } else { 4 });
                }
            }
        }
    }

    #[test]
    fn a_square_of_two_faces_is_covered_without_gaps() {
        let size = Size { width: 32, height: 32 };
        let uv = [0.75, 0.25, 1.25, 0.25, 1.25, 0.75, 0.75, 0.25, 1.25, 0.75, 0.75, 0.75];
        let map = face_map(&uv, size, 0);
        assert_eq!(map.iter().filter(|&&face| face != NO_FACE).count(), 256);
    }
}
