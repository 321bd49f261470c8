//! Cholesky factorisation of large matrices, by blocks: nearly all work is products of matrices.

use super::Matrix;

/// Columns per block.
const BLOCK: usize = 96;

/// The factor `L` of a positive definite matrix `A = S L L' S`, with `S` the roots of the diagonal of `A`.
#[derive(Clone, Debug)]
pub struct Factor {
    lower: Matrix,
    scale: Vec<f64>,
}

impl Factor {
    /// Factors a matrix of which the lower triangle is given; `None` if it is not positive definite.
    pub fn new(mut a: Matrix) -> Option<Self> {
        let scale: Vec<f64> = a.diagonal().iter().map(|d| d.sqrt()).collect();
        if !scale.iter().all(|s| s.is_finite() && *s > 0.0) {
            return None;
        }
        for (j, mut column) in a.column_iter_mut().enumerate() {
            for (i, x) in column.iter_mut().enumerate() {
                *x = if i < j { 0.0 } else { *x / (scale[i] * scale[j]) };
            }
        }
        factorise(&mut a)?;
        Some(Self { lower: a, scale })
    }

    /// The factor from its lower triangle, column by column, and the scale.
    pub fn from_parts(packed: &[f64], scale: Vec<f64>) -> Option<Self> {
        let n = scale.len();
        let usable = packed.len() == n * (n + 1) / 2 && scale.iter().all(|s| *s > 0.0);
        if !usable {
            return None;
        }
        let mut lower = Matrix::zeros(n, n);
        let mut from = 0;
        for j in 0..n {
            lower.view_mut((j, j), (n - j, 1)).copy_from_slice(&packed[from..from + n - j]);
            from += n - j;
        }
        Some(Self { lower, scale })
    }

    /// The lower triangle, column by column.
    pub fn packed(&self) -> impl Iterator<Item = f64> {
        self.lower.column_iter().enumerate().flat_map(|(j, column)| {
            let column: Vec<f64> = column.rows_range(j..).iter().copied().collect();
            column
        })
    }

    /// The scale: roots of the diagonal of the matrix.
    pub fn scale(&self) -> &[f64] {
        &self.scale
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.scale.len()
    }

    /// Whether the matrix has no rows.
    pub fn is_empty(&self) -> bool {
        self.scale.is_empty()
    }

    /// Logarithm of the determinant of the matrix.
    pub fn ln_determinant(&self) -> f64 {
        let diagonal = self.lower.diagonal();
        2.0 * diagonal.iter().zip(&self.scale).map(|(l, s)| l.ln() + s.ln()).sum::<f64>()
    }

    /// `L^-1 S^-1 B`: the product of its transpose with itself is `B' A^-1 B`.
    pub fn half_solve(&self, b: &Matrix) -> Matrix {
        let mut x = b.clone();
        for mut column in x.column_iter_mut() {
            for (x, s) in column.iter_mut().zip(&self.scale) {
                *x /= s;
            }
        }
        let (n, m) = (self.len(), x.ncols());
        for from in (0..n).step_by(BLOCK) {
            let width = BLOCK.min(n - from);
            let (mut above, mut below) = x.rows_range_pair_mut(from..from + width, from + width..);
            let diagonal = self.lower.view((from, from), (width, width));
            diagonal.solve_lower_triangular_mut(&mut above);
            if from + width < n && m > 0 {
                let panel = self.lower.view((from + width, from), (n - from - width, width));
                below.gemm(-1.0, &panel, &above, 1.0);
            }
        }
        x
    }

    /// `A^-1 B`.
    pub fn solve(&self, b: &Matrix) -> Matrix {
        let mut x = self.half_solve(b);
        let n = self.len();
        let starts: Vec<usize> = (0..n).step_by(BLOCK).collect();
        for from in starts.into_iter().rev() {
            let width = BLOCK.min(n - from);
            let (mut above, below) = x.rows_range_pair_mut(from..from + width, from + width..);
            if from + width < n {
                let panel = self.lower.view((from + width, from), (n - from - width, width));
                above.gemm_tr(-1.0, &panel, &below, 1.0);
            }
            self.lower.view((from, from), (width, width)).tr_solve_lower_triangular_mut(&mut above);
        }
        for mut column in x.column_iter_mut() {
            for (x, s) in column.iter_mut().zip(&self.scale) {
                *x /= s;
            }
        }
        x
    }
}

