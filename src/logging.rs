//! Logging to standard error or to the journal. A thread of its own writes the lines, so that no task waits
//! for a terminal.
//!
//! - `limit`: limits repeated lines. `journal`: entries with fields.

mod journal;
mod limit;

use std::path::Path;
use std::{fmt, io};

use journal::{Entries, Journal};
use limit::Limiter;
use tracing_appender::non_blocking::{NonBlockingBuilder, WorkerGuard};
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::{Layer as _, SubscriberExt};
use tracing_subscriber::reload;
use tracing_subscriber::util::SubscriberInitExt;

use crate::config::{LogConfig, LogFormat};
use crate::exit::{self, Failure};

/// Largest number of lines that wait to be written. Further lines are dropped.
const QUEUE: usize = 10_000;

type Refilter = dyn Fn(Targets) -> Result<(), reload::Error> + Send + Sync;

/// The log of the process. Dropping it writes the queued lines.
pub struct Logging {
    refilter: Box<Refilter>,
    limiter: Limiter,
    _written_at_the_end: WorkerGuard,
}

impl fmt::Debug for Logging {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Logging")
    }
}

/// Starts logging for the process.
///
/// # Errors
/// The log level is invalid, or logging cannot be started.
pub fn start(config: &LogConfig) -> Result<Logging, Failure> {
    let failed = |e: &dyn fmt::Display| Failure::new(exit::SOFTWARE, format!("logging cannot start: {e}"));
    let (filter, handle) = reload::Layer::new(filter(&config.level)?);
    let limiter = Limiter::start().map_err(|e| failed(&e))?;
    let journal = (config.format == LogFormat::Text && journal::is_standard_error())
        .then(|| Journal::connect(Path::new(journal::SOCKET), io::stderr()).ok())
        .flatten();
    let queue = NonBlockingBuilder::default().buffered_lines_limit(QUEUE);
    let (entries, lines, guard) = if let Some(journal) = journal {
        let (writer, guard) = queue.finish(journal);
        (Some(Entries(writer)), None, guard)
    } else {
        let (writer, guard) = queue.finish(io::stderr());
        let lines = tracing_subscriber::fmt::layer().with_writer(writer).with_ansi(false);
        let lines = match config.format {
            LogFormat::Text => lines.with_target(false).boxed(),
            LogFormat::Json => lines.json().flatten_event(true).boxed(),
        };
        (None, Some(lines), guard)
    };
    let all = tracing_subscriber::registry().with(lines).with(entries).with(limiter.clone()).with(filter);
    all.try_init().map_err(|e| failed(&e))?;
    let refilter: Box<Refilter> = Box::new(move |filter| handle.reload(filter));
    Ok(Logging { refilter, limiter, _written_at_the_end: guard })
}

impl Drop for Logging {
    fn drop(&mut self) {
        self.limiter.sum_up_all();
    }
}

impl Logging {
    /// Sets the filter of the log.
    ///
    /// # Errors
    /// The level is invalid, or the filter cannot be changed.
    pub fn set_level(&self, level: &str) -> Result<(), Failure> {
        (self.refilter)(filter(level)?)
            .map_err(|e| Failure::new(exit::SOFTWARE, format!("the log level cannot be changed: {e}")))
    }
}

fn filter(level: &str) -> Result<Targets, Failure> {
    let filter: Targets =
        level.parse().map_err(|e| Failure::new(exit::CONFIG, format!("log.level = {level:?}: {e}")))?;
    let (target, level) = limit::ALWAYS;
    Ok(filter.with_target(target, level))
}
