//! Solid noise from hashed lattice points: stateless, with the same value on any machine.
//!
//! It uses only additions, multiplications, divisions and square roots (IEEE 754 fixes their bits);
//! Rust never contracts them into fused operations.

use crate::simd::f32x64::{LANES, Lane, Lane3, at, clamp, dot, max, min, scale, sub};

pub use crate::simd::f32x64::Vec3;

/// Hash of a counter (the lowbias32 finalizer of C. Wellons, 2018).
#[inline(always)]
pub fn mix(mut h: u32) -> u32 {
    h ^= h >> 16;
    h = h.wrapping_mul(0x7feb_352d);
    h ^= h >> 15;
    h = h.wrapping_mul(0x846c_a68b);
    h ^ (h >> 16)
}

/// Uniform number in [0, 1) from a seed and two counters.
#[inline(always)]
pub fn uniform(seed: u32, a: u32, b: u32) -> f32 {
    let h = mix(seed ^ mix(a ^ mix(b.wrapping_add(0x9e37_79b9))));
    (h >> 8) as f32 * (1.0 / 16_777_216.0)
}

#[inline(always)]
fn corner(seed: u32, x: i32, y: i32, z: i32) -> u32 {
    mix(seed
        ^ (x as u32).wrapping_mul(0x8da6_b343)
        ^ (y as u32).wrapping_mul(0xd816_3841)
        ^ (z as u32).wrapping_mul(0xcb1a_b31f))
}

/// Three independent numbers in [−1, 1] from the bits of a hash.
#[inline(always)]
fn triple(h: u32) -> Vec3 {
    const SCALE: f32 = 2.0 / 1023.0;
    // Conversion of a signed integer to a float takes one instruction.
    let part = |shift: u32| ((h >> shift) & 1023) as i32 as f32 * SCALE - 1.0;
    [part(0), part(10), part(20)]
}

/// Floor of `x`, for |x| < 2²², without the library call of `f32::floor` on x86-64; unspecified for
/// other numbers.
#[inline(always)]
pub fn floor(x: f32) -> i32 {
    // Adding 1.5 · 2²³ rounds to an integer and leaves it in the low bits.
    const ROUND: f32 = 12_582_912.0;
    let shifted = x + ROUND;
    let near = shifted.to_bits().wrapping_sub(ROUND.to_bits()) as i32;
    near - i32::from(shifted - ROUND > x)
}

#[inline(always)]
fn split(x: f32) -> (i32, f32, f32) {
    let floor = floor(x);
    let t = x - floor as f32;
    (floor, t, t * t * t * (t * (t * 6.0 - 15.0) + 10.0))
}

/// Noise over a lattice of hashed points, without branches, so that it vectorizes.
#[derive(Clone, Copy)]
pub struct Lattice {
    seed: u32,
    frequency: f32,
}

/// Standard deviation of gradient noise.
pub const DEVIATION: f32 = 0.76;

/// Scale that gives gradient noise this standard deviation (raw, it has 0.1909: the
/// integral over a cell of the squared weights and offsets, for gradients uniform in a cube).
const SCALE: f32 = 3.98;

impl Lattice {
    /// Lattice with points `size` apart.
    pub fn new(seed: u32, size: f32) -> Self {
        Self { seed, frequency: 1.0 / size }
    }

    /// Vectors at the corners of the cell of `p` (x fastest), offsets of `p` in the cell, and their
    /// quintic fades.
    #[inline(always)]
    fn locate(&self, p: Vec3) -> ([Vec3; 8], Vec3, Vec3) {
        let (x, y, z) = (
            split(p[0] * self.frequency),
            split(p[1] * self.frequency),
            split(p[2] * self.frequency),
        );
        let mut corners = [[0.0; 3]; 8];
        for (index, vector) in corners.iter_mut().enumerate() {
            let [i, j, k] = steps(index);
            *vector = triple(corner(self.seed, x.0 + i, y.0 + j, z.0 + k));
        }
        (corners, [x.1, y.1, z.1], [x.2, y.2, z.2])
    }

