//! The uncertainty budget of a pose relative to the tare (`docs/uncertainty.md`).
//!
//! Its quantities are those that the configuration states ([`Components`](crate::config::Components)); the measurement
//! model is [`trifacet_core::uncertainty`]. The frames of the daemon get their systematic part from both, too.
//!
//! - [`assessment`]: sensitivities and budget at a pose, the Monte Carlo method beside it, the worst pose of a range.
//! - [`record`]: the share of the calibration.
//! - [`formats`]: the budget as text, HTML, CSV, JSON, and for two other programs.
//!
//! The rules of JCGM 100 and JCGM 101 are in [`trifacet_budget`], which knows no instrument.

pub mod assessment;
pub mod formats;
pub mod record;
