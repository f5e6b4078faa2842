//! Symmetric matrices over pairs of nodes, and vectors of three numbers per node.

use glam::{DMat3, DVec3};

/// Coupled nodes: the lower triangle with its diagonal, by rows.
pub struct Pattern {
    /// Start of each row, and the end of the last.
    pub starts: Vec<usize>,
    /// Column of each pair; ascending within a row, the diagonal last.
    pub columns: Vec<u32>,
}

/// Number or matrix that acts on one node's vector.
pub trait Entry: Copy {
    /// Product `entry · x`.
    fn apply(self, x: DVec3) -> DVec3;
    /// Product `entryᵀ · x`.
    fn apply_transposed(self, x: DVec3) -> DVec3;
}

impl Entry for f64 {
    #[inline(always)]
    fn apply(self, x: DVec3) -> DVec3 {
        self * x
    }
    #[inline(always)]
    fn apply_transposed(self, x: DVec3) -> DVec3 {
        self * x
    }
}

impl Entry for DMat3 {
    #[inline(always)]
    fn apply(self, x: DVec3) -> DVec3 {
        self * x
    }
    #[inline(always)]
    fn apply_transposed(self, x: DVec3) -> DVec3 {
        DVec3::new(self.x_axis.dot(x), self.y_axis.dot(x), self.z_axis.dot(x))
    }
}

impl Pattern {
    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// Adds `scale · A x` to `out`, with A given by its lower triangle.
    pub fn add_product<T: Entry>(&self, entries: &[T], x: &[DVec3], scale: f64, out: &mut [DVec3]) {
        for row in 0..self.len() {
            let own = scale * x[row];
            let mut sum = DVec3::ZERO;
            let (start, diagonal) = (self.starts[row], self.starts[row + 1] - 1);
            for k in start..diagonal {
                let column = self.columns[k] as usize;
                sum += entries[k].apply(x[column]);
                out[column] += entries[k].apply_transposed(own);
            }
            sum += entries[diagonal].apply(x[row]);
            out[row] += scale * sum;
        }
    }
}

/// Dot product of all components.
pub fn dot(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum()
}

/// Maximum length of a node's vector; NaN if one is NaN.
pub fn longest(a: &[DVec3]) -> f64 {
    let larger = |most: f64, x: f64| if x > most || x.is_nan() { x } else { most };
    a.iter().map(|x| x.length_squared()).fold(0.0, larger).sqrt()
}

/// Adds `scale · x` to `out`.
pub fn add_scaled(x: &[DVec3], scale: f64, out: &mut [DVec3]) {
    out.iter_mut().zip(x).for_each(|(out, x)| *out += scale * *x);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn product_is_that_of_the_whole_matrix() {
        let pattern = Pattern { starts: vec![0, 1, 3, 5], columns: vec![0, 0, 1, 1, 2] };
        let skewed = |k: f64| DMat3::from_cols_array(&[k, 1.0, 2.0, 0.5, k, -1.0, 3.0, 0.1, k]);
        let even = |k: f64| skewed(k) + skewed(k).transpose();
        let entries = [even(4.0), skewed(1.0), even(5.0), skewed(2.0), even(6.0)];
        let x = [DVec3::new(1.0, 2.0, 3.0), DVec3::new(-1.0, 0.5, 2.0), DVec3::new(0.3, 0.2, 0.1)];
        let mut out = [DVec3::ZERO; 3];
        pattern.add_product(&entries, &x, 2.0, &mut out);
        let expected = [
            entries[0] * x[0] + entries[1].transpose() * x[1],
            entries[1] * x[0] + entries[2] * x[1] + entries[3].transpose() * x[2],
            entries[3] * x[1] + entries[4] * x[2],
        ];
        for (a, b) in out.iter().zip(expected) {
            assert!((*a - 2.0 * b).length() < 1e-14);
        }
    }
}
