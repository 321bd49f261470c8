//! Log lines on standard error, written by a thread of their own: no task ever waits for a terminal.

use std::{fmt, io};

use tracing_appender::non_blocking::{NonBlockingBuilder, WorkerGuard};
use tracing_subscriber::EnvFilter;

use crate::config::{LogConfig, LogFormat};
use crate::exit::{self, Failure};

/// Lines that may wait to be written. Further ones are dropped.
const QUEUE: usize = 10_000;

type Refilter = dyn Fn(EnvFilter) -> Result<(), String> + Send + Sync;

/// The log of the process. Dropping it writes what is still queued.
pub struct Logging {
    refilter: Box<Refilter>,
    _written_at_the_end: WorkerGuard,
}

impl fmt::Debug for Logging {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Logging")
    }
}

/// Starts logging for the process.
pub fn start(config: &LogConfig) -> Result<Logging, Failure> {
    let filter = filter(&config.level)?;
    let (writer, guard) = NonBlockingBuilder::default().buffered_lines_limit(QUEUE).finish(io::stderr());
    let lines = tracing_subscriber::fmt().with_env_filter(filter).with_writer(writer).with_ansi(false);
    let (started, refilter): (_, Box<Refilter>) = match config.format {
        LogFormat::Text => {
            let lines = lines.with_target(false).with_filter_reloading();
            let handle = lines.reload_handle();
            (lines.try_init(), Box::new(move |filter| handle.reload(filter).map_err(|e| e.to_string())))
        }
        LogFormat::Json => {
            let lines = lines.json().flatten_event(true).with_filter_reloading();
            let handle = lines.reload_handle();
            (lines.try_init(), Box::new(move |filter| handle.reload(filter).map_err(|e| e.to_string())))
        }
    };
    started.map_err(|e| Failure::new(exit::SOFTWARE, format!("logging cannot start: {e}")))?;
    Ok(Logging { refilter, _written_at_the_end: guard })
}

impl Logging {
    /// Logs from now on what this filter lets through.
    pub fn set_level(&self, level: &str) -> Result<(), Failure> {
        (self.refilter)(filter(level)?)
            .map_err(|e| Failure::new(exit::SOFTWARE, format!("the log cannot be changed: {e}")))
    }
}

fn filter(level: &str) -> Result<EnvFilter, Failure> {
    EnvFilter::try_new(level).map_err(|e| Failure::new(exit::CONFIG, format!("log.level = {level:?}: {e}")))
}
