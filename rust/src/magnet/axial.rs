//! Axially symmetric fields in closed form: a current loop, and a thin current sheet on a cylinder,
//! which is also a cylinder magnetized along its axis.

use super::axial_field::AxialField;
use super::dual::{Dual, Number, Pair};
use super::elliptic::{Complete, complete, complete_with_third};
use super::multipole::{FAR, Multipole};
use std::f64::consts::PI;

/// Distance of a wire or rim at which a point is on it, relative to the distance of its far side.
const TOUCH: f64 = 1e-9;
/// Squared complementary modulus below which the form for points near the wire is used.
const NEAR_WIRE: f64 = 0.1;
/// Distance from the axis below which a point is near it, relative to the length on which the field
/// varies: the omitted terms are of fourth order.
const NEAR_AXIS: f64 = 1e-3;

/// Squared distances to the near and the far side of a ring, and the modulus.
struct Modulus<N> {
    far: N,
    kc2: N,
    m: N,
}

#[inline(always)]
fn modulus<N: Number>(a: f64, rho: f64, z: N) -> Modulus<N> {
    let (sum, gap) = (a + rho, a - rho);
    let far = z * z + sum * sum;
    let kc2 = ((z * z + gap * gap) / far).at_least(TOUCH * TOUCH);
    Modulus { far, kc2, m: N::constant(4.0 * a * rho) / far }
}

/// `B_z` and `B_ρ/ρ` of a loop of radius `a` per μ₀ I, `z` above its plane.
///
/// Biot-Savart law in terms of K, T (see `elliptic`), in two forms: one is accurate near the axis
/// and far away, the other near the wire.
#[inline(always)]
fn ring<N: Number>(a: f64, rho: f64, z: N, u: &Modulus<N>, e: Complete<N>) -> (N, N) {
    let one = N::constant(1.0);
    let scale = one / (u.far * u.far.sqrt() * u.kc2) * (1.0 / PI);
    let mt = u.m * e.t;
    let half = (one - u.m * 0.5) * 0.5;
    let bend = e.t * (2.0 * rho) - (mt + 1.0) * (a + rho);
    let along = scale * e.k * (bend / u.far * (2.0 * rho) + 1.0) * (a * a);
    let radial = scale * z * e.k / u.far * (N::constant(0.25) - half * e.t) * (8.0 * a * a);
    // Near the wire, E and D replace K.
    let d = e.k * (mt + 1.0) * 0.5;
    let second = e.k - u.m * d;
    let near = u.far * u.kc2 * u.m * d + second * (2.0 * a * (a - rho));
    let rest = second * half * 2.0 - u.kc2 * e.k;
    let away = if rho > 0.0 { 0.5 / (rho * rho) } else { 0.0 };
    (
        N::choose(u.kc2, NEAR_WIRE, scale * near * 0.5, along),
        N::choose(u.kc2, NEAR_WIRE, scale * z * u.far * rest * away, radial),
    )
}

#[inline(always)]
fn is_near(x: f64, y: f64, limit: f64) -> bool {
    x * x + y * y <= limit * limit
}

/// Current loop: one filament.
#[derive(Clone)]
pub struct Ring {
    radius: f64,
    /// μ₀ × current × turns [T·m].
    strength: f64,
    far: Multipole,
}

/// Thin current sheet on a cylinder; a magnet of remanence `sheet` has the same B.
#[derive(Clone)]
pub struct Shell {
    radius: f64,
    half_length: f64,
    /// μ₀ × current per length [T].
    sheet: f64,
    far: Multipole,
}

/// Terms of the field of a cylinder magnetized across its axis, see `solids::across`.
pub struct Potential {
    /// Field of the same cylinder magnetized along its axis.
    pub axial: AxialField,
    /// Component `N_ρ/ρ` [T]; not near the axis.
    pub radial: f64,
    /// True if the point is near the axis.
    pub is_near_axis: bool,
    /// Remanence [T] inside the cylinder, half of it on its surface, else 0.
    pub inside: f64,
}

impl Ring {
    /// Loop of `radius` [m] with μ₀ × current × turns [T·m].
    pub fn new(radius: f64, strength: f64) -> Self {
        Ring { radius, strength, far: Multipole::ring(radius, strength) }
    }

    /// Field at distance `rho` from the axis and height `z`.
    #[inline]
    pub fn field(&self, rho: f64, z: f64) -> AxialField {
        let limit = FAR * self.far.size;
        if rho * rho + z * z > limit * limit {
            return self.far.field(rho, z);
        }
        let z = Dual { value: z, slope: 1.0 };
        let u = modulus(self.radius, rho, z);
        let (along, radial) = ring(self.radius, rho, z, &u, complete(u.kc2.sqrt(), u.m));
        AxialField {
            along: self.strength * along.value,
            along_slope: self.strength * along.slope,
            radial: self.strength * radial.value,
            radial_slope: self.strength * radial.slope,
        }
    }

