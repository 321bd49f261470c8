//! Daemons, boards and clients that end with their test.

mod board;
mod browser;
mod controller;
mod daemon;
mod honest;
mod stream;
mod truth;
pub(crate) mod venv;

use std::time::{Duration, SystemTime};

pub(crate) use board::{Board, Socket};
pub(crate) use browser::Browser;
pub(crate) use controller::{Controller, State, Trouble};
pub(crate) use daemon::{Daemon, stamp_ns};
pub(crate) use stream::{Frame, Stream};
pub(crate) use truth::{errors, truth};

/// Longer than anything here takes on the slowest machine; nothing waits so long unless it hangs.
pub(crate) const PATIENCE: Duration = Duration::from_secs(30);

/// The system clock, which the daemon's own time stamps follow: nanoseconds of UTC since 1970.
#[expect(clippy::disallowed_methods, reason = "a test is an edge")]
pub(crate) fn now_ns() -> i64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_nanos() as i64
}

/// Mean of a number over frames.
pub(crate) fn mean(frames: &[Frame], number: impl Fn(&Frame) -> f64) -> f64 {
    assert!(!frames.is_empty());
    frames.iter().map(number).sum::<f64>() / frames.len() as f64
}
