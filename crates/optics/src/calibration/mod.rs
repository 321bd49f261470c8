//! Calibration of a head: its geometry, the errors of its PSDs and the frames, from measured points.
//!
//! Each point has nine signals, and any of: the pose of the mirror by a reference, the readback of the
//! steering stage. The estimator solves each point with the nine signals, so that no pose remains unknown, and
//! fits all parameters to the references and readbacks by Gauss-Newton steps. Priors, which are the tolerances
//! of the head, make every combination of parameters finite that no data determine.
//!
//! - [`cholesky`]: large matrices. [`linearised`]: the parameters and one point.
//! - [`plan`]: poses that cover the PSDs evenly.
//! - [`point`]: what is measured.
//! - [`parameters`]: the unknown numbers and their tolerances.
//! - [`pointing`]: whether the steering follows its readback.
//! - `instrument`: the forward model, with an elliptical beam.
//! - [`map`]: the error of a PSD as a function of its reading.
//! - [`fit`]: the estimator. `climb`: the search for the most likely prior.
//! - [`gauge`]: what no measurement can tell.
//! - [`held_out`]: the test of a fit on points that it has not seen.
//! - [`mistakes`]: signs, axes and units that are plainly wrong.
//! - [`revisits`]: drift during the measurement.
//! - [`result`]: the calibrated head, and the covariance of its poses. [`spread`]: the same covariance for every frame.

pub mod cholesky;
mod climb;
pub mod fit;
pub mod gauge;
pub mod held_out;
mod instrument;
pub mod linearised;
pub mod map;
pub mod mistakes;
mod normal;
pub mod parameters;
pub mod plan;
pub mod point;
pub mod pointing;
mod random_walk;
pub mod result;
pub mod revisits;
mod session;
pub mod spread;

/// Elements of a symmetric matrix and of vectors over all parameters.
pub(crate) type Matrix = nalgebra::DMatrix<f64>;
/// A vector over all parameters.
pub(crate) type Vector = nalgebra::DVector<f64>;
