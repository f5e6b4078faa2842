//! Double-precision lanes: arithmetic written once for several values, which the compiler turns
//! into vector code of the machine's width. Nothing is fused, reordered or delegated to a system's
//! mathematics library: results are bit-identical on every processor.

use glam::DVec3;

/// Number of values in a lane.
pub const LANES: usize = 8;
/// Eight values.
pub type Lane = [f64; LANES];
/// Eight vectors, by component.
pub type Lane3 = [Lane; 3];

/// Vector of lane `i`.
#[inline(always)]
pub fn at(v: &Lane3, i: usize) -> DVec3 {
    DVec3::new(v[0][i], v[1][i], v[2][i])
}

/// Sets the vector of lane `i`.
#[inline(always)]
pub fn put(v: &mut Lane3, i: usize, value: DVec3) {
    (v[0][i], v[1][i], v[2][i]) = (value.x, value.y, value.z);
}

/// Sum over the lanes, always in the same order.
#[inline(always)]
pub fn sum(lane: &Lane) -> f64 {
    let [a, b, c, d, e, f, g, h] = *lane;
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}

/// The smaller value; one instruction, unlike `f64::min`, which also handles NaN.
#[inline(always)]
pub fn min(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// The larger value.
#[inline(always)]
pub fn max(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// Adding this rounds to an integer and leaves it in the low bits: 1.5 · 2⁵².
const ROUND: f64 = 6_755_399_441_055_744.0;

/// Reciprocals of the factorials of 12, 11, … 2.
const TAYLOR: [f64; 11] = [
    1.0 / 479_001_600.0,
    1.0 / 39_916_800.0,
    1.0 / 3_628_800.0,
    1.0 / 362_880.0,
    1.0 / 40_320.0,
    1.0 / 5_040.0,
    1.0 / 720.0,
    1.0 / 120.0,
    1.0 / 24.0,
    1.0 / 6.0,
    0.5,
];

/// `eˣ − 1` for |x| < 700, relative error below 1e-15.
#[inline(always)]
pub fn exp_m1(x: f64) -> f64 {
    let shifted = x * std::f64::consts::LOG2_E + ROUND;
    let whole = shifted - ROUND;
    // ln 2 in two parts, so that `whole` times the first is exact.
    let r = (x - whole * 0.693_147_180_369_123_8) - whole * 1.908_214_929_270_587_7e-10;
    let mut series = 1.0 / 6_227_020_800.0;
    for k in 0..TAYLOR.len() {
        series = series * r + TAYLOR[k];
    }
    let growth = r + r * r * series;
    let power = f64::from_bits(shifted.to_bits().wrapping_add(1023) << 52);
    growth * power + (power - 1.0)
}

/// Natural logarithm of a positive normal number, absolute error below 1e-15 of its size or of 1.
///
/// The mantissa m in [√½, √2) is evaluated by the odd series of `ln m = 2 artanh((m−1)/(m+1))`.
#[inline(always)]
pub fn ln(x: f64) -> f64 {
    const HALF_ROOT: u64 = 0x3fe6_a09e_667f_3bcd;
    let bits = x.to_bits().wrapping_sub(HALF_ROOT);
    let mantissa = f64::from_bits((bits & 0x000f_ffff_ffff_ffff) + HALF_ROOT);
    // Converts the exponent without a conversion that not every processor has in lanes.
    let biased = f64::from_bits(((bits >> 52).wrapping_add(1024) & 0xfff) | 0x4330_0000_0000_0000);
    let exponent = biased - (4_503_599_627_370_496.0 + 1024.0);
    let s = (mantissa - 1.0) / (mantissa + 1.0);
    let s2 = s * s;
    let mut series = 1.0 / 21.0;
    for k in 0..9 {
        series = series * s2 + 1.0 / (19 - 2 * k) as f64;
    }
    exponent * std::f64::consts::LN_2 + 2.0 * (s + s * s2 * series)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_the_standard_library() {
        for k in -4000..20_000 {
            let x = f64::from(k) * 1.237e-3;
            assert!((exp_m1(x) - x.exp_m1()).abs() <= 4e-15 * x.exp_m1().abs(), "{x}");
            let y = 1e-9 * (1.0 + 0.001 * f64::from(k + 4000)).powi(9);
            assert!((ln(y) - y.ln()).abs() <= 1e-15 * y.ln().abs().max(1.0), "{y}");
        }
        assert_eq!(exp_m1(0.0), 0.0);
        assert_eq!(ln(1.0), 0.0);
        assert!((ln(1e-300) - 1e-300f64.ln()).abs() < 1e-12);
        assert!((ln(1e300) - 1e300f64.ln()).abs() < 1e-12);
    }
}
