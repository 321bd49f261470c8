//! The commands that the stage has not acknowledged, for occasional readers.

use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicI64, AtomicU32};

use crate::centering::CommandBacklog;
use crate::time::Mono;

/// Stands for the time of the oldest command while all commands are acknowledged.
const NONE: i64 = i64::MAX;

/// Written by the centering task, read on demand. Number and time are not read in one step: either may be newer.
#[derive(Debug)]
pub struct CommandGauge {
    count: AtomicU32,
    oldest: AtomicI64,
}

impl Default for CommandGauge {
    fn default() -> Self {
        Self { count: AtomicU32::new(0), oldest: AtomicI64::new(NONE) }
    }
}

impl CommandGauge {
    /// Records the present state.
    pub fn set(&self, backlog: &CommandBacklog) {
        self.count.store(backlog.count, Relaxed);
        self.oldest.store(backlog.oldest.map_or(NONE, |oldest| oldest.0), Relaxed);
    }

    /// Number of commands without an acknowledgement.
    pub fn count(&self) -> u32 {
        self.count.load(Relaxed)
    }

    /// Age of the oldest of them, seconds; 0 if all are acknowledged. It grows also while the centering task stalls.
    pub fn age_s(&self, now: Mono) -> f64 {
        match self.oldest.load(Relaxed) {
            NONE => 0.0,
            oldest => now.seconds_since(Mono(oldest)).max(0.0),
        }
    }
}
