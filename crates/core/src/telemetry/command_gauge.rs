//! The commands that the stage has not acknowledged, and the delay of the others, for occasional readers.

use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU32};

use super::known_number::KnownNumber;
use crate::centering::CommandBacklog;
use crate::time::Mono;

/// Stands for the time of the oldest command while all commands are acknowledged.
const NONE: i64 = i64::MAX;

/// Written by the centering task, read on demand. Number and time are not read in one step: either may be newer.
#[derive(Debug)]
pub struct CommandGauge {
    count: AtomicU32,
    oldest: AtomicI64,
    overdue: AtomicBool,
    /// The measured delay, seconds.
    delay_s: KnownNumber,
}

impl Default for CommandGauge {
    fn default() -> Self {
        Self {
            count: AtomicU32::new(0),
            oldest: AtomicI64::new(NONE),
            overdue: AtomicBool::new(false),
            delay_s: KnownNumber::default(),
        }
    }
}

impl CommandGauge {
    /// Records the present state; `delay_s` is the measured delay of commands, seconds.
    pub fn set(&self, backlog: &CommandBacklog, delay_s: Option<f64>) {
        self.count.store(backlog.count, Relaxed);
        self.oldest.store(backlog.oldest.map_or(NONE, |oldest| oldest.0), Relaxed);
        self.overdue.store(backlog.overdue, Relaxed);
        self.delay_s.set(delay_s);
    }

    /// The commands without an acknowledgement. Their age grows also while the centering task stalls.
    pub fn backlog(&self) -> CommandBacklog {
        let oldest = Some(self.oldest.load(Relaxed)).filter(|oldest| *oldest != NONE).map(Mono);
        CommandBacklog { count: self.count.load(Relaxed), oldest, overdue: self.overdue.load(Relaxed) }
    }

    /// The measured delay of commands, seconds, if it is known.
    pub fn delay_s(&self) -> Option<f64> {
        self.delay_s.get()
    }
}
