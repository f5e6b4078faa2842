//! Symmetric systems of six equations: three of force, three of torque.

use glam::DVec3;

/// Force and torque, or velocity and angular velocity.
#[derive(Clone, Copy, Default)]
pub struct Twist {
    /// Force [N] or velocity [m/s].
    pub linear: DVec3,
    /// Torque [N·m] or angular velocity [rad/s].
    pub angular: DVec3,
}

impl Twist {
    /// Components as an array.
    pub fn to_array(self) -> [f64; 6] {
        let (l, a) = (self.linear, self.angular);
        [l.x, l.y, l.z, a.x, a.y, a.z]
    }

    /// Twist from its components.
    pub fn from_array([a, b, c, d, e, f]: [f64; 6]) -> Self {
        Twist { linear: DVec3::new(a, b, c), angular: DVec3::new(d, e, f) }
    }
}

impl std::ops::AddAssign for Twist {
    fn add_assign(&mut self, other: Self) {
        self.linear += other.linear;
        self.angular += other.angular;
    }
}

/// Symmetric 6 × 6 matrix; only the lower triangle is stored.
#[derive(Clone, Copy, Default)]
pub struct Symmetric6(pub [[f64; 6]; 6]);

/// Dot product.
pub fn dot(a: &[f64; 6], b: &[f64; 6]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Linear system of one substep: `matrix · change = impulse`.
pub struct System {
    /// Inertia, and the derivatives of the wall's forces.
    pub matrix: Symmetric6,
    /// Impulse of all forces except friction and drag.
    pub impulse: [f64; 6],
}

impl Symmetric6 {
    /// Matrix multiplied by a factor.
    pub fn scaled(&self, factor: f64) -> Self {
        Symmetric6(self.0.map(|row| row.map(|x| factor * x)))
    }

    /// Adds another matrix.
    pub fn add(&mut self, other: &Self) {
        for (row, more) in self.0.iter_mut().zip(&other.0) {
            row.iter_mut().zip(more).for_each(|(x, y)| *x += y);
        }
    }

    /// Product `A x`.
    pub fn times(&self, x: &[f64; 6]) -> [f64; 6] {
        std::array::from_fn(|row| {
            (0..6).map(|column| self.0[row.max(column)][row.min(column)] * x[column]).sum()
        })
    }

    /// Solves `A x = b` for a positive definite `A` by its Cholesky factor.
    pub fn solve(&self, b: [f64; 6]) -> [f64; 6] {
        let mut l = self.0;
        for k in 0..6 {
            for j in 0..k {
                l[k][k] -= l[k][j] * l[k][j];
            }
            l[k][k] = l[k][k].sqrt();
            for i in k + 1..6 {
                for j in 0..k {
                    l[i][k] -= l[i][j] * l[k][j];
                }
                l[i][k] /= l[k][k];
            }
        }
        let mut x = b;
        for i in 0..6 {
            for j in 0..i {
                x[i] -= l[i][j] * x[j];
            }
            x[i] /= l[i][i];
        }
        for i in (0..6).rev() {
            for j in i + 1..6 {
                x[i] -= l[j][i] * x[j];
            }
            x[i] /= l[i][i];
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solves_what_it_multiplies() {
        let mut a = Symmetric6::default();
        for k in 0..12 {
            let j = [0, 1, 2, 3, 4, 5].map(|i| f64::from(1 + (i * 7 + k * 5) % 11) - 5.0);
            for (row, column) in (0..6).flat_map(|r| (0..=r).map(move |c| (r, c))) {
                a.0[row][column] += (0.1 + f64::from(k)) * j[row] * j[column];
            }
        }
        let x = [1.0, -2.0, 3.0, 0.5, -0.25, 4.0];
        let solved = a.solve(a.times(&x));
        for i in 0..6 {
            assert!((solved[i] - x[i]).abs() < 1e-9);
        }
    }
}
