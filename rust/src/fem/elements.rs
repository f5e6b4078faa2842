//! Stress of a hyperelastic material, summed over elements of ten nodes.

use glam::{DMat3, DVec3};

/// Nodes of an element.
pub const NODES: usize = 10;

/// A material of the exponential neo-Hookean family: with q = tr(FᵀF) − 3 − 2 ln J,
/// `Ψ = μ/(2b) (exp(b q) − 1) + λ/2 (ln J)²`; for b = 0 neo-Hookean, `Ψ = μ/2 q + λ/2 (ln J)²`.
#[derive(Clone, Copy)]
pub struct Hyperelastic {
    /// Shear modulus μ at rest [Pa].
    pub shear: f64,
    /// Lamé's first parameter λ [Pa].
    pub lame: f64,
    /// Stiffening b.
    pub stiffening: f64,
}

impl Hyperelastic {
    /// Energy [J/m³] and first Piola-Kirchhoff stress [Pa]; infinite energy where it is inverted.
    #[inline(always)]
    fn respond(&self, gradient: DMat3) -> (f64, DMat3) {
        let volume = gradient.determinant();
        if !(volume > 0.0) {
            return (f64::INFINITY, DMat3::ZERO);
        }
        let (log, inverse) = (volume.ln(), gradient.inverse().transpose());
        let square = |v: DVec3| v.length_squared();
        let stretch = square(gradient.x_axis) + square(gradient.y_axis) + square(gradient.z_axis);
        let q = stretch - 3.0 - 2.0 * log;
        let (density, growth) = if self.stiffening == 0.0 {
            (0.5 * self.shear * q, 1.0)
        } else {
            let growth = (self.stiffening * q).exp();
            (0.5 * self.shear * (growth - 1.0) / self.stiffening, growth)
        };
        let stress = (gradient - inverse) * (self.shear * growth) + inverse * (self.lame * log);
        (density + 0.5 * self.lame * log * log, stress)
    }
}

/// Elements with what they need at their points of integration.
pub struct Elements {
    pub material: Hyperelastic,
    /// Nodes of each element.
    pub nodes: Vec<[u32; NODES]>,
    /// Gradients of the shape functions at each point [1/m], element by element.
    pub gradients: Vec<[DVec3; NODES]>,
    /// Volume of each point [m³].
    pub weights: Vec<f64>,
}

impl Elements {
    /// Energy [J] at displacements `u` of the free nodes; adds the nodes' forces to `out`.
    ///
    /// Nodes beyond the end of `u` are held.
    pub fn add_force(&self, u: &[DVec3], scale: f64, out: &mut [DVec3]) -> f64 {
        let points = self.weights.len() / self.nodes.len();
        let mut energy = 0.0;
        for (e, nodes) in self.nodes.iter().enumerate() {
            let moved = nodes.map(|n| u.get(n as usize).copied().unwrap_or_default());
            let mut force = [DVec3::ZERO; NODES];
            for p in e * points..(e + 1) * points {
                let mut columns = [DVec3::X, DVec3::Y, DVec3::Z];
                for (moved, by) in moved.iter().zip(&self.gradients[p]) {
                    columns[0] += *moved * by.x;
                    columns[1] += *moved * by.y;
                    columns[2] += *moved * by.z;
                }
                let [x, y, z] = columns;
                let (density, stress) = self.material.respond(DMat3::from_cols(x, y, z));
                energy += self.weights[p] * density;
                let stress = stress * self.weights[p];
                for (force, by) in force.iter_mut().zip(&self.gradients[p]) {
                    *force += stress * *by;
                }
            }
            for (n, force) in nodes.iter().zip(force) {
                if let Some(out) = out.get_mut(*n as usize) {
                    *out += scale * force;
                }
            }
        }
        energy
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stress_is_the_slope_of_energy() {
        let f = DMat3::from_cols_array(&[1.1, 0.2, -0.1, 0.05, 0.9, 0.1, -0.2, 0.15, 1.2]);
        for stiffening in [0.0, 1.5] {
            let material = Hyperelastic { shear: 2.0, lame: 9.0, stiffening };
            let stress = material.respond(f).1;
            for column in 0..3 {
                for row in 0..3 {
                    let mut step = DMat3::ZERO;
                    step.col_mut(column)[row] = 1e-6;
                    let slope = material.respond(f + step).0 - material.respond(f - step).0;
                    assert!((slope / 2e-6 - stress.col(column)[row]).abs() < 1e-7);
                }
            }
        }
    }

    #[test]
    fn an_inverted_element_has_infinite_energy() {
        let material = Hyperelastic { shear: 2.0, lame: 9.0, stiffening: 0.0 };
        let flat = DMat3::from_diagonal(DVec3::new(1.0, 1.0, -0.1));
        assert!(material.respond(flat).0.is_infinite());
    }
}
