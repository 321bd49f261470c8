//! The test of a fit on points that it has not seen: every tenth one.

use serde::Serialize;

use super::cholesky::Factor;
use super::fit::FitError;
use super::linearised::Neighbours;
use super::session::{Session, solve};
use super::{Matrix, Vector};

/// How well a fit without every tenth point predicts these points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct HeldOut {
    /// Number of points.
    pub points: usize,
    /// Number of their rows.
    pub rows: usize,
    /// Chi-square with the covariance of the points and of the prediction; 0 without rows.
    pub chi2: f64,
    /// Number of points with a reference of all six coordinates.
    pub poses: usize,
    /// Rms of the errors of their poses: metres, radians; NaN without poses.
    pub rms: [f64; 6],
}

impl HeldOut {
    /// Chi-square per row; NaN without rows.
    pub fn per_row(&self) -> f64 {
        self.chi2 / self.rows as f64
    }
}

/// Every point of this number is held out.
pub const EVERY: usize = 10;

impl Session<'_> {
    /// The test at the end of a fit. One linear step replaces the fit without the points, since they hardly
    /// change it.
    pub(super) fn held_out(&mut self, theta: &Vector) -> Result<HeldOut, FitError> {
        let all = self.states.clone();
        let out = self.held_out_points();
        for k in &out {
            self.states[*k] = None;
        }
        let rest = self.assess(theta, false).ok_or(FitError::Singular);
        self.states.clone_from(&all);
        rest?;
        let mut matrix = self.normal.matrix.clone();
        self.prior()?.add_to(&mut matrix, 1.0);
        let factor = Factor::new(matrix).ok_or(FitError::Singular)?;
        let step = solve(&factor, &-(&self.normal.gradient + self.prior()?.times(theta)));
        let instruments = Neighbours::new(self.job.nominal, theta.as_slice());
        let (mut sums, mut squares) = (HeldOut::default(), [0.0; 6]);
        for k in out {
            let Some(start) = &all[k] else { continue };
            let (response, rows) = self.linearise(&instruments, theta, k, start).ok_or(FitError::Singular)?;
            let columns = &self.bases[k].columns;
            let own_step = Vector::from_fn(columns.len(), |i, _| step[columns[i]]);
            let errors = &rows.errors + &rows.jacobian * &own_step;
            let d = errors.len();
            let mut transposed = Matrix::zeros(theta.len(), d);
            for (j, column) in columns.iter().enumerate() {
                for i in 0..d {
                    transposed[(*column, i)] = rows.jacobian[(i, j)];
                }
            }
            let half = factor.half_solve(&transposed);
            let covariance = Matrix::identity(d, d) + half.tr_mul(&half);
            let root = nalgebra::Cholesky::new(covariance).ok_or(FitError::Singular)?;
            sums.points += 1;
            sums.rows += d;
            sums.chi2 += errors.dot(&root.solve(&errors));
            if self.job.points[k].has_pose() {
                sums.poses += 1;
                let raw = response.errors + &response.jacobian * &own_step;
                for (sum, error) in squares.iter_mut().zip(raw.iter()) {
                    *sum += error * error;
                }
            }
        }
        sums.rms = squares.map(|sum| (sum / sums.poses as f64).sqrt());
        Ok(sums)
    }

    /// Every tenth of the points that are used and belong to no scan.
    fn held_out_points(&self) -> Vec<usize> {
        let points = self.job.points.iter().zip(&self.states).enumerate();
        let used = points.filter(|(_, (point, state))| state.is_some() && point.run.is_none());
        used.map(|(k, _)| k).skip(EVERY / 2).step_by(EVERY).collect()
    }
}
