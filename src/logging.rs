//! Log lines on standard error, written by a thread of their own: no task ever waits for a terminal.

use std::io;

use tracing_appender::non_blocking::{NonBlockingBuilder, WorkerGuard};
use tracing_subscriber::EnvFilter;

use crate::config::{LogConfig, LogFormat};
use crate::exit::{self, Failure};

/// Lines that may wait to be written. Further ones are dropped.
const QUEUE: usize = 10_000;

/// Starts logging for the process. Dropping the guard writes what is still queued.
pub fn start(config: &LogConfig) -> Result<WorkerGuard, Failure> {
    let filter = EnvFilter::try_new(&config.level)
        .map_err(|e| Failure::new(exit::CONFIG, format!("log.level = {:?}: {e}", config.level)))?;
    let (writer, guard) = NonBlockingBuilder::default().buffered_lines_limit(QUEUE).finish(io::stderr());
    let lines = tracing_subscriber::fmt().with_env_filter(filter).with_writer(writer).with_ansi(false);
    let started = match config.format {
        LogFormat::Text => lines.with_target(false).try_init(),
        LogFormat::Json => lines.json().flatten_event(true).try_init(),
    };
    started.map_err(|e| Failure::new(exit::SOFTWARE, format!("logging cannot start: {e}")))?;
    Ok(guard)
}
