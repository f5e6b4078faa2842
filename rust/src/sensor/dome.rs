//! An image seen through what lies on the capsule's dome: films that absorb and scatter, and drops
//! that are lenses.

use super::planes::{planes_array, size};
use numpy::{
    PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// A film: for each colour the share of light that it does not absorb [3 h w], and the share of that
/// which it does not scatter [h w]. What it scatters is spread evenly over the pixels that are lit,
/// whose number is given.
type Film<'py> = (PyReadonlyArray3<'py, f32>, PyReadonlyArray2<'py, f32>, f64);

/// Drops: numbers of the pixels that they change [m], of the pixels each sees instead [m k], and
/// how much each of those counts [m k].
type Drops<'py> =
    (PyReadonlyArray1<'py, u32>, PyReadonlyArray2<'py, u32>, PyReadonlyArray2<'py, f32>);

/// Planes [3 h w] as they are seen through drops and a film.
#[pyfunction]
#[pyo3(signature = (planes, film=None, drops=None))]
pub fn through_dome<'py>(
    py: Python<'py>,
    planes: PyReadonlyArray3<'py, f32>,
    film: Option<Film<'py>>,
    drops: Option<Drops<'py>>,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let (height, width) = size(&planes)?;
    let area = height * width;
    let source = planes.as_slice()?;
    let mut out = source.to_vec();
    if let Some((pixels, seen, weights)) = &drops {
        let (pixels, seen, weights) = (pixels.as_slice()?, seen.as_slice()?, weights.as_slice()?);
        let count = if pixels.is_empty() { 0 } else { seen.len() / pixels.len() };
        let fits = seen.len() == pixels.len() * count && seen.len() == weights.len();
        let inside = |&pixel: &u32| (pixel as usize) < area;
        if !(fits && pixels.iter().all(inside) && seen.iter().all(inside)) {
            return Err(PyValueError::new_err(
                "Drops need as many sources for each of the pixels.",
            ));
        }
        py.detach(|| {
            out.par_chunks_mut(area).zip(source.par_chunks(area)).for_each(|(into, from)| {
                refract(into, from, pixels, (seen, weights, count));
            });
        });
    }
    if let Some((absorbed, clear, lit)) = &film {
        if absorbed.shape() != [3, height, width] || clear.shape() != [height, width] {
            return Err(PyValueError::new_err("A film must be of the planes' shape (h, w)."));
        }
        let (left, clear) = (absorbed.as_slice()?, clear.as_slice()?);
        py.detach(|| {
            let planes = out.par_chunks_mut(area).zip(left.par_chunks(area));
            planes.zip(source.par_chunks(area)).for_each(|((into, left), from)| {
                cover(into, (left, clear), mean(from, *lit));
            });
        });
    }
    Ok(planes_array(py, out, (height, width)))
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn refract(
    into: &mut [f32],
    from: &[f32],
    pixels: &[u32],
    (seen, weights, count): (&[u32], &[f32], usize),
) {
    let rays = seen.chunks_exact(count.max(1)).zip(weights.chunks_exact(count.max(1)));
    for (&pixel, (seen, weights)) in pixels.iter().zip(rays) {
        let mut sum = 0.0;
        for (&place, &weight) in seen.iter().zip(weights) {
            sum += weight * from[place as usize];
        }
        into[pixel as usize] = sum;
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn cover(into: &mut [f32], (left, clear): (&[f32], &[f32]), veil: f32) {
    for ((value, &left), &clear) in into.iter_mut().zip(left).zip(clear) {
        *value = left * (clear * (*value - veil) + veil);
    }
}

/// Sum over the lit pixels by their number; sixteen partial sums keep the loop a vector loop.
fn mean(plane: &[f32], lit: f64) -> f32 {
    let mut total = 0.0f64;
    for row in plane.chunks(256) {
        let mut partial = [0.0f32; 16];
        for part in row.chunks(16) {
            for (sum, value) in partial.iter_mut().zip(part) {
                *sum += value;
            }
        }
        total += partial.iter().map(|&x| f64::from(x)).sum::<f64>();
    }
    (total / lit.max(1.0)) as f32
}
