//! Diffusion of light in the tissue of a wall, in image space (Jimenez et al., ACM TAP 6(4), 2009).
//!
//! Light leaves tissue up to a millimeter from where it enters, red light farthest. Narrow shadows
//! between folds are therefore soft and red, not black. The radiance of a pixel becomes the weighted
//! mean over pixels near it, along rows and then along columns. Weights fall with the distance
//! between the points of the wall, so that light does not pass from a fold to one behind it.

use crate::simd::f32x64::{max, min};
use numpy::ndarray::ArrayViewMut3;
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
        let color = |pixel: usize| [0, 1, 2].map(|k| planes[[k, pixel / columns, pixel % columns]]);
        let colors: Vec<Color> = (0..self.distance.len()).map(color).collect();
        let diffused = self.along(&self.along(&colors, deviations, false), deviations, true);
        for (pixel, (own, diffused)) in colors.into_iter().zip(diffused).enumerate() {
            for k in 0..3 {
                let mixed = own[k] + SHARE * (diffused[k] - own[k]);
                planes[[k, pixel / columns, pixel % columns]] = mixed;
            }
        }
    }

    /// Weighted means along the rows of an image, or along its columns.
    fn along(&self, colors: &[Color], deviations: Color, is_column: bool) -> Vec<Color> {
        let (rows, columns) = self.size;
        let mean = |pixel: usize| {
            let (at, size, step) = if is_column {
                (pixel / columns, rows, columns)
            } else {
                (pixel % columns, columns, 1)
            };
            self.mean(colors, deviations, (pixel, at as i32, size as i32, step as i32))
        };
        (0..colors.len()).into_par_iter().with_min_len(4096).map(mean).collect()
    }

    /// Weighted mean around a pixel, given its position in a line of a length, and its step.
    #[inline(always)]
    fn mean(
        &self,
        colors: &[Color],
        deviations: Color,
        (pixel, at, size, step): (usize, i32, i32, i32),
    ) -> Color {
        let (own, distance) = (colors[pixel], self.distance[pixel]);
        let footprint = distance / self.focal;
        let most = WIDEST * footprint;
        let per_square = deviations.map(|deviation| {
            let radius = max(min(RADIUS * deviation, most), 1e-9);
            1.0 / (radius * radius)
        });
        let widest = deviations.iter().fold(0.0, |a, &b| max(a, b));
        let spacing = min(RADIUS * widest / footprint, WIDEST) / (SAMPLES + 1) as f32;
        if distance.is_nan() || spacing * (SAMPLES as f32) < 1.0 {
            return own;
        }
        let (mut sum, mut whole) = (own, [1.0; 3]);
        for sample in 1..=SAMPLES {
            let offset = (sample as f32 * spacing + 0.5) as i32;
            for offset in [-offset, offset] {
                if at + offset < 0 || at + offset >= size {
                    continue;
                }
                let other = (pixel as i32 + offset * step) as usize;
                let (across, along) = (offset as f32 * footprint, self.distance[other] - distance);
                let square = across * across + along * along;
                for k in 0..3 {
                    let near = max(1.0 - square * per_square[k], 0.0); // 0 if it is NaN
                    sum[k] += near * near * colors[other][k];
                    whole[k] += near * near;
                }
            }
        }
        [0, 1, 2].map(|k| sum[k] / whole[k])
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
