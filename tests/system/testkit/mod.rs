//! Shared parts of the tests: daemons, boards, browsers and clients that end with their test.

mod board;
mod browser;
mod calibrated;
mod control;
mod controller;
mod daemon;
mod folder;
mod honest;
pub(crate) mod http;
mod load;
mod network;
mod program;
mod relay;
mod stream;
mod t7;
mod terminal;
mod truth;
mod turn;
mod udp;
pub(crate) mod venv;

use std::time::{Duration, SystemTime};

pub(crate) use board::{Board, Socket};
pub(crate) use browser::Browser;
pub(crate) use calibrated::calibrated_twin;
pub(crate) use controller::{Controller, State, Trouble};
pub(crate) use daemon::{Daemon, board_at, stamp_ns};
pub(crate) use folder::Folder;
pub(crate) use load::waited_ns;
pub(crate) use network::{Network, Receiver};
pub(crate) use program::{Done, Killed, NO_SESSION, computing, lacks, on, run, trifacet};
pub(crate) use relay::{Far, Relay};
pub(crate) use stream::{Frame, Stream};
pub(crate) use t7::T7;
pub(crate) use terminal::Terminal;
pub(crate) use truth::{errors, truth};
pub(crate) use udp::Udp;

/// Timeout of all waits: longer than any step on a slow machine, so that only a hung test reaches it.
pub(crate) const PATIENCE: Duration = Duration::from_mins(1);

/// The system clock, which the daemon's own time stamps follow: nanoseconds of UTC since 1970.
#[expect(clippy::disallowed_methods, reason = "a test may read the system clock")]
pub(crate) fn now_ns() -> i64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_nanos() as i64
}

/// Polls until a value is found; `Err` describes the current state.
pub(crate) fn wait_for<T>(what: &str, mut look: impl FnMut() -> Result<T, String>) -> T {
    let begin_ns = now_ns();
    loop {
        match look() {
            Ok(found) => return found,
            Err(seen) => {
                let patient = now_ns() - begin_ns < PATIENCE.as_nanos() as i64;
                assert!(patient, "never {what}: {seen}");
            }
        }
        std::thread::sleep(Duration::from_millis(10)); // leaves processor time to the tested processes
    }
}

/// Mean of a quantity over frames.
pub(crate) fn mean(frames: &[Frame], number: impl Fn(&Frame) -> f64) -> f64 {
    assert!(!frames.is_empty());
    frames.iter().map(number).sum::<f64>() / frames.len() as f64
}
