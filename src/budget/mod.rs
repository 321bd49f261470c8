//! The uncertainty budget of a pose relative to the tare (`docs/uncertainty.md`).
//!
//! - [`quantity`]: an input quantity, and what it acts on. [`components`]: the quantities that the configuration states,
//!   and what it does not state.
//! - [`instrument`]: the measurement model: from deviations of these quantities to the pose that is published.
//! - [`assessment`]: sensitivities and budget at a pose, the Monte Carlo method beside it, the worst pose of a range.
//! - [`record`]: the share of the calibration.
//! - [`stated`]: what the frames of the daemon state of it.
//! - [`formats`]: the budget as text, HTML, CSV, JSON, and for two other programs.
//!
//! The rules of JCGM 100 and JCGM 101 are in [`trifacet_budget`], which knows no instrument.

pub mod assessment;
pub mod components;
pub mod formats;
pub mod instrument;
pub mod quantity;
pub mod record;
pub mod stated;
