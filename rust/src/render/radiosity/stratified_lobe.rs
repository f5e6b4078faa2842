//! Stratified directions of equal power in a lobe.

use crate::simd::f32x64::*;
use std::f32::consts::TAU;

/// Directions about an axis, one in each of side² cells of equal power of a lobe cosᵐ.
///
/// Exponent 1 is the light that reaches or leaves a diffuse surface (Malley's method); 0 is a whole
/// sphere, as for an LED. Cells lie in rings and columns.
pub struct Lobe {
    frame: [Vec3; 3],
    exponent: f32,
    side: usize,
    /// Position of its direction in a cell, across rings and around the axis.
    shift: [f32; 2],
}

impl Lobe {
    /// A lobe about a unit axis.
    #[inline(always)]
    pub fn new(axis: Vec3, exponent: f32, side: usize) -> Self {
        let least = if axis[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        let right = normalize(cross(axis, least));
        Lobe { frame: [right, cross(axis, right), axis], exponent, side, shift: [0.5; 2] }
    }

    /// Lobe `k` of many about similar axes, rotated so that their errors differ.
    #[inline(always)]
    pub fn turned(axis: Vec3, exponent: f32, side: usize, k: usize) -> Self {
        let turn = side as f32 * ((k % 1024) as f32 * 0.618_034).fract();
        Lobe { shift: [0.5, turn], ..Lobe::new(axis, exponent, side) }
    }

    /// Lobe `k` of a few that fill each other's gaps, by Roberts' sequence R2.
    #[inline(always)]
    pub fn shifted(axis: Vec3, exponent: f32, side: usize, k: usize) -> Self {
        let shift = [0.754_877_7, 0.569_840_3].map(|step| (0.5 + k as f32 * step).fract());
        Lobe { shift, ..Lobe::new(axis, exponent, side) }
    }

    /// Unit direction in the center of a cell.
    #[inline(always)]
    pub fn direction(&self, ring: usize, column: usize) -> Vec3 {
        let inside = (ring as f32 + self.shift[0]) / self.side as f32;
        self.towards(inside, (column as f32 + self.shift[1]) / self.side as f32)
    }

    /// Unit direction `k` of as many as there are cells, on a spiral (Vogel 1979): its neighbors
    /// are at similar distances in all directions.
    #[inline(always)]
    pub fn on_spiral(&self, k: usize) -> Vec3 {
        let inside = (k as f32 + self.shift[0]) / self.count() as f32;
        self.towards(inside, self.turns(k))
    }

    /// Turns around the axis of direction `k` of the spiral, below 1.
    #[inline(always)]
    pub fn turns(&self, k: usize) -> f32 {
        (k as f32 * 0.618_034 + self.shift[1]).fract()
    }

    /// Number of directions.
    #[inline(always)]
    pub fn count(&self) -> usize {
        self.side * self.side
    }

    /// Unit direction on a cone that contains a fraction `inside` of the power, at `turns` turns
    /// around the axis.
    #[inline(always)]
    fn towards(&self, inside: f32, turns: f32) -> Vec3 {
        let [right, down, axis] = self.frame;
        // cosᵐ has the fraction 1 − cosᵐ⁺¹ of its power inside a cone.
        let up = match self.exponent {
            0.0 => 1.0 - 2.0 * inside,
            1.0 => (1.0 - inside).sqrt(),
            m => pow(1.0 - inside, 1.0 / (m + 1.0)),
        };
        let across = max(1.0 - up * up, 0.0).sqrt();
        let (sine, cosine) = (TAU * turns).sin_cos();
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
            let lobe = Lobe::turned(axis, exponent, 32, 7);
            let sum: f32 = lobe.directions().map(|d| dot(d, axis)).sum();
            assert!((sum / 1024.0 - mean).abs() < 2e-3, "{exponent}");
            let sum: f32 = (0..1024).map(|k| dot(lobe.on_spiral(k), axis)).sum();
            assert!((sum / 1024.0 - mean).abs() < 2e-3, "{exponent}");
            assert!(lobe.directions().all(|d| (dot(d, d) - 1.0).abs() < 1e-5));
        }
    }
}