    /// Gradient noise (Perlin 2002) of zero mean and standard deviation 0.76.
    #[inline(always)]
    pub fn gradient(&self, p: Vec3) -> f32 {
        let (corners, t, fade) = self.locate(p);
        let mut values = [0.0; 8];
        for (index, g) in corners.iter().enumerate() {
            let [i, j, k] = steps(index);
            values[index] =
                g[0] * (t[0] - i as f32) + g[1] * (t[1] - j as f32) + g[2] * (t[2] - k as f32);
        }
        blend(&values, fade) * SCALE
    }

    /// Gradient noise at the points of a lane.
    #[inline(always)]
    pub fn gradients(&self, p: &Lane3) -> Lane {
        let mut values = [0.0; LANES];
        for i in 0..LANES {
            values[i] = self.gradient(at(p, i));
        }
        values
    }

    /// Smooth random vector, each component in [−1, 1].
    #[inline(always)]
    pub fn displacement(&self, p: Vec3) -> Vec3 {
        let (corners, _, fade) = self.locate(p);
        let mut vector = [0.0; 3];
        for (axis, component) in vector.iter_mut().enumerate() {
            let mut values = [0.0; 8];
            for (value, corner) in values.iter_mut().zip(&corners) {
                *value = corner[axis];
            }
            *component = blend(&values, fade);
        }
        vector
    }
}

/// Offset along x, y and z to a corner of a cell.
#[inline(always)]
fn steps(index: usize) -> [i32; 3] {
    [index as i32 & 1, (index as i32 >> 1) & 1, index as i32 >> 2]
}

/// Cellular noise (Worley, SIGGRAPH 1996): one point in each cell of a lattice.
#[derive(Clone, Copy)]
pub struct Cells {
    seed: u32,
    frequency: f32,
}

impl Cells {
    /// Lattice of cells `size` wide.
    pub fn new(seed: u32, size: f32) -> Self {
        Self { seed, frequency: 1.0 / size }
    }

    /// Point of the cell at `cell + step`, from the corner of `cell` [cells].
    #[inline(always)]
    fn point(&self, cell: [i32; 3], step: [i32; 3]) -> Vec3 {
        /// Maximum offset of points from the centers of their cells, in cells.
        const STRAY: f32 = 0.4;
        let stray =
            triple(corner(self.seed, cell[0] + step[0], cell[1] + step[1], cell[2] + step[2]));
        let along = |k: usize| step[k] as f32 + 0.5 + STRAY * stray[k];
        [along(0), along(1), along(2)]
    }

    /// Cell of `p`, and the offset of `p` in it [cells].
    #[inline(always)]
    fn locate(&self, p: Vec3) -> ([i32; 3], Vec3) {
        let p = scale(p, self.frequency);
        let cell = [floor(p[0]), floor(p[1]), floor(p[2])];
        (cell, sub(p, [cell[0] as f32, cell[1] as f32, cell[2] as f32]))
    }

    /// Difference of the distances to the second nearest and the nearest point, in cells: 0 on the
    /// borders between points, up to about 1 at the points.
    #[inline(always)]
    pub fn borders(&self, p: &Lane3) -> Lane {
        let (mut cells, mut offsets) = ([[0; LANES]; 3], [[0.0; LANES]; 3]);
        for i in 0..LANES {
            let (cell, offset) = self.locate(at(p, i));
            for k in 0..3 {
                (cells[k][i], offsets[k][i]) = (cell[k], offset[k]);
            }
        }
        let (mut first, mut second) = ([99.0; LANES], [99.0; LANES]);
        for index in 0..27 {
            let step = [index % 3 - 1, index / 3 % 3 - 1, index / 9 - 1];
            for i in 0..LANES {
                let cell = [cells[0][i], cells[1][i], cells[2][i]];
                let d = sub(self.point(cell, step), at(&offsets, i));
                let square = dot(d, d);
                second[i] = min(second[i], max(first[i], square));
                first[i] = min(first[i], square);
            }
        }
        for i in 0..LANES {
            first[i] = second[i].sqrt() - first[i].sqrt();
        }
        first
    }

