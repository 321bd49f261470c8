//! Eleven signals: the nine of the PSDs and the beam position from another instrument.
//!
//! A steering stage with a readback gives the point where its beam crosses the plane of the apex:
//! `across(t) + offset = s` (with a tilted beam: where its axis crosses that plane). The nine signals determine the nine unknowns exactly, so their solution has no residuals.
//! The weighted least-squares solution of all eleven equations is therefore one linear update of that
//! solution: a Kalman update, with the solution as the prediction and `s` as the measurement. The neglected
//! non-linearity is of the order of the squared update over the distance of the PSDs: 0.04 um for an update
//! of 0.1 mm.

use nalgebra::{Matrix2, SMatrix, Vector6};

use super::covariance::ErrorPropagation;
use super::{Optics, Pose, Solution, Vec2};

/// Beam position measured by another instrument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeamPosition {
    /// Point where the beam crosses the plane of the apex at rest, across the beam, metres.
    pub at: Vec2,
    /// Standard uncertainty of that position per axis, metres.
    pub sigma: f64,
}

/// Difference between a measured beam position and the one from nine signals.
#[derive(Clone, Copy, Debug)]
pub struct Innovation<'a> {
    /// Measured minus solved, across the beam, metres.
    pub residual: Vec2,
    /// Inverse of its covariance, 1/m^2.
    weight: Matrix2<f64>,
    spread: &'a ErrorPropagation<9>,
    /// Effect of the noise of each signal on the solved beam position, metres.
    seen: SMatrix<f64, 2, 9>,
    /// Covariance of the solved beam position, m^2.
    covariance: Matrix2<f64>,
    sigma: f64,
}

/// The solution of eleven signals.
#[derive(Clone, Copy, Debug)]
pub struct Fused {
    /// Position and orientation of the mirror.
    pub pose: Pose,
    /// Beam centre minus apex, across the beam, metres.
    pub offset: Vec2,
    /// Effect of the noise on the result: noise of the nine signals, and of the beam position along x and y.
    pub spread: ErrorPropagation<11>,
}

impl<'a> Innovation<'a> {
    /// Compares a beam position with a solution of the Gaussian model, whose noise propagates as `spread`.
    /// `None` if a value is not finite.
    pub fn new(
        optics: &Optics,
        solution: &Solution,
        spread: &'a ErrorPropagation<9>,
        beam_position: &BeamPosition,
    ) -> Option<Self> {
        let across = optics.to_world.fixed_columns::<2>(0).transpose();
        let mut residual = beam_position.at - optics.across(solution.pose.t) - solution.offset;
        let mut seen = across * spread.0.fixed_rows::<3>(0) + spread.0.fixed_rows::<2>(6);
        if let Some(lean) = optics.lean(solution.pose.t, solution.offset) {
            residual -= lean.shift;
            let along = optics.to_world.column(2).transpose() * spread.0.fixed_rows::<3>(0);
            seen += seen * lean.scale + lean.by_height * along;
        }
        let own = Matrix2::from_diagonal_element(beam_position.sigma.powi(2));
        let covariance = seen * seen.transpose();
        let weight = (covariance + own).try_inverse()?;
        let finite = residual.iter().chain(&weight).all(|x| x.is_finite());
        finite.then_some(Self { residual, weight, spread, seen, covariance, sigma: beam_position.sigma })
    }

    /// Length of the residual in its own standard uncertainties (Mahalanobis distance). By chance above 5
    /// once in 270 000.
    pub fn normalized_residual(&self) -> f64 {
        self.residual.dot(&(self.weight * self.residual)).sqrt()
    }

    /// Length of the mean of `count` residuals in its own standard uncertainties. The error of the beam
    /// position (a drift of the laser direction) counts as the same in all residuals, the noise of the
    /// signals as independent.
    pub fn normalized_mean(&self, mean: Vec2, count: f64) -> f64 {
        self.mean_weight(count).map_or(f64::INFINITY, |weight| mean.dot(&(weight * mean)).sqrt())
    }

    /// Standard uncertainty of the mean of `count` residuals in the direction of `along`, metres: a mean of this
    /// length has a normalised length of 1, see [`normalized_mean`](Self::normalized_mean). `None` if it is not
    /// finite.
    pub fn mean_sigma(&self, along: Vec2, count: f64) -> Option<f64> {
        let along = along.try_normalize(0.0).unwrap_or_else(Vec2::x);
        let weight = self.mean_weight(count)?;
        Some(1.0 / along.dot(&(weight * along)).sqrt()).filter(|sigma| sigma.is_finite())
    }

    fn mean_weight(&self, count: f64) -> Option<Matrix2<f64>> {
        let own = Matrix2::from_diagonal_element(self.sigma.powi(2));
        (self.covariance / count + own).try_inverse()
    }

    /// The solution updated with the beam position, weighted by the uncertainties.
    pub fn fuse(&self, solution: &Solution) -> Fused {
        let gain = self.spread.0 * self.seen.transpose() * self.weight;
        let update = gain * self.residual;
        let pose = Vector6::from(solution.pose.to_array()) + update.fixed_rows::<6>(0);
        let mut spread = SMatrix::<f64, 8, 11>::zeros();
        spread.fixed_columns_mut::<9>(0).copy_from(&(self.spread.0 - gain * self.seen));
        spread.fixed_columns_mut::<2>(9).copy_from(&(gain * self.sigma));
        Fused {
            pose: Pose::from_array(pose.into()),
            offset: solution.offset + update.fixed_rows::<2>(6),
            spread: ErrorPropagation(spread),
        }
    }
}
