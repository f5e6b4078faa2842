//! Sums of plane waves over the wall of a tube, see `vrcaps.organ.waves`.

use crate::pool::detached;
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Number of points that one thread sums at a time.
const PART: usize = 4096;

/// Sum over l of the imaginary part of T_l(s) exp(i l θ), at arc lengths s [m] and angles θ [rad].
///
/// `tables` [rows l 2] are the real and imaginary parts of T_l at even arc lengths from the minimum
/// of `arc_length`, `step` apart [m]; values between them are linear.
///
/// # Errors
/// If arrays differ in length, or an arc length lies beyond the tables.
#[pyfunction]
pub fn sum_wave_tables<'py>(
    py: Python<'py>,
    tables: PyReadonlyArray3<'py, f64>,
    step: f64,
    arc_length: PyReadonlyArray1<'py, f64>,
    theta: PyReadonlyArray1<'py, f64>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let [rows, lobes, 2] = tables.shape()[..] else {
        return Err(PyValueError::new_err("Tables must be of shape (rows, lobes, 2)."));
    };
    let (tables, arc_length, theta) =
        (tables.as_slice()?, arc_length.as_slice()?, theta.as_slice()?);
    if arc_length.len() != theta.len() {
        return Err(PyValueError::new_err("There must be as many angles as arc lengths."));
    }
    let start = arc_length.iter().fold(f64::INFINITY, |a, &b| a.min(b));
    let end = arc_length.iter().fold(start, |a, &b| a.max(b));
    let last = (end - start) / step;
    if !arc_length.is_empty() && (last.is_nan() || last >= rows as f64 - 1.0) {
        return Err(PyValueError::new_err("An arc length lies beyond the tables."));
    }
    let mut sums = vec![0.0; theta.len()];
    detached(py, || {
        let parts = arc_length.par_chunks(PART).zip(theta.par_chunks(PART));
        sums.par_chunks_mut(PART).zip(parts).for_each(|(sums, (arc_length, theta))| {
            for (sum, (s, theta)) in sums.iter_mut().zip(arc_length.iter().zip(theta)) {
                let place = (s - start) / step;
                let (row, (sine, cosine)) = (place as usize, libm::sincos(*theta));
                let (own, next) = tables[2 * lobes * row..].split_at(2 * lobes);
                *sum = interpolate(own, &next[..2 * lobes], place - row as f64, (cosine, sine));
            }
        });
    });
    Ok(sums.into_pyarray(py))
}

/// Sum of the waves of a point between two rows, given exp(i θ) of the point.
fn interpolate(own: &[f64], next: &[f64], between: f64, once: (f64, f64)) -> f64 {
    let (mut sum, mut winding) = (0.0, (1.0, 0.0));
    for (own, next) in own.chunks_exact(2).zip(next.chunks_exact(2)) {
        let [real, imaginary] = [0, 1].map(|k| own[k] + between * (next[k] - own[k]));
        sum += real * winding.1 + imaginary * winding.0;
        winding =
            (winding.0 * once.0 - winding.1 * once.1, winding.0 * once.1 + winding.1 * once.0);
    }
    sum
}
