//! Field of an axially symmetric source at one point, and its Cartesian flux density and gradient.

use glam::{DMat3, DVec3};

/// Field in cylindrical coordinates (ρ, z) and its derivatives along z.
#[derive(Clone, Copy, Debug, Default)]
pub struct AxialField {
    /// B_z [T].
    pub along: f64,
    /// ∂B_z/∂z [T/m].
    pub along_slope: f64,
    /// B_ρ/ρ [T/m].
    pub radial: f64,
    /// ∂(B_ρ/ρ)/∂z [T/m²].
    pub radial_slope: f64,
}

impl AxialField {
    /// Flux density [T] and gradient `∂B_i/∂x_j` [T/m] at `p`, in the source's frame.
    ///
    /// From div B = 0, `h = −2 B_ρ/ρ − ∂B_z/∂z = ρ ∂(B_ρ/ρ)/∂ρ`.
    #[inline(always)]
    pub fn at(&self, p: DVec3, rho2: f64) -> (DVec3, DMat3) {
        let over = if rho2 > f64::MIN_POSITIVE { 1.0 / rho2 } else { 0.0 };
        let h = (-2.0 * self.radial - self.along_slope) * over;
        let (xx, yy) = (self.radial + h * p.x * p.x, self.radial + h * p.y * p.y);
        let (xy, xz, yz) = (h * p.x * p.y, p.x * self.radial_slope, p.y * self.radial_slope);
        let gradient = DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, self.along_slope]);
        (DVec3::new(p.x * self.radial, p.y * self.radial, self.along), gradient)
    }
}