    /// True if a point is on the wire.
    pub fn is_singular(&self, rho: f64, z: f64) -> bool {
        is_near(rho - self.radius, z, TOUCH * self.radius)
    }
}

impl Shell {
    /// Shell of `radius` and `half_length` [m] with μ₀ × current per length [T].
    pub fn new(radius: f64, half_length: f64, sheet: f64) -> Self {
        let far = Multipole::shell(radius, half_length, sheet);
        Shell { radius, half_length, sheet, far }
    }

    /// Field at distance `rho` from the axis and height `z` above the center.
    ///
    /// B_z: Derby and Olbert, Am. J. Phys. 78:229 (2010), eq. 1 to 4. The shell is a stack of
    /// loops: ∂B/∂z is the difference of the loops at its ends, B_ρ that of their vector potentials
    /// `4 a² C(m)/(π s³) ρ`. On the shell itself B_z is the mean of both sides.
    #[inline]
    pub fn field(&self, rho: f64, z: f64) -> AxialField {
        let limit = FAR * self.far.size;
        if rho * rho + z * z > limit * limit {
            return self.far.field(rho, z);
        }
        let a = self.radius;
        let ends = Pair([z + self.half_length, z - self.half_length]);
        let u = modulus(a, rho, ends);
        let gamma = (a - rho) / (a + rho);
        let (e, third) = complete_with_third(u.kc2.sqrt(), u.m, gamma);
        let root = u.far.sqrt();
        let along = ends / root * third * (a / (PI * (a + rho)));
        let potential = e.k * e.t / (u.far * root) * (4.0 * a * a / PI);
        let (along_slope, radial_slope) = ring(a, rho, ends, &u, e);
        let difference = |p: Pair| self.sheet * (p.0[0] - p.0[1]);
        AxialField {
            along: difference(along),
            along_slope: difference(along_slope),
            radial: -difference(potential),
            radial_slope: difference(radial_slope),
        }
    }

    /// Potential of a cylinder of this shape, with `sheet` as its remanence.
    ///
    /// `ρN_ρ` of one end is −Q(a, ρ, ζ): symmetric in a and ρ, homogeneous of degree two,
    /// `∂Q/∂ζ = ρ² C`, `∂Q/∂ρ = ρB_z(a, ρ)`, so that `2Q = ρ²B_z(a, ρ) + a²B_z(ρ, a) + ρ²ζC`
    /// (Euler).
    pub fn potential(&self, rho: f64, z: f64) -> Potential {
        let (a, beyond) = (self.radius, z.abs() - self.half_length);
        let share = |depth: f64| {
            if depth > 0.0 {
                1.0
            } else if depth == 0.0 {
                0.5
            } else {
                0.0
            }
        };
        let inside = self.sheet * f64::min(share(a - rho), share(-beyond));
        let limit = FAR * self.far.size;
        let distance = rho.hypot(z);
        if distance > limit {
            let (axial, radial) = self.far.field_and_radial(rho, z);
            return Potential { axial, radial, is_near_axis: rho < NEAR_AXIS * distance, inside };
        }
        let axial = self.field(rho, z);
        if rho < NEAR_AXIS * a {
            return Potential { axial, radial: 0.0, is_near_axis: true, inside };
        }
        let ends = Pair([z + self.half_length, z - self.half_length]);
        let u = modulus(a, rho, ends);
        let gamma = (a - rho) / (a + rho);
        let (e, third) = complete_with_third(u.kc2.sqrt(), u.m, gamma);
        let (_, swapped) = complete_with_third(u.kc2.sqrt(), u.m, -gamma);
        let root = u.far.sqrt();
        let own = third * (a / (PI * (a + rho)));
        let other = swapped * (a * a / (PI * (a + rho) * rho));
        let slope = e.k * e.t / u.far * (4.0 * a * a / PI);
        let sum = ends / root * (own + other + slope) * 0.5;
        let radial = -self.sheet * (sum.0[0] - sum.0[1]);
        Potential { axial, radial, is_near_axis: false, inside }
    }

    /// True if a point is on a rim, where the field has no limit.
    pub fn is_singular(&self, rho: f64, z: f64) -> bool {
        is_near(rho - self.radius, z.abs() - self.half_length, TOUCH * self.radius)
    }
}
