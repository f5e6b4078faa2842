//! Diffusion of light in the tissue of a wall, in image space (Jimenez et al., ACM TAP 6(4), 2009).
//!
//! Light leaves tissue up to a millimeter from where it enters, red light farthest. Narrow shadows
//! between folds are therefore soft and red, not black. The radiance of a pixel becomes the weighted
//! mean over pixels near it, along rows and then along columns. Weights fall with the distance
//! between the points of the wall, so that light does not pass from a fold to one behind it.

use crate::simd::f32x64::{LANES, max, min};
use numpy::ndarray::{ArrayViewMut3, Axis};
use rayon::prelude::*;

/// Radius of the kernel (1 − r²/R²)² relative to its standard deviation along an axis: √7.
const RADIUS: f32 = 2.645_751_3;
/// Fraction of the light that diffuses; the rest leaves next to the point where it enters. By eye.
const SHARE: f32 = 0.65;
/// Number of samples on either side of a pixel.
const SAMPLES: i32 = 4;
/// Maximum radius of the kernel in the image [px].
const WIDEST: f32 = 16.0;

/// Color of a pixel.
type Color = [f32; 3];
/// Color of a pixel, and its distance along its ray [m]; read together in any order.
type Pixel = [f32; 4];

/// Points of a wall in an image.
pub struct Points<'a> {
    /// Rows and columns.
    pub size: (usize, usize),
    /// Distance along each ray [m]; NaN where light does not diffuse.
    pub distance: &'a [f32],
    /// Pixels per radian.
    pub focal: f32,
}

impl Points<'_> {
    /// Diffuses light in planes [3 h w], in place, by standard deviations along an axis [m].
    pub fn diffuse(&self, planes: &mut ArrayViewMut3<'_, f32>, deviations: Color) {
        let columns = self.size.1;
        let mut pixels = vec![[0.0; 4]; self.distance.len()];
        pixels.par_chunks_mut(columns).enumerate().for_each(|(y, row)| {
            for (x, pixel) in row.iter_mut().enumerate() {
                let [red, green, blue] = [0, 1, 2].map(|k| planes[[k, y, x]]);
                *pixel = [red, green, blue, self.distance[y * columns + x]];
            }
        });
        let diffused = self.along(&self.along(&pixels, deviations, false), deviations, true);
        let mut lines: Vec<_> = planes.axis_iter_mut(Axis(1)).collect();
        lines.par_iter_mut().enumerate().for_each(|(y, line)| {
            for x in 0..columns {
                let (own, diffused) = (pixels[y * columns + x], diffused[y * columns + x]);
                for k in 0..3 {
                    line[[k, x]] = own[k] + SHARE * (diffused[k] - own[k]);
                }
            }
        });
    }

    /// Weighted means along the rows of an image, or along its columns.
    fn along(&self, pixels: &[Pixel], deviations: Color, is_column: bool) -> Vec<Pixel> {
        let mut means = pixels.to_vec();
        means.par_chunks_mut(self.size.1).enumerate().for_each(|(y, row)| {
            for (k, chunk) in row.chunks_mut(LANES).enumerate() {
                write_means(self, pixels, deviations, (y, k * LANES), is_column, chunk);
            }
        });
        means
    }
}

