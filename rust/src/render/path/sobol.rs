//! Owen-scrambled Sobol points: the first two dimensions of Sobol's sequence (1967), scrambled
//! after Owen (1995) by hashing (Burley 2020, *Practical hash-based Owen scrambling*).
//!
//! A random number depends only on the seed, the pixel, the dimension and the sample, not on
//! threads or the order in which paths are traced.

/// First dimension of the points of LEDs' discs; paths use four dimensions per reflection.
pub const DISC_DIMENSION: u32 = 500;

/// Pseudorandom integer (Wellons 2018, `lowbias32`).
#[inline(always)]
pub fn hash(x: u32) -> u32 {
    let x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
    let x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// Random number 0 ≤ x < 1 from the upper bits.
#[inline(always)]
pub fn unit(bits: u32) -> f32 {
    (bits >> 8) as i32 as f32 * (1.0 / 16_777_216.0)
}

/// Key of a dimension of a pixel's random numbers.
#[inline(always)]
pub fn dimension(pixel_key: u32, number: u32) -> u32 {
    hash(pixel_key ^ number.wrapping_mul(0x9e37_79b9))
}

/// Point `index` of the sequence of `key`.
#[inline(always)]
pub fn point(key: u32, index: u32) -> [f32; 2] {
    let order = mix(index.reverse_bits(), key).reverse_bits();
    let x = mix(order, hash(key ^ 0x68bc_21eb));
    let y = mix(second(order), hash(key ^ 0x02e5_be93));
    [unit(x.reverse_bits()), unit(y.reverse_bits())]
}

/// Second Sobol dimension, lowest bit first; the first dimension is `index` itself.
///
/// Its matrix is Pascal's triangle modulo 2: it replaces x by 1 + x in the polynomial whose
/// coefficients are the bits, and (1 + x)^2ᵏ = 1 + x^2ᵏ lets halves be treated at once.
#[inline(always)]
fn second(index: u32) -> u32 {
    let x = index ^ (index >> 16);
    let x = x ^ ((x & 0xff00_ff00) >> 8);
    let x = x ^ ((x & 0xf0f0_f0f0) >> 4);
    let x = x ^ ((x & 0xcccc_cccc) >> 2);
    x ^ ((x & 0xaaaa_aaaa) >> 1)
}

/// Owen scrambling of bits, lowest first: each is flipped or not, depending on those below it
/// (Laine and Karras 2011, with the constants of Vegdahl 2021).
#[inline(always)]
fn mix(x: u32, key: u32) -> u32 {
    let x = x ^ x.wrapping_mul(0x3d20_adea);
    let x = x.wrapping_add(key).wrapping_mul((key >> 16) | 1);
    let x = x ^ x.wrapping_mul(0x0552_6c56);
    x ^ x.wrapping_mul(0x53a2_2864)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of 2ᵐ points each box of 2⁻ᵏ by 2ᵏ⁻ᵐ contains one.
    #[test]
    fn every_elementary_box_holds_one_point() {
        for key in (0..40).map(hash) {
            for m in 0..=8 {
                let count = 1usize << m;
                for k in 0..=m {
                    let mut seen = vec![false; count];
                    for index in 0..count as u32 {
                        let [x, y] = point(key, index);
                        let (columns, rows) = (1usize << k, count >> k);
                        let cell =
                            (x * columns as f32) as usize * rows + (y * rows as f32) as usize;
                        assert!(!seen[cell], "key {key}, {count} points, {columns} columns");
                        seen[cell] = true;
                    }
                }
            }
        }
    }

    #[test]
    fn keys_are_independent() {
        let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
        let firsts: Vec<[f32; 2]> = (0..20_000).map(|p| point(dimension(hash(p), 3), 0)).collect();
        for k in 0..2 {
            let column: Vec<f32> = firsts.iter().map(|p| p[k] - 0.5).collect();
            let square: Vec<f32> = column.iter().map(|x| x * x).collect();
            let product: Vec<f32> = column.windows(2).map(|w| w[0] * w[1]).collect();
            assert!(mean(&column).abs() < 0.01);
            assert!((mean(&square) - 1.0 / 12.0).abs() < 0.002);
            assert!(mean(&product).abs() < 0.002);
        }
    }
}
