//! State that the tasks of the daemon publish for other tasks, without locks.
//!
//! - [`Counters`]: every counter of the daemon.
//! - [`heartbeat`]: whether each task is running.
//! - [`CommandGauge`]: the commands that the stage has not acknowledged.
//! - [`ResidualGauge`]: the mean steering residual.
//! - [`DriftGauge`]: what has changed since the calibration.
//! - [`LatestStatus`]: status and lock state of the newest frame.

mod command_gauge;
mod counters;
mod drift_gauge;
pub mod heartbeat;
mod known_number;
mod latest_status;
mod residual_gauge;

pub use command_gauge::CommandGauge;
pub use counters::{Counter, CounterDefinition, CounterKind, Counters};
pub use drift_gauge::{Drift, DriftGauge};
pub use latest_status::LatestStatus;
pub use residual_gauge::ResidualGauge;
