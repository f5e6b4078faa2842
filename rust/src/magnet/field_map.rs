//! Sampled field on a regular grid, interpolated by a tricubic spline (Catmull and Rom 1974).

use glam::{DMat3, DVec3};

/// Flux density sampled on a regular grid.
pub struct FieldMap {
    origin: DVec3,
    /// Inverse of the spacing [1/m].
    inverse: DVec3,
    /// Numbers of points along x, y, z, before padding.
    shape: [usize; 3],
    /// Values [T], with one layer of padding on every side, z fastest.
    values: Vec<Lanes>,
}

/// Vector and a spare lane, so that the compiler uses full registers.
type Lanes = [f64; 4];

/// Adds `weight · v`.
#[inline(always)]
fn add(sum: &mut Lanes, weight: f64, v: &Lanes) {
    sum[0] += weight * v[0];
    sum[1] += weight * v[1];
    sum[2] += weight * v[2];
    sum[3] += weight * v[3];
}

#[inline(always)]
fn vector(v: Lanes) -> DVec3 {
    DVec3::new(v[0], v[1], v[2])
}

/// Weights of four neighbors at the fraction `t`, and their derivatives.
fn weights(t: f64) -> ([f64; 4], [f64; 4]) {
    let (t2, t3) = (t * t, t * t * t);
    (
        [
            0.5 * (2.0 * t2 - t3 - t),
            0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
            0.5 * (4.0 * t2 - 3.0 * t3 + t),
            0.5 * (t3 - t2),
        ],
        [
            0.5 * (4.0 * t - 3.0 * t2 - 1.0),
            0.5 * (9.0 * t2 - 10.0 * t),
            0.5 * (8.0 * t - 9.0 * t2 + 1.0),
            0.5 * (3.0 * t2 - 2.0 * t),
        ],
    )
}

impl FieldMap {
    /// Map of at least four points along each axis, `values` with z fastest.
    pub fn new(origin: DVec3, spacing: DVec3, shape: [usize; 3], values: &[DVec3]) -> Self {
        let padded = shape.map(|n| n + 2);
        let mut map = FieldMap {
            origin,
            inverse: spacing.recip(),
            shape,
            values: vec![[0.0; 4]; padded.iter().product()],
        };
        for i in 0..shape[0] {
            for j in 0..shape[1] {
                for k in 0..shape[2] {
                    let place = map.index([i + 1, j + 1, k + 1]);
                    let v = values[(i * shape[1] + j) * shape[2] + k];
                    map.values[place] = [v.x, v.y, v.z, 0.0];
                }
            }
        }
        (0..3).for_each(|axis| map.pad(axis));
        map
    }

    fn index(&self, [i, j, k]: [usize; 3]) -> usize {
        (i * (self.shape[1] + 2) + j) * (self.shape[2] + 2) + k
    }

    /// Fills the padding along one axis by cubic extrapolation of the four nearest points.
    fn pad(&mut self, axis: usize) {
        let last = self.shape[axis] + 1;
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for i in 0..self.shape[u] + 2 {
            for j in 0..self.shape[v] + 2 {
                let at = |map: &Self, n: usize| {
                    let mut place = [0; 3];
                    (place[axis], place[u], place[v]) = (n, i, j);
                    map.index(place)
                };
                for (to, sign) in [(0usize, 1isize), (last, -1)] {
                    let mut value = [0.0; 4];
                    for (n, weight) in [(1, 4.0), (2, -6.0), (3, 4.0), (4, -1.0)] {
                        let from = at(self, (to as isize + sign * n) as usize);
                        add(&mut value, weight, &self.values[from]);
                    }
                    let place = at(self, to);
                    self.values[place] = value;
                }
            }
        }
    }

    /// Flux density [T] and gradient `∂B_i/∂x_j` [T/m] at `p`, and true if `p` is in the map.
    ///
    /// The gradient is that of the spline. Outside the map: the value at its nearest point, and
    /// zero gradient.
    pub fn field(&self, p: DVec3) -> (DVec3, DMat3, bool) {
        let place = (p - self.origin) * self.inverse;
        let most = DVec3::from_array(self.shape.map(|n| (n - 1) as f64));
        let inside = place.clamp(DVec3::ZERO, most);
        let is_in = inside == place;
        let cell = |axis: usize| (inside[axis] as usize).min(self.shape[axis] - 2);
        let start = [cell(0), cell(1), cell(2)];
        let [x, y, z] = [0, 1, 2].map(|axis| weights(inside[axis] - start[axis] as f64));
        let (mut flux, mut slopes) = ([0.0; 4], [[0.0; 4]; 3]);
        for i in 0..4 {
            let (mut value, mut slope_y, mut slope_z) = ([0.0; 4], [0.0; 4], [0.0; 4]);
            for j in 0..4 {
                let first = self.index([start[0] + i, start[1] + j, start[2]]);
                let row = &self.values[first..first + 4];
                let (mut here, mut slope) = ([0.0; 4], [0.0; 4]);
                for k in 0..4 {
                    add(&mut here, z.0[k], &row[k]);
                    add(&mut slope, z.1[k], &row[k]);
                }
                add(&mut value, y.0[j], &here);
                add(&mut slope_y, y.1[j], &here);
                add(&mut slope_z, y.0[j], &slope);
            }
            add(&mut flux, x.0[i], &value);
            add(&mut slopes[0], x.1[i], &value);
            add(&mut slopes[1], x.0[i], &slope_y);
            add(&mut slopes[2], x.0[i], &slope_z);
        }
        let flux = vector(flux);
        if !is_in {
            return (flux, DMat3::ZERO, false);
        }
        let [dx, dy, dz] = slopes.map(vector);
        let gradient = DMat3::from_cols(dx, dy, dz)
            * DMat3::from_diagonal(DVec3::new(self.inverse.x, self.inverse.y, self.inverse.z));
        (flux, gradient, true)
    }
}
