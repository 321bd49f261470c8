//! `[realtime]`: priority, memory and CPU of the fast thread.

use serde::{Deserialize, Serialize};

use super::check::Checker;

/// `[realtime]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RealtimeConfig {
    /// `SCHED_FIFO` priority of the fast thread, 1 to 99; 0 leaves it an ordinary thread.
    pub priority: u8,
    /// CPU to which the fast thread is pinned.
    pub cpu: Option<usize>,
    /// Keep all memory in RAM.
    pub lock_memory: bool,
}

impl RealtimeConfig {
    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.number("priority", self.priority, 0.0..=99.0);
        at.optional("cpu", self.cpu.map(|cpu| cpu as f64), 0.0..=1023.0);
    }
}
