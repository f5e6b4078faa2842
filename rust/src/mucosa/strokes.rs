//! Villi as leaves side by side, and the dark strokes between them.

use super::noise::{Lattice, Vec3, smoothstep};
use crate::simd::f32x64::{LANES, Lane, Lane3, at, dot};

/// Direction in which leaves and strokes are longer: villi of the upper small bowel are leaves and
/// ridges side by side. Seen along it, they are as wide as long.
const RIDGE: Vec3 = [0.48, 0.64, 0.6];
/// Length of villi relative to their width.
pub const LEAF: f32 = 2.2;
/// Length of strokes relative to their width; strokes of 0.15 by 0.5 mm are typical of capsule
/// images.
const STROKE: f32 = 3.5;
/// Values of gradient noise at the outline of a stroke and where it is deepest.
const EDGES: [f32; 2] = [0.0, 1.4];
/// Mean depth of strokes with these edges.
const MEAN: f32 = 0.2;
/// RMS slope of the depth of strokes times the spacing of the lattice.
pub const STROKE_SLOPE: f32 = 2.4;

/// Strokes at random places.
pub struct Strokes(Lattice);

impl Strokes {
    /// Strokes where the noise of a lattice is positive.
    pub fn new(lattice: Lattice) -> Self {
        Self(lattice)
    }

    /// Depth at points, 0 between strokes to 1, less its mean.
    #[inline(always)]
    pub fn depths(&self, p: &Lane3) -> Lane {
        let mut depths = self.0.gradients(&leaf_space(p, STROKE));
        for depth in &mut depths {
            *depth = smoothstep(EDGES[0], EDGES[1], *depth) - MEAN;
        }
        depths
    }
}

/// Points in a space in which leaves, `leaf` times as long as wide, are cells of equal area.
#[inline(always)]
pub fn leaf_space(p: &Lane3, leaf: f32) -> Lane3 {
    let (across, change) = (leaf.sqrt(), 1.0 / leaf.sqrt() - leaf.sqrt());
    let mut result = [[0.0; LANES]; 3];
    for i in 0..LANES {
        let point = at(p, i);
        let along = change * dot(point, RIDGE);
        for k in 0..3 {
            result[k][i] = across * point[k] + along * RIDGE[k];
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mucosa::noise::uniform;

    #[test]
    fn depths_have_zero_mean() {
        let strokes = Strokes::new(Lattice::new(3, 1.0));
        let mut sum = 0.0;
        let lanes = 2000;
        for lane in 0..lanes {
            let mut points = [[0.0; LANES]; 3];
            for (axis, line) in points.iter_mut().enumerate() {
                for (i, value) in line.iter_mut().enumerate() {
                    let number = (lane * LANES + i) as u32;
                    *value = uniform(7, number, axis as u32) * 300.0 - 150.0;
                }
            }
            sum += strokes.depths(&points).iter().sum::<f32>();
        }
        let mean = sum / (lanes * LANES) as f32;
        assert!(mean.abs() < 0.01, "{mean}");
    }
}