/// Replaces the lower triangle by its factor.
fn factorise(a: &mut Matrix) -> Option<()> {
    let n = a.nrows();
    for from in (0..n).step_by(BLOCK) {
        let width = BLOCK.min(n - from);
        let block = a.view((from, from), (width, width)).clone_owned();
        let block = nalgebra::Cholesky::new(block)?.unpack();
        a.view_mut((from, from), (width, width)).copy_from(&block);
        let rest = n - from - width;
        if rest == 0 {
            break;
        }
        // panel L' = old panel, solved as L panel' = old panel'
        let mut panel_t = a.view((from + width, from), (rest, width)).transpose();
        block.solve_lower_triangular_mut(&mut panel_t);
        a.view_mut((from + width, from), (rest, width)).tr_copy_from(&panel_t);
        for at in (0..rest).step_by(BLOCK) {
            let columns = BLOCK.min(rest - at);
            let (left, mut right) = a.columns_range_pair_mut(from..from + width, from + width + at..);
            let mut target = right.view_mut((from + width + at, 0), (rest - at, columns));
            let rows = left.view((from + width + at, 0), (rest - at, width));
            target.gemm(-1.0, &rows, &panel_t.columns(at, columns), 1.0);
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A positive definite matrix with widely different scales.
    fn matrix(n: usize) -> Matrix {
        let b = Matrix::from_fn(n, n, |i, j| ((i * 7919 + j * 104_729) % 1009) as f64 / 1009.0 - 0.5);
        let mut a = &b * b.transpose() + Matrix::identity(n, n);
        let scale = |i: usize| 10_f64.powi(i as i32 % 9 - 4);
        for i in 0..n {
            for j in 0..n {
                a[(i, j)] *= scale(i) * scale(j);
            }
        }
        a
    }

    #[test]
    fn large_matrices_are_solved() {
        for n in [1, 50, BLOCK, BLOCK + 1, 3 * BLOCK + 17] {
            let a = matrix(n);
            let factor = Factor::new(a.clone()).unwrap();
            let wanted = Matrix::from_fn(n, 3, |i, j| (i + j) as f64 / n as f64);
            let b = &a * &wanted;
            let solved = factor.solve(&b);
            let off = Matrix::from_fn(n, 3, |i, j| (solved[(i, j)] - wanted[(i, j)]) * factor.scale[i]);
            assert!(off.norm() < 1e-10 * a.diagonal().max().sqrt(), "{n}: {}", off.norm());
            let half = factor.half_solve(&b);
            let (ours, theirs) = (half.tr_mul(&half), b.transpose() * &solved);
            assert!((&ours - &theirs).norm() < 1e-10 * theirs.norm());
            if let Some(cholesky) = nalgebra::Cholesky::new(a) {
                let wanted = 2.0 * cholesky.l_dirty().diagonal().iter().map(|x| x.ln()).sum::<f64>();
                assert!((factor.ln_determinant() - wanted).abs() < 1e-9 * wanted.abs().max(1.0));
            }
            let packed: Vec<f64> = factor.packed().collect();
            let again = Factor::from_parts(&packed, factor.scale.clone()).unwrap();
            assert_eq!(again.lower, factor.lower);
        }
    }

    #[test]
    fn an_indefinite_matrix_is_refused() {
        let mut a = matrix(200);
        a[(150, 150)] = -1.0;
        assert!(Factor::new(a.clone()).is_none());
        a[(150, 150)] = f64::NAN;
        assert!(Factor::new(a).is_none());
        assert!(Factor::from_parts(&[1.0; 3], vec![1.0; 3]).is_none());
    }
}
