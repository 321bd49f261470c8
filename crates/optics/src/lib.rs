//! The sensor model of the head. Pure: no clock, no socket, no configuration.
//!
//! - [`head`]: geometry of the PSDs, the facets and the beam.
//! - [`pose`]: position and orientation, Eq. 3 of the paper.
//! - [`relative`]: a pose relative to another one, with derivatives.
//! - [`ray`]: from a point on a facet to a spot on a PSD, with derivatives.
//! - [`beam`]: how the mirror splits a Gaussian beam: powers and centroids, with derivatives.
//! - [`model`]: the forward model, from pose and beam offset to signals.
//! - [`elliptical`]: the forward model with an elliptical beam.
//! - [`tilted`]: a beam from a pivot, whose direction follows from where it goes.
//! - [`estimate`]: the inverse, from signals to pose and beam offset.
//! - [`facet_offset`]: the offset of the beam when a single PSD sees light.
//! - [`covariance`]: from the noise of the signals to the uncertainty of the result.
//! - [`calibration`]: the estimator of a head's geometry and errors.
//! - [`fusion`]: the beam position from another instrument, as two more signals.
//!
//! The paper: *Measurement of 3-D position and orientation of rigid bodies using a 3-facet mirror*.
//! Its printed equations 5 to 16 contain misprints (`docs/sensor-model.md`); the model here is derived
//! from the law of reflection.
//!
//! ```
//! use trifacet_optics::{Estimator, Head, Model, Noise, Optics, Pose, Signals, Vec2};
//!
//! let optics = Optics::new(&Head::default());
//! let pose = Pose::from_array([10e-6, -20e-6, 30e-6, 40e-6, 50e-6, -60e-6]); // metres and radians
//! let reading = optics.trace(Model::Gaussian, &pose, Vec2::new(2e-6, -1e-6))?; // the beam is off the apex
//!
//! let estimator = Estimator::new(optics, Model::Gaussian);
//! let signals = Signals { spots: reading.spots, powers: reading.powers };
//! let solution = estimator.solve(&signals, None)?;
//! assert!((solution.pose.t.x - 10e-6).abs() < 1e-9);
//!
//! let noise = Noise { spots: [1e-6; 6], powers: reading.powers.map(|power| 1e-3 * power) };
//! let covariance = estimator.sensitivity(&solution)?.spread(&noise).pose_covariance();
//! assert!(covariance[(0, 0)].sqrt() < 2e-6, "standard uncertainty of x, metres");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod balance;
pub mod beam;
pub mod calibration;
pub mod covariance;
pub mod elliptical;
pub mod estimate;
pub mod facet_offset;
mod forward;
pub mod fusion;
pub mod head;
mod jacobian;
mod linear;
pub mod model;
pub mod pose;
pub mod quadratic;
pub mod ray;
pub mod relative;
pub mod tilted;

pub use covariance::{ErrorPropagation, Noise, Sensitivity};
pub use elliptical::Ellipse;
pub use estimate::{Estimator, Signals, Solution, SolveError};
pub use facet_offset::FacetOffset;
pub use fusion::{BeamPosition, Fused, Innovation};
pub use head::{Head, HeadError, Psd};
pub use model::{Model, Optics, Reading, TraceError};
pub use pose::{Pose, Rigid};
pub use relative::Relative;

/// A vector in space.
pub type Vec3 = nalgebra::Vector3<f64>;
/// A vector across the beam, in the plane perpendicular to it.
pub type Vec2 = nalgebra::Vector2<f64>;
/// A rotation, or any linear map of space.
pub type Mat3 = nalgebra::Matrix3<f64>;

/// The names of the three facets and their PSDs.
pub const FACETS: [char; 3] = ['A', 'B', 'C'];
