//! Cholesky factor of a symmetric matrix over pairs of nodes.

use super::sparse::Pattern;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side};
use glam::{DMat3, DVec3};

/// Symbolic factorization: order and nonzero entries of the factor, from the pattern alone.
pub struct Symbolic {
    /// Upper triangle by columns, three to a node.
    matrix: SymbolicSparseColMat<u32>,
    factor: SymbolicCholesky<u32>,
}

/// Factor `L Lᵀ = A`, and the work memory of solutions.
pub struct Factor {
    values: Vec<f64>,
    room: MemBuffer,
    right: Vec<f64>,
}

impl Symbolic {
    /// Orders the matrix for little fill (approximate minimum degree).
    pub fn new(pattern: &Pattern) -> Result<Self, String> {
        let (mut starts, mut rows) = (vec![0u32], Vec::new());
        for node in 0..pattern.len() {
            let pairs = &pattern.columns[pattern.starts[node]..pattern.starts[node + 1] - 1];
            for axis in 0..3 {
                rows.extend(pairs.iter().flat_map(|&j| [3 * j, 3 * j + 1, 3 * j + 2]));
                rows.extend((0..=axis).map(|b| 3 * node as u32 + b));
                starts.push(rows.len() as u32);
            }
        }
        let size = 3 * pattern.len();
        let matrix = SymbolicSparseColMat::new_checked(size, size, starts, None, rows);
        let factor = factorize_symbolic_cholesky(
            matrix.as_ref(),
            Side::Upper,
            SymmetricOrdering::Amd,
            CholeskySymbolicParams::default(),
        );
        let factor = factor.map_err(|error| format!("The layer has too many nodes: {error:?}."))?;
        Ok(Symbolic { matrix, factor })
    }

    /// Factorizes `Σ mass·I + weight·stiffness`, both by the lower triangle of `pattern`.
    pub fn factorize(
        &self,
        pattern: &Pattern,
        mass: &[f64],
        stiffness: &[DMat3],
        weight: f64,
    ) -> Result<Factor, &'static str> {
        let mut entries = Vec::with_capacity(self.matrix.row_idx().len());
        for node in 0..pattern.len() {
            let (start, diagonal) = (pattern.starts[node], pattern.starts[node + 1] - 1);
            for axis in 0..3 {
                for k in start..=diagonal {
                    let row = weight * stiffness[k].row(axis);
                    let last = if k == diagonal { axis } else { 2 };
                    let of = |b: usize| row[b] + if b == axis { mass[k] } else { 0.0 };
                    entries.extend((0..=last).map(of));
                }
            }
        }
        let symbolic: SymbolicSparseColMatRef<u32> = self.matrix.as_ref();
        let matrix = SparseColMatRef::new(symbolic, &entries);
        let mut values = vec![0.0; self.factor.len_val()];
        let need = self.factor.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
        let mut room = MemBuffer::new(need);
        let stack = MemStack::new(&mut room);
        let regularization = LltRegularization::default();
        self.factor
            .factorize_numeric_llt(
                &mut values,
                matrix,
                Side::Upper,
                regularization,
                Par::Seq,
                stack,
                Default::default(),
            )
            .map_err(|_| "The layer's stiffness is not positive definite.")?;
        let room = MemBuffer::new(self.factor.solve_in_place_scratch::<f64>(1, Par::Seq));
        Ok(Factor { values, room, right: vec![0.0; 3 * pattern.len()] })
    }

    /// Replaces b by the solution of `A x = b`.
    pub fn solve(&self, factor: &mut Factor, b: &mut [DVec3]) {
        for (to, from) in factor.right.chunks_exact_mut(3).zip(b.iter()) {
            to.copy_from_slice(&from.to_array());
        }
        let size = factor.right.len();
        let right = MatMut::from_column_major_slice_mut(&mut factor.right, size, 1);
        let llt = LltRef::<u32, f64>::new(&self.factor, &factor.values);
        llt.solve_in_place_with_conj(Conj::No, right, Par::Seq, MemStack::new(&mut factor.room));
        for (to, from) in b.iter_mut().zip(factor.right.chunks_exact(3)) {
            *to = DVec3::from_slice(from);
        }
    }

    /// Replaces each b by the solution of `A x = b`.
    pub fn solve_three(&self, factor: &Factor, b: &mut [Vec<DVec3>; 3]) {
        let size = factor.right.len();
        let mut right: Vec<f64> = b.iter().flatten().flat_map(|b| b.to_array()).collect();
        let mut room = MemBuffer::new(self.factor.solve_in_place_scratch::<f64>(3, Par::Seq));
        let llt = LltRef::<u32, f64>::new(&self.factor, &factor.values);
        let columns = MatMut::from_column_major_slice_mut(&mut right, size, 3);
        llt.solve_in_place_with_conj(Conj::No, columns, Par::Seq, MemStack::new(&mut room));
        for (to, from) in b.iter_mut().flatten().zip(right.chunks_exact(3)) {
            *to = DVec3::from_slice(from);
        }
    }

    /// Number of entries of the factor.
    pub fn fill(&self) -> usize {
        self.factor.len_val()
    }
}
