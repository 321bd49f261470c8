//! The normal equations: data and priors.

use super::cholesky::Factor;
use super::linearised::{Layout, Rows};
use super::map::{Field, degrees};
use super::parameters::{GEOMETRY, Parameter, Tolerances, parameters, place};
use super::{Matrix, Vector};

/// A zero of a run is known to no better than this before the fit: metres, radians.
const ZERO_DEVIATION: f64 = 1.0;

/// Sums over the points: lower triangle of `J' J`, and `J' e`.
#[derive(Clone, Debug)]
pub(super) struct Normal {
    pub matrix: Matrix,
    pub gradient: Vector,
    /// Scratch: the same of a single point.
    own: Matrix,
}

impl Normal {
    pub fn new(n: usize) -> Self {
        Self { matrix: Matrix::zeros(n, n), gradient: Vector::zeros(n), own: Matrix::zeros(0, 0) }
    }

    pub fn clear(&mut self) {
        self.matrix.fill(0.0);
        self.gradient.fill(0.0);
    }

    /// Adds the rows of a point, with this weight. `columns` ascend.
    pub fn add(&mut self, rows: &Rows, columns: &[usize], weight: f64) {
        let n = columns.len();
        if self.own.nrows() != n {
            self.own = Matrix::zeros(n, n);
        }
        self.own.gemm(weight, &rows.jacobian.transpose(), &rows.jacobian, 0.0);
        let gradient = rows.jacobian.tr_mul(&rows.errors);
        for (j, column) in columns.iter().enumerate() {
            self.gradient[*column] += weight * gradient[j];
            let mut target = self.matrix.column_mut(*column);
            for (row, value) in columns[j..].iter().zip(self.own.column(j).rows_range(j..).iter()) {
                target[*row] += value;
            }
        }
    }
}

/// The inverse covariance of all parameters before any data.
#[derive(Clone, Debug)]
pub(super) struct Prior {
    /// Of geometry, zeros and polynomials, which are independent; the steering matrix may not be.
    diagonal: Vec<f64>,
    /// Of the shear of the steering: off-diagonal element of (xy, yx).
    shear: f64,
    /// Of one coordinate of the splines of each PSD.
    splines: [Matrix; 3],
    /// First spline of each coordinate.
    starts: Vec<(usize, usize)>,
    ln_determinant: f64,
}

impl Prior {
    /// `None` if the covariance of the splines is not positive definite.
    pub fn new(layout: &Layout, tolerances: &Tolerances, field: &Field) -> Option<Self> {
        let mut deviations: Vec<f64> =
            parameters(tolerances).iter().map(|p: &Parameter| p.deviation).collect();
        deviations.resize(GEOMETRY + 6 * layout.runs, ZERO_DEVIATION);
        let by_degree = degrees().map(|(i, j)| tolerances.psd_error_um[i + j - 1] * 1e-6);
        let by_degree: Vec<f64> = by_degree.collect();
        for _ in 0..6 {
            deviations.extend_from_slice(&by_degree);
        }
        let mut diagonal: Vec<f64> = deviations.iter().map(|d| d.powi(-2)).collect();
        let mut shear = 0.0;
        if let Some(percent) = tolerances.steering_scale_percent {
            // The rotation (xy - yx)/2 is as unknown as before; the rest is known better.
            let (scale, rotation) = ((percent * 1e-2).powi(-2), diagonal[place::MATRIX.at + 1]);
            [diagonal[place::MATRIX.at], diagonal[place::MATRIX.at + 3]] = [scale; 2];
            let (sum, difference) = (0.25 * scale, 0.25 * rotation);
            [diagonal[place::MATRIX.at + 1], diagonal[place::MATRIX.at + 2]] = [sum + difference; 2];
            shear = sum - difference;
        }
        let mut ln_determinant = 0.0;
        let mut splines = [Matrix::zeros(0, 0), Matrix::zeros(0, 0), Matrix::zeros(0, 0)];
        for (inverse, lattice) in splines.iter_mut().zip(&layout.lattices) {
            let n = lattice.len();
            if n > 0 {
                let factor = Factor::new(lattice.covariance(field))?;
                ln_determinant -= 2.0 * factor.ln_determinant();
                *inverse = factor.solve(&Matrix::identity(n, n));
            }
        }
        let starts = super::linearised::coordinates().map(|(psd, c)| (psd, layout.splines(psd, c))).collect();
        // The other parameters have the same prior whatever the field, and cancel in comparisons.
        Some(Self { diagonal, shear, splines, starts, ln_determinant })
    }

    /// Adds a multiple of the prior to the lower triangle of a matrix.
    pub fn add_to(&self, matrix: &mut Matrix, weight: f64) {
        for (i, q) in self.diagonal.iter().enumerate() {
            matrix[(i, i)] += weight * q;
        }
        matrix[(place::MATRIX.at + 2, place::MATRIX.at + 1)] += weight * self.shear;
        for (psd, from) in &self.starts {
            let q = &self.splines[*psd];
            let mut target = matrix.view_mut((*from, *from), q.shape());
            target.zip_apply(q, |sum, q| *sum += weight * q);
        }
    }

    /// Prior matrix times parameters.
    pub fn times(&self, theta: &Vector) -> Vector {
        let mut product = Vector::zeros(theta.len());
        for (i, q) in self.diagonal.iter().enumerate() {
            product[i] = q * theta[i];
        }
        let [xy, yx] = [place::MATRIX.at + 1, place::MATRIX.at + 2];
        product[xy] += self.shear * theta[yx];
        product[yx] += self.shear * theta[xy];
        for (psd, from) in &self.starts {
            let q = &self.splines[*psd];
            let part = q * theta.rows(*from, q.nrows());
            product.rows_mut(*from, q.nrows()).copy_from(&part);
        }
        product
    }

    /// Logarithm of the determinant of the part that depends on the field.
    pub fn ln_determinant(&self) -> f64 {
        self.ln_determinant
    }
}
