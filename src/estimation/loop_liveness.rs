//! The loop state for reports: the last one from the loop, as long as the loop beats.

use std::sync::Arc;

use tokio::sync::watch;
use trifacet_core::centering::LoopState;
use trifacet_core::telemetry::heartbeat::{Heartbeats, Task};

/// Number of checks without a heartbeat after which the loop counts as stalled. The interval between checks
/// is at least one [`HEARTBEAT`](trifacet_core::telemetry::heartbeat::HEARTBEAT), which is also the longest
/// interval between two heartbeats.
const LOOKS: u32 = 3;

/// Source of the loop state for estimation.
#[derive(Debug)]
pub struct Loop {
    said: watch::Receiver<LoopState>,
    heartbeats: Arc<Heartbeats>,
    pulse: Pulse,
}

impl Loop {
    /// A source with this channel for the state, and these heartbeats.
    pub fn new(said: watch::Receiver<LoopState>, heartbeats: Arc<Heartbeats>) -> Self {
        Self { said, heartbeats, pulse: Pulse::default() }
    }

    /// Checks for new heartbeats; to be called at each heartbeat of estimation.
    pub fn look(&mut self) {
        self.pulse.look(self.heartbeats.of(Task::Centering).count());
    }

    /// The loop state to report now.
    pub fn now(&self) -> LoopState {
        let said = *self.said.borrow();
        if self.pulse.stands_still() { said.without_observation() } else { said }
    }
}

/// Detects missing heartbeats. Time is counted in checks, not read from a clock: if the whole thread was
/// suspended, there is only one check afterwards, and the loop does not count as stalled.
#[derive(Clone, Copy, Debug, Default)]
struct Pulse {
    heartbeats: u64,
    /// Number of checks since the last new heartbeat.
    silent: u32,
}

impl Pulse {
    fn look(&mut self, heartbeats: u64) {
        self.silent = if heartbeats == self.heartbeats { self.silent.saturating_add(1) } else { 0 };
        self.heartbeats = heartbeats;
    }

    fn stands_still(self) -> bool {
        self.silent >= LOOKS
    }
}

#[cfg(test)]
mod tests {
    use trifacet_wire::LockState;

    use super::*;

    #[test]
    fn the_state_of_a_running_loop_is_reported() {
        let mut pulse = Pulse::default();
        for heartbeats in [1, 1, 1, 2, 2, 2, 900] {
            pulse.look(heartbeats);
            assert!(!pulse.stands_still(), "{pulse:?}");
        }
        let still: Vec<_> = (0..4).map(|_| (pulse.look(900), pulse.stands_still()).1).collect();
        assert_eq!(still, [false, false, true, true]);
        pulse.look(901);
        assert!(!pulse.stands_still());
    }

    #[test]
    fn the_state_of_a_stalled_loop_is_not_reported() {
        let locked = LoopState { lock: LockState::Locked, position: Some([1e-6, 0.0]) };
        let (_sender, said) = watch::channel(locked);
        let mut liveness = Loop::new(said, Arc::default());
        assert_eq!(liveness.now(), locked);
        (0..LOOKS).for_each(|_| liveness.look());
        assert_eq!(liveness.now(), LoopState { lock: LockState::Held, position: None });
    }
}
