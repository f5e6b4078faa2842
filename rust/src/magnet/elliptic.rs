//! Complete elliptic integrals by the arithmetic-geometric mean, without cancellation.
//!
//! With `Δ² = cos²θ + k′² sin²θ`, `m = 1 − k′²`, and `A_n = 2ⁿ a_n`, `B_n = 2ⁿ b_n` the scaled
//! means from `a_0 = 1`, `b_0 = k′` (Bulirsch, Numer. Math. 7:78, 1965): `K = π/2 · 2ᴺ/A_N`. The
//! differences `c_n = (a_{n−1} − b_{n−1})/2` are proportional to m, `c_n = m D_n/2ⁿ`, with
//! `D_1 = 1/A_1` and `D_{n+1} = m D_n²/A_{n+1}`. From `1 − E/K = Σ_{n≥0} 2^{n−1} c_n²` follows
//!
//! ```text
//! C(m) = ∫ sin²θ cos²θ / Δ³ dθ = K T,    T = Σ_{n≥1} D_n²/2ⁿ
//! D(m) = ∫ sin²θ / Δ dθ = K (1 + m T)/2,    E = K − m D
//! ```
//!
//! All are sums of positive terms, accurate near the axis, where m goes to 0.

use super::dual::{Number, Pair};
use std::f64::consts::FRAC_PI_2;

/// Relative difference of the means after which one more step is exact to machine precision.
const CLOSE: f64 = 1e-8;
/// Weight 2⁻ⁿ after more steps than any k′ above 1e-150 requires.
const LEAST_WEIGHT: f64 = 2.5e-4;

/// The integrals K and T = C/K of one modulus.
#[derive(Clone, Copy)]
pub struct Complete<N> {
    /// Complete elliptic integral of the first kind.
    pub k: N,
    /// Sum Σ D_n²/2ⁿ, see above.
    pub t: N,
}

/// Means and sums over them.
struct Means<N> {
    a: N,
    b: N,
    d: N,
    t: N,
    weight: f64,
}

impl<N: Number> Means<N> {
    #[inline(always)]
    fn new(kc: N) -> Self {
        let a = kc + 1.0;
        let d = N::constant(1.0) / a;
        Means { a, b: kc.sqrt() * 2.0, d, t: d * d * 0.5, weight: 0.5 }
    }

    #[inline(always)]
    fn is_done(&self) -> bool {
        self.b.is_close(self.a, CLOSE) || self.weight < LEAST_WEIGHT
    }

    /// Advances by one step, given the square root of the means' product.
    #[inline(always)]
    fn advance(&mut self, m: N, root: N) {
        let a = self.a + self.b;
        self.b = root * 2.0;
        self.a = a;
        self.d = m * self.d * self.d / a;
        self.weight *= 0.5;
        self.t = self.t + self.d * self.d * self.weight;
    }

    #[inline(always)]
    fn result(&self) -> Complete<N> {
        let scale = FRAC_PI_2 / self.weight;
        Complete { k: N::constant(scale) / (self.a + self.b) * 2.0, t: self.t }
    }
}

/// K and T for the complementary modulus `kc` > 0, where `m = 1 − kc²` is given exactly.
#[inline(always)]
pub fn complete<N: Number>(kc: N, m: N) -> Complete<N> {
    let mut means = Means::new(kc);
    while !means.is_done() {
        let root = (means.a * means.b).sqrt();
        means.advance(m, root);
    }
    means.result()
}

/// K and T, and `∫ (cos²θ + γ sin²θ)/((cos²θ + γ² sin²θ) Δ) dθ` (Bulirsch's `cel(kc, γ², 1, γ)`).
///
/// For γ = 0 the integral is K: the mean of its values for small γ on either side.
#[inline(always)]
pub fn complete_with_third(kc: Pair, m: Pair, gamma: f64) -> (Complete<Pair>, Pair) {
    let mut means = Means::new(kc);
    if gamma == 0.0 {
        let both = complete(kc, m);
        return (both, both.k);
    }
    let size = Pair::constant(gamma.abs());
    let sign = Pair::constant(gamma.signum());
    let (mut p, mut c, mut s) = (size, Pair::constant(1.0), sign);
    let mut product = kc;
    let mut is_last = false;
    loop {
        let inverse = Pair::constant(1.0) / p;
        let (f, g) = (c, product * inverse);
        c = c + s * inverse;
        s = (s + f * g) * 2.0;
        p = p + g;
        if is_last {
            break;
        }
        is_last = means.is_done();
        product = means.a * means.b;
        means.advance(m, product.sqrt());
    }
    let both = means.result();
    (both, (s + c * means.a) / (means.a * (means.a + p)) * FRAC_PI_2)
}
