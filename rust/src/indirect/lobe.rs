//! Directions that share the power of a lobe evenly.

use crate::lanes::*;
use std::f32::consts::TAU;

/// Directions about an axis, one in each of side² cells of equal power of a lobe cosᵐ.
///
/// Exponent 1 is what reaches or leaves a matt surface (Malley's method); 0 is a whole sphere, as
/// for an LED. Cells lie in rings and columns; `turn` [rad] turns all about the axis.
pub struct Lobe {
    frame: [Vec3; 3],
    exponent: f32,
    side: usize,
    turn: f32,
}

impl Lobe {
    /// A lobe about a unit axis.
    #[inline(always)]
    pub fn new(axis: Vec3, exponent: f32, side: usize, turn: f32) -> Self {
        let least = if axis[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        let right = normalize(cross(axis, least));
        Lobe { frame: [right, cross(axis, right), axis], exponent, side, turn }
    }

    /// A lobe in which number `k` of many is turned against its neighbours, so that their errors
    /// differ: by the golden ratio.
    #[inline(always)]
    pub fn turned(axis: Vec3, exponent: f32, side: usize, k: usize) -> Self {
        Lobe::new(axis, exponent, side, TAU * ((k % 1024) as f32 * 0.618_034).fract())
    }

    /// Unit direction in the middle of a cell.
    #[inline(always)]
    pub fn direction(&self, ring: usize, column: usize) -> Vec3 {
        let [right, down, axis] = self.frame;
        // cosᵐ has the share 1 − cosᵐ⁺¹ of its power inside a cone.
        let inside = (ring as f32 + 0.5) / self.side as f32;
        let up = match self.exponent {
            0.0 => 1.0 - 2.0 * inside,
            1.0 => (1.0 - inside).sqrt(),
            m => pow(1.0 - inside, 1.0 / (m + 1.0)),
        };
        let across = max(1.0 - up * up, 0.0).sqrt();
        let angle = self.turn + TAU * (column as f32 + 0.5) / self.side as f32;
        let (sine, cosine) = angle.sin_cos();
        let across = add(scale(right, across * cosine), scale(down, across * sine));
        add(across, scale(axis, up))
    }

    /// Directions of all cells, ring by ring.
    #[inline(always)]
    pub fn directions(&self) -> impl Iterator<Item = Vec3> {
        (0..self.side * self.side).map(|i| self.direction(i / self.side, i % self.side))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_height_follows_from_the_lobe() {
        // The mean of cos under cosᵐ is (m + 1) / (m + 2); over a sphere it is 0.
        for (exponent, mean) in [(0.0, 0.0), (1.0, 2.0 / 3.0), (2.5, 3.5 / 4.5)] {
            let axis = normalize([0.3, -0.5, 0.7]);
            let lobe = Lobe::new(axis, exponent, 32, 0.4);
            let sum: f32 = lobe.directions().map(|d| dot(d, axis)).sum();
            assert!((sum / 1024.0 - mean).abs() < 2e-4, "{exponent}");
            assert!(lobe.directions().all(|d| (dot(d, d) - 1.0).abs() < 1e-5));
        }
    }
}
