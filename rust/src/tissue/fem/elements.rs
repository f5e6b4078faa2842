//! Stress of a hyperelastic material, summed over elements of ten nodes.

use glam::{DMat3, DVec3};

/// Number of nodes of an element.
pub const NODES: usize = 10;
/// Number of linear functions over a prism.
pub const MODES: usize = 4;
/// Number of elements of a prism.
const PRISM: usize = 3;

/// Material of the exponential neo-Hookean family: with q = tr(FᵀF) − 3 − 2 ln J,
/// `Ψ = μ/(2b) (exp(b q) − 1) + λ/2 (ln J)²`; for b = 0 neo-Hookean, `Ψ = μ/2 q + λ/2 (ln J)²`. In
/// the second term, ln J is projected over a prism.
#[derive(Clone, Copy)]
pub struct Hyperelastic {
    /// Shear modulus μ at rest [Pa].
    pub shear: f64,
    /// Lamé's first parameter λ [Pa].
    pub lame: f64,
    /// Stiffening parameter b.
    pub stiffening: f64,
}

impl Hyperelastic {
    /// Energy [J/m³] and first Piola-Kirchhoff stress [Pa] without the volumetric terms.
    #[inline(always)]
    fn distort(&self, point: &Point) -> (f64, DMat3) {
        let Point { gradient, inverse, log } = point;
        let square = |v: DVec3| v.length_squared();
        let stretch = square(gradient.x_axis) + square(gradient.y_axis) + square(gradient.z_axis);
        let q = stretch - 3.0 - 2.0 * log;
        let growth = (self.stiffening * q).exp();
        let density = if self.stiffening == 0.0 {
            0.5 * self.shear * q
        } else {
            0.5 * self.shear * (growth - 1.0) / self.stiffening
        };
        (density, (*gradient - *inverse) * (self.shear * growth))
    }
}

/// Deformation at one point.
#[derive(Clone, Copy)]
struct Point {
    gradient: DMat3,
    /// Inverse transpose of the deformation gradient.
    inverse: DMat3,
    /// Logarithm of the volume ratio.
    log: f64,
}

impl Point {
    /// Deformation with a gradient; `None` if it is inverted.
    #[inline(always)]
    fn new(gradient: DMat3) -> Option<Self> {
        let volume = gradient.determinant();
        let log = volume.ln();
        (volume > 0.0).then(|| Point { gradient, inverse: gradient.inverse().transpose(), log })
    }
}

/// Elements with precomputed data at their quadrature points; three in sequence form a prism.
pub struct Elements {
    pub material: Hyperelastic,
    /// Nodes of each element.
    pub nodes: Vec<[u32; NODES]>,
    /// Gradients of the shape functions at each quadrature point [1/m], element by element.
    pub gradients: Vec<[DVec3; NODES]>,
    /// Volume of each quadrature point [m³].
    pub weights: Vec<f64>,
    /// Functions for the projection of a prism's change of volume, at each quadrature point
    /// [m^-3/2].
    pub modes: Vec<[f64; MODES]>,
}

impl Elements {
    /// Energy [J] at displacements `u` of the free nodes; adds `scale` times the nodal forces to
    /// `out`. If an element is inverted, the energy is infinite and `out` invalid.
    ///
    /// Nodes beyond the end of `u` are fixed.
    pub fn add_force(&self, u: &[DVec3], scale: f64, out: &mut [DVec3]) -> f64 {
        let count = self.weights.len() / self.nodes.len();
        let (mut energy, mut prism) = (0.0, Vec::with_capacity(PRISM * count));
        for (number, elements) in self.nodes.chunks_exact(PRISM).enumerate() {
            prism.clear();
            let first = number * PRISM * count;
            let mut change = [0.0; MODES];
            for (e, nodes) in elements.iter().enumerate() {
                let moved = nodes.map(|n| u.get(n as usize).copied().unwrap_or_default());
                for p in first + e * count..first + (e + 1) * count {
                    let Some(point) = self.deform(p, &moved) else {
                        return f64::INFINITY;
                    };
                    for (change, mode) in change.iter_mut().zip(self.modes[p]) {
                        *change += self.weights[p] * mode * point.log;
                    }
                    prism.push(point);
                }
            }
            energy += 0.5 * self.material.lame * change.iter().map(|c| c * c).sum::<f64>();
            for (e, nodes) in elements.iter().enumerate() {
                let points = &prism[e * count..(e + 1) * count];
                let (more, force) = self.force(first + e * count, points, &change);
                energy += more;
                for (n, force) in nodes.iter().zip(force) {
                    if let Some(out) = out.get_mut(*n as usize) {
                        *out += scale * force;
                    }
                }
            }
        }
        energy
    }

    /// Deformation at quadrature point `p` of an element with moved nodes.
    #[inline(always)]
    fn deform(&self, p: usize, moved: &[DVec3; NODES]) -> Option<Point> {
        let mut columns = [DVec3::X, DVec3::Y, DVec3::Z];
        for (moved, by) in moved.iter().zip(&self.gradients[p]) {
            columns[0] += *moved * by.x;
            columns[1] += *moved * by.y;
            columns[2] += *moved * by.z;
        }
        let [x, y, z] = columns;
        Point::new(DMat3::from_cols(x, y, z))
    }

    /// Distortional energy of one element, and the forces at its nodes; `change` are the
    /// coefficients of the modes for the logarithm of its prism's volume ratio.
    #[inline(always)]
    fn force(
        &self,
        first: usize,
        points: &[Point],
        change: &[f64; MODES],
    ) -> (f64, [DVec3; NODES]) {
        let (mut energy, mut force) = (0.0, [DVec3::ZERO; NODES]);
        for (p, point) in (first..).zip(points) {
            let (density, stress) = self.material.distort(point);
            let log: f64 = change.iter().zip(&self.modes[p]).map(|(c, mode)| c * mode).sum();
            let stress = stress + point.inverse * (self.material.lame * log);
            let weight = self.weights[p];
            energy += weight * density;
            for (force, by) in force.iter_mut().zip(&self.gradients[p]) {
                *force += stress * (weight * *by);
            }
        }
        (energy, force)
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
            let respond = |f| material.distort(&Point::new(f).unwrap());
            let stress = respond(f).1;
            for column in 0..3 {
                for row in 0..3 {
                    let mut step = DMat3::ZERO;
                    step.col_mut(column)[row] = 1e-6;
                    let slope = respond(f + step).0 - respond(f - step).0;
                    assert!((slope / 2e-6 - stress.col(column)[row]).abs() < 1e-7);
                }
            }
        }
    }

    #[test]
    fn what_is_turned_inside_out_has_no_stress() {
        assert!(Point::new(DMat3::from_diagonal(DVec3::new(1.0, 1.0, -0.1))).is_none());
    }
}
