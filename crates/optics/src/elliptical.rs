//! The forward model with an elliptical Gaussian beam.
//!
//! An elliptical Gaussian is a round one after a linear map of the plane across the beam. Fractions of the power are
//! the same in both planes, and centroids map linearly. The estimator assumes a round beam: this model serves
//! simulations and calibrations.

use nalgebra::Matrix2;

use super::beam::{DARK, Split, Wedge};
use super::model::MIN_FACING;
use super::{FACETS, Model, Optics, Pose, TraceError, Vec2, Vec3};

/// The shape of a beam: its covariance across the light is `sigma^2 exp([[c, s], [s, -c]])`, with the `sigma` of the
/// head. `c` and `s` are in the axes of the beam offset; their root sum of squares is the logarithm of the ratio of the
/// two variances, divided by two.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipse {
    /// Square root of the covariance, relative to sigma.
    shape: Matrix2<f64>,
    /// Its inverse.
    unshape: Matrix2<f64>,
}

impl Ellipse {
    /// The shape with these parameters; zero: round.
    pub fn new(c: f64, s: f64) -> Self {
        Self { shape: exp_half(c, s), unshape: exp_half(-c, -s) }
    }

    /// The covariance across the light, relative to the square of sigma.
    pub fn covariance(&self) -> Matrix2<f64> {
        self.shape * self.shape
    }

    /// The light on the facets, for a mirror with these normals and a beam at `offset` from the apex, in units of sigma.
    pub(super) fn wedges(&self, normals: &[Vec3; 3], offset: Vec2) -> [Wedge; 3] {
        let round = normals.map(|n| {
            let across = self.shape * n.xy();
            Vec3::new(across.x, across.y, n.z)
        });
        let split = Split::new(&round, self.unshape * offset);
        [0, 1, 2].map(|i| {
            let mut wedge = split.wedge(i);
            wedge.moment = self.shape * wedge.moment;
            wedge
        })
    }
}

/// `exp(1/2 [[c, s], [s, -c]])`.
fn exp_half(c: f64, s: f64) -> Matrix2<f64> {
    let r = 0.5 * c.hypot(s);
    // sinh(r)/r, whose limit is 1.
    let slope = if r > 1e-8 { r.sinh() / r } else { 1.0 };
    Matrix2::identity() * r.cosh() + Matrix2::new(c, s, s, -c) * (0.5 * slope)
}

impl Optics {
    /// As [`Optics::trace_each`] with the Gaussian model, for an elliptical beam.
    pub fn trace_elliptical(
        &self,
        ellipse: &Ellipse,
        pose: &Pose,
        offset: Vec2,
    ) -> ([Result<[f64; 2], TraceError>; 3], [f64; 3]) {
        if let Some((parallel, across)) = self.along_light(pose.t, offset) {
            return parallel.optics.trace_elliptical(ellipse, pose, across);
        }
        let mirror = self.mirror(pose.t, &pose.rotation());
        let finite = pose.to_array().iter().chain(offset.iter()).all(|x| x.is_finite());
        if !finite || mirror.normals.iter().any(|n| n.z < MIN_FACING) {
            return self.trace_each(Model::Gaussian, pose, offset); // the errors are those of a round beam
        }
        let wedges = ellipse.wedges(&mirror.normals, offset / self.sigma);
        let spots = [0, 1, 2].map(|i| {
            let lit = wedges[i].power > DARK;
            let arm = lit.then(|| self.arm(&wedges[i], mirror.normals[i], offset));
            self.spot(i, &mirror, arm.ok_or(TraceError::Dark(FACETS[i]))?)
        });
        (spots, wedges.map(|w| w.power.max(0.0)))
    }
}
