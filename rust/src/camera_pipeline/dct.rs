//! Discrete cosine transform of blocks of 8 × 8 values.

/// Values of a block, row by row.
pub type Block = [f32; 64];
/// A matrix of 8 × 8 values.
pub type Basis = [[f32; 8]; 8];

/// Matrix whose rows are the orthonormal cosines of the transform of 8 values.
fn basis() -> Basis {
    let mut rows = [[0.0; 8]; 8];
    for (k, row) in rows.iter_mut().enumerate() {
        let scale = if k == 0 { 0.125f64.sqrt() } else { 0.5 };
        for (x, value) in row.iter_mut().enumerate() {
            let angle = (2 * x + 1) as f64 * k as f64 * std::f64::consts::PI / 16.0;
            *value = (scale * libm::cos(angle)) as f32;
        }
    }
    rows
}

/// `M B Mᵀ`, given M and Mᵀ.
#[inline(always)]
pub fn transform_2d(m: &Basis, transposed: &Basis, block: &Block) -> Block {
    let (mut half, mut out) = ([[0.0; 8]; 8], [0.0; 64]);
    for k in 0..8 {
        for y in 0..8 {
            for x in 0..8 {
                half[k][x] += m[k][y] * block[y * 8 + x];
            }
        }
    }
    for y in 0..8 {
        for x in 0..8 {
            for k in 0..8 {
                out[y * 8 + k] += half[y][x] * transposed[x][k];
            }
        }
    }
    out
}

fn transposed(m: &Basis) -> Basis {
    let mut out = [[0.0; 8]; 8];
    for y in 0..8 {
        for x in 0..8 {
            out[y][x] = m[x][y];
        }
    }
    out
}

/// Matrices of the cosine transform and its inverse, in the form that `transform_2d` takes.
pub fn bases() -> ([Basis; 2], [Basis; 2]) {
    let basis = basis();
    let back = transposed(&basis);
    ([basis, back], [back, basis])
}
