//! The uncertainty of a pose relative to the tare: what acts on it, and how much.
//!
//! - [`effect`]: the input quantities. [`instrument`]: the published pose as a function of all of them.
//! - [`stated`]: the covariance by quantities with stated uncertainties, for every frame.

pub mod effect;
pub mod instrument;
pub mod stated;

pub use effect::{Effect, Moment};
pub use instrument::{Instrument, InstrumentError, Measurement};
pub use stated::Stated;
