//! What the tasks of the daemon leave for others to read, without locks.
//!
//! - [`Counters`]: every counter of the daemon.
//! - [`heartbeat`]: whether each task is alive.
//! - [`LatestStatus`]: status and lock state of the newest frame.

mod counters;
pub mod heartbeat;
mod latest_status;

pub use counters::{Counter, Counters};
pub use latest_status::LatestStatus;
