//! Solid noise from hashed lattice points: no state, the same value on any machine.
//!
//! Only additions, multiplications, divisions and square roots are used (IEEE 754 fixes
//! their bits); Rust never contracts them into fused operations.

/// A point or vector in 3-D.
pub type Vec3 = [f32; 3];

/// Mixes the bits of a counter (the lowbias32 finaliser of C. Wellons, 2018).
#[inline(always)]
pub fn mix(mut h: u32) -> u32 {
    h ^= h >> 16;
    h = h.wrapping_mul(0x7feb_352d);
    h ^= h >> 15;
    h = h.wrapping_mul(0x846c_a68b);
    h ^ (h >> 16)
}

/// A number in [0, 1) from a seed and two counters.
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
    [
        (h & 1023) as f32 * SCALE - 1.0,
        ((h >> 10) & 1023) as f32 * SCALE - 1.0,
        ((h >> 20) & 1023) as f32 * SCALE - 1.0,
    ]
}

/// Largest whole number not above `x`, without the library call `f32::floor` costs on x86-64.
#[inline(always)]
pub fn floor(x: f32) -> i32 {
    let near = x as i32;
    near - i32::from((near as f32) > x)
}

#[inline(always)]
fn split(x: f32) -> (i32, f32, f32) {
    let floor = floor(x);
    let t = x - floor as f32;
    (floor, t, t * t * t * (t * (t * 6.0 - 15.0) + 10.0))
}

/// Noise over a lattice that remembers the cell it was last in, as neighboring texels share it.
pub struct Lattice {
    seed: u32,
    frequency: f32,
    cell: [i32; 3],
    corners: [[f32; 8]; 3],
}

/// Scale that gives gradient noise a standard deviation of 0.76 (raw, it has 0.1909: the
/// integral over a cell of the squared weights and offsets, for gradients uniform in a cube).
const SCALE: f32 = 3.98;

impl Lattice {
    /// A lattice with points `size` apart.
    pub fn new(seed: u32, size: f32) -> Self {
        let mut lattice =
            Self { seed, frequency: 1.0 / size, cell: [0; 3], corners: [[0.0; 8]; 3] };
        lattice.enter([0; 3]);
        lattice
    }

    #[inline(always)]
    fn enter(&mut self, cell: [i32; 3]) {
        self.cell = cell;
        for index in 0..8 {
            let (i, j, k) = (index & 1, (index >> 1) & 1, index >> 2);
            let h = corner(self.seed, cell[0] + i, cell[1] + j, cell[2] + k);
            let value = triple(h);
            for axis in 0..3 {
                self.corners[axis][index as usize] = value[axis];
            }
        }
    }

    /// Offsets into the cell of `p`, and their quintic fades.
    #[inline(always)]
    fn locate(&mut self, p: Vec3) -> (Vec3, Vec3) {
        let [x, y, z] = p.map(|x| split(x * self.frequency));
        let cell = [x.0, y.0, z.0];
        if cell != self.cell {
            self.enter(cell);
        }
        ([x.1, y.1, z.1], [x.2, y.2, z.2])
    }

    /// Gradient noise (Perlin 2002) of zero mean and standard deviation 0.76.
    #[inline(always)]
    pub fn gradient(&mut self, p: Vec3) -> f32 {
        let (t, fade) = self.locate(p);
        let [gx, gy, gz] = &self.corners;
        let values: [f32; 8] = std::array::from_fn(|index| {
            gx[index] * (t[0] - (index & 1) as f32)
                + gy[index] * (t[1] - ((index >> 1) & 1) as f32)
                + gz[index] * (t[2] - (index >> 2) as f32)
        });
        blend(&values, fade) * SCALE
    }

    /// Smooth random vector, each component in [−1, 1].
    #[inline(always)]
    pub fn displacement(&mut self, p: Vec3) -> Vec3 {
        let (_, fade) = self.locate(p);
        [0, 1, 2].map(|axis| blend(&self.corners[axis], fade))
    }
}

/// Cellular noise (Worley, SIGGRAPH 1996): one point in each cell of a lattice; it remembers the
/// points around the cell it was last in.
pub struct Cells {
    seed: u32,
    frequency: f32,
    cell: [i32; 3],
    points: [[f32; Cells::POINTS]; 3],
}

