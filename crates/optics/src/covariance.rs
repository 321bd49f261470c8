//! Propagation of the noise of the signals to the result.

use nalgebra::{Matrix6, SMatrix, SVector, Vector6};

use super::jacobian::{Linearised, Residual};
use super::tilted::Follow;
use super::{Estimator, Solution, SolveError, Vec2, Vec3};

/// Standard uncertainty of each signal, in its unit; the signals are taken as independent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Of u, v of A, B, C, metres.
    pub spots: [f64; 6],
    /// Of the power on A, B, C.
    pub powers: [f64; 3],
}

/// The derivatives of the result with respect to the signals.
///
/// Rows: tx, ty, tz (m), roll, pitch, yaw (rad), beam offset x, y (m).
/// Columns: u, v of A, B, C (m), powers of A, B, C (their unit).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensitivity(pub SMatrix<f64, 8, 9>);

/// Effect of one standard uncertainty of each of `N` independent signals on the result, rows as in
/// [`Sensitivity`]: a square root of its covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorPropagation<const N: usize>(pub SMatrix<f64, 8, N>);

impl Estimator {
    /// The sensitivity at a solution.
    ///
    /// The equations are linearised again for this. Those that the solver keeps from sample to sample may be
    /// wrong by a fifth where the solver does not need them accurately (the powers of a slowly moving beam).
    ///
    /// # Errors
    /// The equations are singular at the solution.
    pub fn sensitivity(&self, solution: &Solution) -> Result<Sensitivity, SolveError> {
        let singular = || SolveError::Singular { iterations: solution.iterations };
        let tilted =
            self.optics().along_light(solution.pose.t, solution.offset).map(|(parallel, _)| parallel);
        let optics = tilted.as_ref().map_or(self.optics(), |parallel| &parallel.optics);
        let light = solution.light(optics, self.model());
        let equations = Linearised::new(optics, &light).ok_or_else(singular)?;
        let follow = tilted.as_ref().map(|parallel| Follow::new(parallel, solution, &light, &equations));
        let to_world = optics.to_world;
        let turn = solution.pose.euler_rates() * to_world;
        let mut matrix = SMatrix::<f64, 8, 9>::zeros();
        for signal in 0..9 {
            let mut step = equations.solve(&solution.unit_residual(signal));
            if let Some(follow) = &follow {
                step = follow.step(step).ok_or_else(singular)?;
            }
            let (dt, dw, doffset) = step;
            let (t, w) = (to_world * dt, turn * dw);
            let column = SVector::from([t.x, t.y, t.z, w.x, w.y, w.z, doffset.x, doffset.y]);
            matrix.set_column(signal, &column);
        }
        Ok(Sensitivity(matrix))
    }
}

impl Solution {
    /// The residual for a unit change of one signal.
    fn unit_residual(&self, signal: usize) -> Residual {
        let mut residual = Residual::default();
        match signal {
            0..6 if signal.is_multiple_of(2) => residual.u[signal / 2] = 1.0,
            0..6 => residual.v[signal / 2] = 1.0,
            // A fraction is power over total, and the total contains the same power.
            _ if self.total_power.is_finite() => {
                let own = Vec3::ith(signal - 6, 1.0).xy();
                residual.fractions = (own - self.fractions) / self.total_power;
            }
            _ => residual.fractions = Vec2::zeros(),
        }
        residual
    }
}

impl Sensitivity {
    /// The effect of this noise on the result.
    pub fn spread(mut self, noise: &Noise) -> ErrorPropagation<9> {
        for (mut column, sd) in self.0.column_iter_mut().zip(noise.spots.iter().chain(&noise.powers)) {
            column *= *sd;
        }
        ErrorPropagation(self.0)
    }
}

impl<const N: usize> ErrorPropagation<N> {
    /// Covariance of the pose: tx, ty, tz (m), roll, pitch, yaw (rad).
    pub fn pose_covariance(&self) -> Matrix6<f64> {
        let pose = self.0.fixed_rows::<6>(0);
        pose * pose.transpose()
    }
}

/// Standard uncertainty of each component of a pose.
pub fn sigmas(covariance: &Matrix6<f64>) -> Vector6<f64> {
    covariance.diagonal().map(f64::sqrt)
}
