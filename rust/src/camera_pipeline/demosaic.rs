//! Demosaicing: colors of all pixels from a mosaic of one color each.

use super::planes::{Line, planes_array, rows};
use crate::pool::on_pool;
use numpy::{PyArray3, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Planes [3 h w] of a mosaic [1 h w] whose 2 × 2 sites have `colors`.
///
/// Each missing color is a linear function of 5 × 5 sites, with the curvature of the known color
/// (Malvar, He, Cutler, ICASSP 2004). The mosaic is mirrored at its edge.
#[pyfunction]
pub fn demosaic<'py>(
    py: Python<'py>,
    mosaic: PyReadonlyArray3<'py, f32>,
    colors: [usize; 4],
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let [1, height, width] = mosaic.shape()[..] else {
        return Err(PyValueError::new_err("A mosaic must be of shape (1, h, w)."));
    };
    if height < 3 || width < 3 || colors.iter().any(|&c| c > 2) {
        return Err(PyValueError::new_err("A mosaic has 3 by 3 sites or more of colors 0, 1, 2."));
    }
    let source = mosaic.as_slice()?;
    let mut out = vec![0.0; 3 * height * width];
    on_pool(py, || {
        let padded = mirrored_about(source, (height, width));
        rows(&mut out, (height, width)).into_par_iter().enumerate().for_each(|(y, mut row)| {
            demosaic_line(&padded, y, colors, &mut row);
        });
    });
    Ok(planes_array(py, out, (height, width)))
}

/// A mosaic padded by two sites on each side.
pub fn mirrored_about(mosaic: &[f32], (height, width): (usize, usize)) -> Vec<f32> {
    let stride = width + 4;
    let mut padded = vec![0.0; (height + 4) * stride];
    padded.par_chunks_mut(stride).enumerate().for_each(|(y, line)| {
        let from = &mosaic[mirrored(y as isize - 2, height) * width..][..width];
        line[2..width + 2].copy_from_slice(from);
        for k in [0, 1, width + 2, width + 3] {
            line[k] = from[mirrored(k as isize - 2, width)];
        }
    });
    padded
}

/// Colors of one row of a mosaic padded by `mirrored_about`.
pub fn demosaic_line(padded: &[f32], y: usize, colors: [usize; 4], row: &mut Line<'_>) {
    let stride = row[0].len() + 4;
    let lines = [0, 1, 2, 3, 4].map(|k| &padded[(y + k) * stride..][..stride]);
    demosaic_row(lines, [colors[y % 2 * 2], colors[y % 2 * 2 + 1]], row);
}

/// Index mirrored about the first and the last, which preserves its color.
fn mirrored(index: isize, count: usize) -> usize {
    let last = count as isize - 1;
    let index = index.abs();
    (if index > last { 2 * last - index } else { index }) as usize
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn demosaic_row(lines: [&[f32]; 5], colors: [usize; 2], out: &mut Line<'_>) {
    let width = out[0].len();
    let [a, b, c, d, e] = lines.map(|line| &line[..width + 4]);
    let [mut green, mut along, mut across, mut diagonal] = [0; 4].map(|_| vec![0.0f32; width]);
    for x in 0..width {
        let own = c[x + 2];
        let (sides, ends) = (c[x + 1] + c[x + 3], b[x + 2] + d[x + 2]);
        let (far_sides, far_ends) = (c[x] + c[x + 4], a[x + 2] + e[x + 2]);
        let corners = b[x + 1] + b[x + 3] + d[x + 1] + d[x + 3];
        green[x] = (4.0 * own + 2.0 * (sides + ends) - far_sides - far_ends) * 0.125;
        let level = 5.0 * own - corners;
        along[x] = (level + 4.0 * sides - far_sides + 0.5 * far_ends) * 0.125;
        across[x] = (level + 4.0 * ends - far_ends + 0.5 * far_sides) * 0.125;
        diagonal[x] = (6.0 * own + 2.0 * corners - 1.5 * (far_sides + far_ends)) * 0.125;
    }
    // Color of this row's sites other than green.
    let here = if colors[0] == 1 { colors[1] } else { colors[0] };
    let own = &c[2..];
    for (color, plane) in out.iter_mut().enumerate() {
        for (first, site) in colors.into_iter().enumerate() {
            let from: &[f32] = match site {
                _ if color == site => own,
                1 if color == here => &along,
                1 => &across,
                _ if color == 1 => &green,
                _ => &diagonal,
            };
            for x in (first..width).step_by(2) {
                plane[x] = from[x];
            }
        }
    }
}
