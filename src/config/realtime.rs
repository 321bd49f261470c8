//! `[realtime]`: priority, memory and CPU of the fast thread.

use serde::{Deserialize, Serialize};

use super::check::Checker;

/// A shorter limit would end the daemon on machines that are only busy.
const SHORTEST_STALL_MS: u32 = 200;

/// Settings of `[realtime]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RealtimeConfig {
    /// `SCHED_FIFO` priority of the fast thread, 1 to 99. 0: an ordinary thread.
    pub priority: u8,
    /// CPU to which the fast thread is pinned. `None`: any CPU.
    pub cpu: Option<usize>,
    /// Whether all memory is locked in RAM.
    pub lock_memory: bool,
    /// Time without a heartbeat after which a stalled task of the fast thread ends the daemon,
    /// milliseconds. 0: never.
    pub stall_ms: u32,
}

impl Default for RealtimeConfig {
    fn default() -> Self {
        Self { priority: 0, cpu: None, lock_memory: false, stall_ms: 2000 }
    }
}

impl RealtimeConfig {
    pub(super) fn check(&self, mut at: Checker<'_>) {
        at.number("priority", self.priority, 0.0..=99.0);
        at.optional("cpu", self.cpu.map(|cpu| cpu as f64), 0.0..=1023.0);
        at.number("stall_ms", self.stall_ms, 0.0..=60_000.0);
        let fine = self.stall_ms == 0 || self.stall_ms >= SHORTEST_STALL_MS;
        let allowed = format!("0 (never), or at least {SHORTEST_STALL_MS}: a busy machine can delay a task");
        at.demand(fine, "stall_ms", self.stall_ms, allowed);
    }
}