impl Cells {
    const LANES: usize = 8;
    /// Points of 3 × 3 × 3 cells, filled up with some that are far away.
    const POINTS: usize = 4 * Cells::LANES;

    /// A lattice of cells `size` wide.
    pub fn new(seed: u32, size: f32) -> Self {
        let points = [[9.0; Cells::POINTS]; 3];
        let mut cells = Self { seed, frequency: 1.0 / size, cell: [0; 3], points };
        cells.enter([0; 3]);
        cells
    }

    #[inline(always)]
    fn enter(&mut self, cell: [i32; 3]) {
        /// How far points stray from the middles of their cells, in cells.
        const STRAY: f32 = 0.4;
        self.cell = cell;
        for index in 0..27 {
            let step = [index % 3 - 1, index / 3 % 3 - 1, index / 9 - 1];
            let at = [0, 1, 2].map(|k| cell[k] + step[k]);
            let stray = triple(corner(self.seed, at[0], at[1], at[2]));
            for axis in 0..3 {
                self.points[axis][index as usize] = step[axis] as f32 + 0.5 + STRAY * stray[axis];
            }
        }
    }

    /// By how much the second nearest point is farther than the nearest, in cells: 0 on the
    /// borders between points, up to about 1 at the points.
    #[inline(always)]
    pub fn border(&mut self, p: Vec3) -> f32 {
        let p = p.map(|x| x * self.frequency);
        let cell = p.map(floor);
        if cell != self.cell {
            self.enter(cell);
        }
        let t = [0, 1, 2].map(|k| p[k] - cell[k] as f32);
        let (mut first, mut second) = ([99.0f32; Cells::LANES], [99.0f32; Cells::LANES]);
        for start in (0..Cells::POINTS).step_by(Cells::LANES) {
            for lane in 0..Cells::LANES {
                let d: Vec3 = [0, 1, 2].map(|k| self.points[k][start + lane] - t[k]);
                let square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
                second[lane] = second[lane].min(first[lane].max(square));
                first[lane] = first[lane].min(square);
            }
        }
        let mut nearest = [99.0f32; 2];
        for lane in 0..Cells::LANES {
            nearest[1] = nearest[1].min(second[lane]).min(nearest[0].max(first[lane]));
            nearest[0] = nearest[0].min(first[lane]);
        }
        nearest[1].sqrt() - nearest[0].sqrt()
    }

    /// Offset [cells] from the point in the cell of `p`, and a number in [0, 1) of its own.
    #[inline(always)]
    pub fn own(&mut self, p: Vec3) -> (Vec3, f32) {
        let p = p.map(|x| x * self.frequency);
        let cell = p.map(floor);
        if cell != self.cell {
            self.enter(cell);
        }
        let offset = [0, 1, 2].map(|k| p[k] - cell[k] as f32 - self.points[k][13]);
        let number = corner(self.seed ^ 0x666c_6563, cell[0], cell[1], cell[2]) >> 8;
        (offset, number as f32 * (1.0 / 16_777_216.0))
    }
}

/// Trilinear blend of a cell's corners (x fastest).
#[inline(always)]
fn blend(values: &[f32; 8], fade: Vec3) -> f32 {
    let layers: [f32; 4] =
        std::array::from_fn(|i| values[i] + (values[i + 4] - values[i]) * fade[2]);
    let line: [f32; 2] = std::array::from_fn(|i| layers[i] + (layers[i + 2] - layers[i]) * fade[1]);
    line[0] + (line[1] - line[0]) * fade[0]
}

/// eˣ for x in [−80, 80], to 3e-7 relative: 2ⁿ times a polynomial on [−½, ½].
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    let y = x.clamp(-80.0, 80.0) * std::f32::consts::LOG2_E;
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
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
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
        let mut cells = Cells::new(5, 1.0);
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
            assert!((cells.border(p) - (distances[1] - distances[0])).abs() < 1e-4);
        }
    }

    #[test]
    fn gradient_noise_has_the_mean_and_deviation_it_states() {
        let (mut sum, mut squares, n) = (0.0f64, 0.0f64, 200_000u32);
        let mut lattice = Lattice::new(3, 1.0);
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
