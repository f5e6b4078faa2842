//! Far field of an axially symmetric source: exterior zonal harmonics, where closed forms cancel.

use super::axial_field::AxialField;

/// Number of odd degrees: (1/3)^(2·17) is below machine precision.
pub const TERMS: usize = 17;
/// Distance from which the series is used, as a multiple of a source's size.
pub const FAR: f64 = 3.0;
const SMALL: f64 = 1e-17;

/// Series `Φ = Σ_l q_l P_l(cos θ)/r^{l+1}` over odd l, with lengths in units of the source's size.
#[derive(Clone)]
pub struct Multipole {
    /// Radius of the bounding sphere of the source [m].
    pub size: f64,
    /// Coefficients q_1, q_3, … [T].
    pub moments: [f64; TERMS],
}

/// Factors of the recurrences of I and Q, for l = n + 1 and l = n + 2, n = 1, 3, …:
/// `(l+1) I_{l+1} = ((2l+1) z I_l − l I_{l−1})/r²`,
/// `l Q_{l+1} = ((2l+1) z Q_l − (l+1) Q_{l−1})/r²`.
static STEPS: [[f64; 8]; TERMS] = steps();

const fn steps() -> [[f64; 8]; TERMS] {
    let mut table = [[0.0; 8]; TERMS];
    let mut k = 0;
    while k < TERMS {
        let l = (2 * k + 2) as f64;
        table[k] = [
            (2.0 * l + 1.0) / (l + 1.0),
            l / (l + 1.0),
            (2.0 * l + 1.0) / l,
            (l + 1.0) / l,
            (2.0 * l + 3.0) / (l + 2.0),
            (l + 1.0) / (l + 2.0),
            (2.0 * l + 3.0) / (l + 1.0),
            (l + 2.0) / (l + 1.0),
        ];
        k += 1;
    }
    table
}

/// Derivatives P′_0(x) … P′_last(x) of the Legendre polynomials.
fn legendre_slopes(x: f64) -> [f64; 2 * TERMS + 2] {
    let mut slopes = [0.0; 2 * TERMS + 2];
    slopes[1] = 1.0;
    for l in 1..2 * TERMS + 1 {
        let n = l as f64;
        slopes[l + 1] = ((2.0 * n + 1.0) * x * slopes[l] - (n + 1.0) * slopes[l - 1]) / n;
    }
    slopes
}

impl Multipole {
    /// Series of a shell of radius `a` and half length `b` with `sheet` = μ₀ × surface current [T]:
    /// `q_l = sheet a² r₀^l P′_{l+1}(b/r₀)/((l+1)(l+2))`, from two equivalent charged discs.
    pub fn shell(a: f64, b: f64, sheet: f64) -> Self {
        let size = a.hypot(b);
        let slopes = legendre_slopes(b / size);
        let factor = sheet * (a / size) * (a / size);
        let moment = |k: usize| {
            let l = 2 * k + 1;
            factor * slopes[l + 1] / ((l + 1) * (l + 2)) as f64
        };
        Multipole { size, moments: std::array::from_fn(moment) }
    }

    /// Series of a loop of radius `a`, `strength` = μ₀ × current [T·m]:
    /// `q_l = strength/2 · a^{l+1} P′_l(0)/(l+1)`, from the sheet of dipoles that spans it.
    pub fn ring(a: f64, strength: f64) -> Self {
        let slopes = legendre_slopes(0.0);
        let moment = |k: usize| {
            let l = 2 * k + 1;
            0.5 * strength / a * slopes[l] / (l + 1) as f64
        };
        Multipole { size: a, moments: std::array::from_fn(moment) }
    }

    /// Field at distance `rho` from the axis and height `z` [m], beyond `FAR` sizes.
    ///
    /// With `I_l = P_l/r^{l+1}` and `Q_l = P′_l/r^{l+2}`: `∂_z I_l = −(l+1) I_{l+1}`,
    /// `∂_ρ I_l = −ρ Q_{l+1}` and `∂_z Q_l = −l Q_{l+1}`.
    #[inline]
    pub fn field(&self, rho: f64, z: f64) -> AxialField {
        self.field_and_radial(rho, z).0
    }

    /// Field, and `N_ρ/ρ` [T] of the potential with `N_z = −Φ` (see `solids`): `−Σ q_l Q_l/l`.
    #[inline(always)]
    pub fn field_and_radial(&self, rho: f64, z: f64) -> (AxialField, f64) {
        let inverse = 1.0 / self.size;
        let (rho, z) = (rho * inverse, z * inverse);
        let over = 1.0 / (rho * rho + z * z);
        // (I, Q) of degrees l and l + 1, starting at l = 1.
        let i0 = over.sqrt();
        let (mut i1, mut q1) = (z * over * i0, over * i0);
        let mut i2 = (1.5 * z * i1 - 0.5 * i0) * over;
        let mut q2 = 3.0 * z * q1 * over;
        let (mut sum, mut radial) = (AxialField::default(), 0.0);
        let mut decay = over;
        for (k, (&moment, step)) in self.moments.iter().zip(&STEPS).enumerate() {
            let n = (2 * k + 1) as f64;
            let i3 = (step[0] * z * i2 - step[1] * i1) * over;
            let q3 = (step[2] * z * q2 - step[3] * q1) * over;
            sum.along += moment * (n + 1.0) * i2;
            sum.along_slope -= moment * (n + 1.0) * (n + 2.0) * i3;
            sum.radial += moment * q2;
            sum.radial_slope -= moment * (n + 1.0) * q3;
            radial -= moment / n * q1;
            decay *= over;
            if decay < SMALL * over {
                break;
            }
            i1 = i3;
            q1 = q3;
            i2 = (step[4] * z * i3 - step[5] * i2) * over;
            q2 = (step[6] * z * q3 - step[7] * q2) * over;
        }
        sum.along_slope *= inverse;
        sum.radial *= inverse;
        sum.radial_slope *= inverse * inverse;
        (sum, radial)
    }
}
