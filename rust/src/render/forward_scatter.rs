//! Blur by forward scattering of light on its path to the camera: a fraction of each pixel's light
//! is spread by a Gaussian, the rest stays sharp (Wells, J. Opt. Soc. Am. 59(6), 1969).

use crate::camera_pipeline::bloom::convolve;
use crate::pool::on_pool;
use numpy::{PyReadonlyArray2, PyReadwriteArray3, PyUntypedArrayMethods, ndarray::Axis};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Standard deviation beyond which the image is blurred at half its resolution [px].
const WIDE: f32 = 4.0;

/// Blurs planes [3 h w] in place: a fraction [h w] of each pixel is replaced by the image blurred
/// over lit pixels by a Gaussian of standard deviation `sigma` [px].
#[pyfunction]
pub fn scatter_forward(
    py: Python<'_>,
    mut planes: PyReadwriteArray3<'_, f32>,
    lit: PyReadonlyArray2<'_, bool>,
    fraction: PyReadonlyArray2<'_, f32>,
    sigma: f32,
) -> PyResult<()> {
    let [height, width] = lit.shape()[..] else { unreachable!("two dimensions") };
    let fits = planes.shape() == [3, height, width] && fraction.shape() == [height, width];
    if !fits || height * width == 0 || !(0.0..1e4).contains(&sigma) {
        return Err(PyValueError::new_err("Planes, lit and fraction must be of one size."));
    }
    let (lit, fraction) = (lit.as_slice()?, fraction.as_slice()?);
    let mut image = planes.as_array_mut();
    on_pool(py, || {
        let weights: Vec<f32> = lit.iter().map(|&lit| f32::from(u8::from(lit))).collect();
        let whole = blurred(&weights, (height, width), sigma);
        let mut colors: Vec<_> = image.axis_iter_mut(Axis(0)).collect();
        colors.par_iter_mut().for_each(|plane| {
            let sharp: Vec<f32> =
                plane.iter().zip(lit).map(|(&x, &lit)| if lit { x } else { 0.0 }).collect();
            let soft = blurred(&sharp, (height, width), sigma);
            for (k, value) in plane.iter_mut().enumerate() {
                if lit[k] && whole[k] > 0.0 {
                    *value += fraction[k] * (soft[k] / whole[k] - *value);
                }
            }
        });
    });
    Ok(())
}

/// Convolution with a Gaussian, 0 outside the image; at half the resolution if it is wide.
fn blurred(image: &[f32], (height, width): (usize, usize), sigma: f32) -> Vec<f32> {
    if sigma <= WIDE || height < 4 || width < 4 {
        return convolved(image, (height, width), sigma);
    }
    let half = (height.div_ceil(2), width.div_ceil(2));
    let mut small = vec![0.0; half.0 * half.1];
    for (y, row) in image.chunks_exact(width).enumerate() {
        for (x, value) in row.iter().enumerate() {
            small[y / 2 * half.1 + x / 2] += 0.25 * value;
        }
    }
    let small = blurred(&small, half, 0.5 * sigma);
    let mut out = vec![0.0; height * width];
    let places: Vec<_> = (0..width).map(|x| between(x, half.1)).collect();
    for (y, row) in out.chunks_exact_mut(width).enumerate() {
        let (top, bottom, v) = between(y, half.0);
        let (top, bottom) = (&small[top * half.1..][..half.1], &small[bottom * half.1..][..half.1]);
        let line: Vec<f32> =
            top.iter().zip(bottom).map(|(top, bottom)| top + v * (bottom - top)).collect();
        for (value, &(left, right, u)) in row.iter_mut().zip(&places) {
            *value = line[left] + u * (line[right] - line[left]);
        }
    }
    out
}

/// Cells of half the size around a pixel, and the weight of the second: interpolation is linear
/// between the centers of cells.
fn between(fine: usize, count: usize) -> (usize, usize, f32) {
    let at = (0.5 * fine as f32 - 0.25).clamp(0.0, count as f32 - 1.0);
    (at as usize, (at as usize + 1).min(count - 1), at.fract())
}

/// Convolution with a Gaussian truncated at three standard deviations, 0 outside the image.
fn convolved(image: &[f32], (height, width): (usize, usize), sigma: f32) -> Vec<f32> {
    let reach = (3.0 * sigma).ceil() as usize;
    let raw: Vec<f32> = (0..=2 * reach)
        .map(|k| {
            let x = (k as f32 - reach as f32) / sigma.max(1e-3);
            libm::expf(-0.5 * x * x)
        })
        .collect();
    let whole: f32 = raw.iter().sum();
    let kernel: Vec<f32> = raw.iter().map(|w| w / whole).collect();
    let mut tall = vec![0.0; (height + 2 * reach) * width];
    let mut line = vec![0.0; width + 2 * reach];
    for (y, row) in image.chunks_exact(width).enumerate() {
        line[reach..reach + width].copy_from_slice(row);
        convolve(&line, &kernel, 1, &mut tall[(reach + y) * width..][..width]);
    }
    let mut out = vec![0.0; image.len()];
    convolve(&tall, &kernel, width, &mut out);
    out
}
