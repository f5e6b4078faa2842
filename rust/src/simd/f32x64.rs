//! Lanes: the 64 rays of one tile, and arithmetic written once for all of them.
//!
//! Every hot loop of the core runs over plain arrays of `LANES` values, so that the compiler turns
//! it into vector code of the machine's width. No operation is fused or reordered: results are
//! bit-identical on every processor.

/// Width and height of a tile in pixels.
pub const TILE: usize = 8;
/// Number of rays of one tile.
pub const LANES: usize = TILE * TILE;
/// One value for each ray of a tile.
pub type Lane = [f32; LANES];
/// One vector for each ray of a tile, by component.
pub type Lane3 = [Lane; 3];

/// A vector of three components.
pub type Vec3 = [f32; 3];

/// `a − b`.
#[inline(always)]
pub fn sub(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `a + b`.
#[inline(always)]
pub fn add(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// Corners of a box along the axes, the low one first.
pub type Corners = (Vec3, Vec3);

/// A box without points.
pub const EMPTY_BOX: Corners = ([f32::MAX; 3], [f32::MIN; 3]);

/// Extends a box to a point.
#[inline(always)]
pub fn enclose((low, high): &mut Corners, point: Vec3) {
    for k in 0..3 {
        low[k] = min(low[k], point[k]);
        high[k] = max(high[k], point[k]);
    }
}

/// `a · s`.
#[inline(always)]
pub fn scale(a: Vec3, s: f32) -> Vec3 {
    [a[0] * s, a[1] * s, a[2] * s]
}

/// Scalar product.
#[inline(always)]
pub fn dot(a: Vec3, b: Vec3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Cross product.
#[inline(always)]
pub fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// `a` scaled to unit length; zero stays zero.
#[inline(always)]
pub fn normalize(a: Vec3) -> Vec3 {
    let square = dot(a, a);
    scale(a, if square > 0.0 { 1.0 / square.sqrt() } else { 0.0 })
}

/// The smaller value; one instruction, unlike `f32::min`, which also handles NaN.
#[inline(always)]
pub fn min(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// The larger value.
#[inline(always)]
pub fn max(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// `x` clamped to the range from `low` to `high`.
#[inline(always)]
pub fn clamp(x: f32, low: f32, high: f32) -> f32 {
    min(max(x, low), high)
}

/// Vector of lane `i`.
#[inline(always)]
pub fn at<const N: usize>(v: &[[f32; N]; 3], i: usize) -> Vec3 {
    [v[0][i], v[1][i], v[2][i]]
}

/// Base-2 logarithm of a positive normal number, relative error below 3e-7 of its magnitude.
///
/// The mantissa m in [√½, √2) is evaluated by the odd series of `ln m = 2 artanh((m−1)/(m+1))`.
#[inline(always)]
pub fn log2(x: f32) -> f32 {
    let bits = x.to_bits().wrapping_sub(0x3f35_04f3);
    let exponent = (bits as i32) >> 23;
    let mantissa = f32::from_bits((bits & 0x007f_ffff) + 0x3f35_04f3);
    let s = (mantissa - 1.0) / (mantissa + 1.0);
    let s2 = s * s;
    let series = 2.885_39 + s2 * (0.961_796_7 + s2 * (0.577_078 + s2 * 0.412_198_6));
    exponent as f32 + s * series
}

/// 2 to the power `x`, for −126 < x < 126, relative error below 2e-7.
#[inline(always)]
pub fn exp2(x: f32) -> f32 {
    let x = clamp(x, -126.0, 126.0);
    // Adding 1.5 · 2²³ rounds to an integer and leaves it in the low bits.
    let shifted = x + 12_582_912.0;
    let f = x - (shifted - 12_582_912.0);
    let series = 1.0
        + f * (std::f32::consts::LN_2
            + f * (0.240_226_5
                + f * (0.055_504_11
                    + f * (0.009_618_129 + f * (0.001_333_355_8 + f * 0.000_154_035_3)))));
    f32::from_bits((shifted.to_bits().wrapping_add(127)) << 23) * series
}

/// `x` to the power `y` for x ≥ 0 and y > 0.
#[inline(always)]
pub fn pow(x: f32, y: f32) -> f32 {
    let result = exp2(y * log2(max(x, 1e-30)));
    if x > 1e-30 { result } else { 0.0 }
}

/// Loads the first values of a slice, padded with 0.
#[inline(always)]
pub fn load<const N: usize>(row: &[f32]) -> [f32; N] {
    if let Some(whole) = row.first_chunk::<N>() {
        return *whole;
    }
    let mut values = [0.0; N];
    values[..row.len()].copy_from_slice(row);
    values
}

/// Stores values at the start of a slice, as far as it extends.
#[inline(always)]
pub fn store<T: Copy, const N: usize>(values: &[T; N], row: &mut [T]) {
    match row.first_chunk_mut::<N>() {
        Some(whole) => *whole = *values,
        None => store_some(values, row),
    }
}

/// A separate function, so that a full array is stored without a call.
#[cold]
#[inline(never)]
fn store_some<T: Copy>(values: &[T], row: &mut [T]) {
    row.copy_from_slice(&values[..row.len()]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_agree_with_the_standard_library() {
        for k in 1..20_000 {
            let x = k as f32 * 1e-3;
            let relative = (pow(x, 1.0 / 2.4) / (x as f64).powf(1.0 / 2.4) as f32 - 1.0).abs();
            assert!(relative < 1e-6, "{x}: {relative}");
            assert!((log2(x) - x.log2()).abs() < 2e-6);
            assert!((exp2(x - 10.0) / (x - 10.0).exp2() - 1.0).abs() < 1e-6);
        }
        assert_eq!(pow(0.0, 0.5), 0.0);
        assert_eq!(pow(1.0, 0.3), 1.0);
    }
}