/// Writes the weighted means around some pixels of a row, from a row and column.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn write_means(
    points: &Points<'_>,
    pixels: &[Pixel],
    deviations: Color,
    (row, column): (usize, usize),
    is_column: bool,
    means: &mut [Pixel],
) {
    let (rows, columns) = points.size;
    let (size, step) = if is_column { (rows, columns) } else { (columns, 1) };
    let first = row * columns + column;
    let widest = deviations.iter().fold(0.0, |a, &b| max(a, b));
    let mut distance = [f32::NAN; LANES];
    for (distance, own) in distance.iter_mut().zip(means.iter()) {
        *distance = own[3];
    }
    let (mut footprint, mut spacing) = ([0.0; LANES], [0.0; LANES]);
    let (mut per_square, mut is_spread) = ([[0.0; LANES]; 3], [false; LANES]);
    for i in 0..LANES {
        footprint[i] = distance[i] / points.focal;
        spacing[i] = min(RADIUS * widest / footprint[i], WIDEST) / (SAMPLES + 1) as f32;
        is_spread[i] = spacing[i] * SAMPLES as f32 >= 1.0 && !distance[i].is_nan();
        for k in 0..3 {
            let radius = max(min(RADIUS * deviations[k], WIDEST * footprint[i]), 1e-9);
            per_square[k][i] = 1.0 / (radius * radius);
        }
    }
    if !is_spread.contains(&true) {
        return;
    }
    let (mut sum, mut whole) = ([[0.0; LANES]; 3], [[1.0; LANES]; 3]);
    for (i, own) in means.iter().enumerate() {
        for k in 0..3 {
            sum[k][i] = own[k];
        }
    }
    let (mut along, mut across, mut light) = ([0.0; LANES], [0.0; LANES], [[0.0; LANES]; 3]);
    let own: [i32; LANES] = std::array::from_fn(|i| (first + i.min(means.len() - 1)) as i32);
    let (mut other, mut is_inside) = (own, [false; LANES]);
    for sample in 0..2 * SAMPLES {
        let sign = if sample % 2 == 0 { -1 } else { 1 };
        for i in 0..LANES {
            let offset = sign * ((sample / 2 + 1) as f32 * spacing[i] + 0.5) as i32;
            let at = (if is_column { row } else { column + i }) as i32 + offset;
            is_inside[i] = is_spread[i] & (at >= 0) & (at < size as i32);
            other[i] =
                if is_inside[i] { (first + i) as i32 + offset * step as i32 } else { own[i] };
            across[i] = offset as f32 * footprint[i];
        }
        for i in 0..LANES {
            let [red, green, blue, distance] = pixels[other[i] as usize];
            (light[0][i], light[1][i], light[2][i], along[i]) = (red, green, blue, distance);
        }
        for i in 0..LANES {
            along[i] = if is_inside[i] { along[i] - distance[i] } else { f32::NAN };
        }
        for k in 0..3 {
            for i in 0..LANES {
                let square = across[i] * across[i] + along[i] * along[i];
                let near = max(1.0 - square * per_square[k][i], 0.0); // 0 if it is NaN
                sum[k][i] += near * near * light[k][i];
                whole[k][i] += near * near;
            }
        }
    }
    for (i, mean) in means.iter_mut().enumerate() {
        if is_spread[i] {
            for k in 0..3 {
                mean[k] = sum[k][i] / whole[k][i];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use numpy::ndarray::Array3;

    const SIZE: usize = 41;
    const DEVIATIONS: Color = [0.5e-3, 0.3e-3, 0.2e-3];

    /// A bright point in the middle of a plane at a distance of 10 mm, after diffusion.
    fn spread(distance: &[f32]) -> Array3<f32> {
        let mut image = Array3::zeros((3, SIZE, SIZE));
        for k in 0..3 {
            image[[k, SIZE / 2, SIZE / 2]] = 1.0;
        }
        let points = Points { size: (SIZE, SIZE), distance, focal: 100.0 };
        points.diffuse(&mut image.view_mut(), DEVIATIONS);
        image
    }

    #[test]
    fn a_share_of_a_point_spreads_by_the_given_deviations() {
        let image = spread(&[0.01; SIZE * SIZE]);
        for (k, deviation) in DEVIATIONS.into_iter().enumerate() {
            let (mut whole, mut square) = (0.0, 0.0);
            for y in 0..SIZE {
                for x in 0..SIZE {
                    let value = image[[k, y, x]];
                    whole += value;
                    square += value * (x as f32 - 20.0).powi(2) * 1e-8;
                }
            }
            assert!((whole - 1.0).abs() < 1e-3, "{k}: {whole}");
            let found = (square / SHARE).sqrt();
            assert!((found / deviation - 1.0).abs() < 0.2, "{k}: {found} {deviation}");
        }
    }

    #[test]
    fn light_stays_on_its_surface_and_off_other_pixels() {
        let mut distance = [0.01; SIZE * SIZE];
        for (pixel, distance) in distance.iter_mut().enumerate() {
            match pixel % SIZE {
                0..=18 => *distance = 0.013,
                22.. => *distance = f32::NAN,
                _ => {}
            }
        }
        let image = spread(&distance);
        for y in 0..SIZE {
            for x in (0..=18).chain(22..SIZE) {
                assert_eq!(image[[0, y, x]], 0.0);
            }
        }
        assert!(image[[0, SIZE / 2, SIZE / 2]] < 0.7);
        assert!(image[[0, SIZE / 2 + 3, SIZE / 2]] > 0.0);
    }
}
