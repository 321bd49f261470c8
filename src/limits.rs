//! Limits that the system sets for the process.

use std::io;

use rustix::process::Signal;
use tokio::runtime::Builder;
use tokio::signal::unix::{SignalKind, signal};

/// Makes a write beyond the largest file size (`RLIMIT_FSIZE`) fail with an error. Without a handler, SIGXFSZ
/// would end the process before it can report or react.
///
/// # Errors
/// Fails if no handler can be installed.
pub(crate) fn make_file_size_an_error() -> io::Result<()> {
    // The handler stays after the runtime has ended.
    let runtime = Builder::new_current_thread().enable_io().build()?;
    runtime.block_on(async { signal(SignalKind::from_raw(Signal::XFSZ.as_raw())) }).map(drop)
}