    /// Offset [cells] from the point in the cell of `p`, and a number in [0, 1) per point.
    #[inline(always)]
    pub fn own(&self, p: Vec3) -> (Vec3, f32) {
        let (cell, offset) = self.locate(p);
        let number = corner(self.seed ^ 0x666c_6563, cell[0], cell[1], cell[2]) >> 8;
        (sub(offset, self.point(cell, [0; 3])), number as i32 as f32 * (1.0 / 16_777_216.0))
    }
}

/// Trilinear blend of a cell's corners (x fastest).
#[inline(always)]
fn blend(values: &[f32; 8], fade: Vec3) -> f32 {
    let mix = |a: f32, b: f32, fade: f32| a + (b - a) * fade;
    let layer = |i: usize| mix(values[i], values[i + 4], fade[2]);
    let line = |i: usize| mix(layer(i), layer(i + 2), fade[1]);
    mix(line(0), line(1), fade[0])
}

/// Exponential of x in [−80, 80], to 3e-7 relative: 2ⁿ times a polynomial on [−½, ½].
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    let y = clamp(x, -80.0, 80.0) * std::f32::consts::LOG2_E;
    let n = floor(y + 0.5);
    let t = (y - n as f32) * std::f32::consts::LN_2;
    let series = 1.0
        + t * (1.0
            + t * (0.5
                + t * (1.0 / 6.0 + t * (1.0 / 24.0 + t * (1.0 / 120.0 + t * (1.0 / 720.0))))));
    series * f32::from_bits(((n + 127) as u32) << 23)
}

/// Cube root of a number ≥ 1 by Newton's iteration.
#[inline(always)]
pub fn cube_root(x: f32) -> f32 {
    // A third of the exponent's bits is within 30 % of the root; four steps reach f32 precision.
    let mut y = f32::from_bits(x.to_bits() / 3 + 0x2a51_4067);
    for _ in 0..4 {
        y = (2.0 * y + x / (y * y)) * (1.0 / 3.0);
    }
    y
}

/// Smooth step from 0 at `low` to 1 at `high`.
#[inline(always)]
pub fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = clamp((x - low) / (high - low), 0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponential_and_cube_root_agree_with_the_library() {
        for i in -700..700 {
            let x = i as f32 * 0.1;
            assert!((exp(x) / x.exp() - 1.0).abs() < 1e-5);
        }
        for i in 1..1000 {
            let x = i as f32 * 17.3;
            assert!((cube_root(x) / x.cbrt() - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn borders_between_cells_agree_with_a_wide_search() {
        let cells = Cells::new(5, 1.0);
        for i in 0..2000 {
            let p = [0, 1, 2].map(|axis| uniform(11, i, axis) * 40.0 - 20.0);
            let cell = p.map(floor);
            let mut distances = Vec::new();
            for index in 0..125 {
                let step = [index % 5 - 2, index / 5 % 5 - 2, index / 25 - 2];
                let at = [0, 1, 2].map(|k| cell[k] + step[k]);
                let stray = triple(corner(5, at[0], at[1], at[2]));
                let d = [0, 1, 2].map(|k| at[k] as f32 + 0.5 + 0.4 * stray[k] - p[k]);
                distances.push((d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt());
            }
            distances.sort_by(f32::total_cmp);
            let border = cells.borders(&p.map(|x| [x; LANES]))[i as usize % LANES];
            assert!((border - (distances[1] - distances[0])).abs() < 1e-4);
        }
    }

    #[test]
    fn gradient_noise_has_the_mean_and_deviation_it_states() {
        let (mut sum, mut squares, n) = (0.0f64, 0.0f64, 200_000u32);
        let lattice = Lattice::new(3, 1.0);
        for i in 0..n {
            let p = [0, 1, 2].map(|axis| uniform(7, i, axis) * 500.0);
            let value = f64::from(lattice.gradient(p));
            sum += value;
            squares += value * value;
        }
        let mean = sum / f64::from(n);
        assert!(mean.abs() < 0.02);
        assert!(((squares / f64::from(n)).sqrt() - 0.76).abs() < 0.02);
    }
}
