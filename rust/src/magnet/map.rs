//! A sampled field: values on a regular grid, between them a tricubic spline (Catmull and Rom 1974).

use glam::{DMat3, DVec3};

/// Flux density sampled on a regular grid.
pub struct FieldMap {
    origin: DVec3,
    /// One over the spacing [1/m].
    inverse: DVec3,
    /// Points along x, y, z, before padding.
    shape: [usize; 3],
    /// Values [T], one more layer on every side, z fastest.
    values: Vec<DVec3>,
}

/// Weights of four neighbours at the fraction `t`, and their derivatives.
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
    /// A map of at least four points along each axis, `values` with z fastest.
    pub fn new(origin: DVec3, spacing: DVec3, shape: [usize; 3], values: &[DVec3]) -> Self {
        let padded = shape.map(|n| n + 2);
        let mut map = FieldMap {
            origin,
            inverse: spacing.recip(),
            shape,
            values: vec![DVec3::ZERO; padded.iter().product()],
        };
        for i in 0..shape[0] {
            for j in 0..shape[1] {
                for k in 0..shape[2] {
                    let place = map.index([i + 1, j + 1, k + 1]);
                    map.values[place] = values[(i * shape[1] + j) * shape[2] + k];
                }
            }
        }
        (0..3).for_each(|axis| map.pad(axis));
        map
    }

    fn index(&self, [i, j, k]: [usize; 3]) -> usize {
        (i * (self.shape[1] + 2) + j) * (self.shape[2] + 2) + k
    }

    /// Fills the outer layers along one axis with the cubic through the four points inside.
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
                for (to, way) in [(0usize, 1isize), (last, -1)] {
                    let from = |n: isize| self.values[at(self, (to as isize + way * n) as usize)];
                    let value = 4.0 * from(1) - 6.0 * from(2) + 4.0 * from(3) - from(4);
                    let place = at(self, to);
                    self.values[place] = value;
                }
            }
        }
    }

    /// Flux density [T] and gradient `∂B_i/∂x_j` [T/m] at `p`, and whether `p` is in the map.
    ///
    /// The gradient is that of the spline. Outside the map: the value at its nearest point, and no
    /// gradient.
    pub fn field(&self, p: DVec3) -> (DVec3, DMat3, bool) {
        let place = (p - self.origin) * self.inverse;
        let most = DVec3::from_array(self.shape.map(|n| (n - 1) as f64));
        let inside = place.clamp(DVec3::ZERO, most);
        let is_in = inside == place;
        let cell = |axis: usize| (inside[axis] as usize).min(self.shape[axis] - 2);
        let start = [cell(0), cell(1), cell(2)];
        let [x, y, z] = [0, 1, 2].map(|axis| weights(inside[axis] - start[axis] as f64));
        let mut flux = DVec3::ZERO;
        let mut slopes = [DVec3::ZERO; 3];
        for i in 0..4 {
            for j in 0..4 {
                let row = &self.values[self.index([start[0] + i, start[1] + j, start[2]])..][..4];
                let value = row.iter().zip(z.0).fold(DVec3::ZERO, |s, (v, w)| s + *v * w);
                let slope = row.iter().zip(z.1).fold(DVec3::ZERO, |s, (v, w)| s + *v * w);
                flux += x.0[i] * y.0[j] * value;
                slopes[0] += x.1[i] * y.0[j] * value;
                slopes[1] += x.0[i] * y.1[j] * value;
                slopes[2] += x.0[i] * y.0[j] * slope;
            }
        }
        if !is_in {
            return (flux, DMat3::ZERO, false);
        }
        let [dx, dy, dz] = slopes;
        let gradient = DMat3::from_cols(dx, dy, dz)
            * DMat3::from_diagonal(DVec3::new(self.inverse.x, self.inverse.y, self.inverse.z));
        (flux, gradient, true)
    }
}
