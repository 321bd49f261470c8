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
pub struct LoopLiveness {
    said: watch::Receiver<LoopState>,
    heartbeats: Arc<Heartbeats>,
    stall_detector: StallDetector,
}

impl LoopLiveness {
    /// A source with this channel for the state, and these heartbeats.
    pub fn new(said: watch::Receiver<LoopState>, heartbeats: Arc<Heartbeats>) -> Self {
        Self { said, heartbeats, stall_detector: StallDetector::default() }
    }

    /// Checks for new heartbeats; to be called at each heartbeat of estimation.
    pub fn look(&mut self) {
        self.stall_detector.look(self.heartbeats.of(Task::Centering).count());
    }

    /// The loop state to report now.
    pub fn now(&self) -> LoopState {
        let said = *self.said.borrow();
        if self.stall_detector.stands_still() { said.without_observation() } else { said }
    }
}

/// Detects missing heartbeats. Time is counted in checks, not read from a clock: if the whole thread was
/// suspended, there is only one check afterwards, and the loop does not count as stalled.
#[derive(Clone, Copy, Debug, Default)]
struct StallDetector {
    heartbeats: u64,
    /// Number of checks since the last new heartbeat.
    silent: u32,
}

impl StallDetector {
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

    use trifacet_core::steering::StagePosition;

    use super::*;

    #[test]
    fn the_state_of_a_running_loop_is_reported() {
        let mut stall_detector = StallDetector::default();
        for heartbeats in [1, 1, 1, 2, 2, 2, 900] {
            stall_detector.look(heartbeats);
            assert!(!stall_detector.stands_still(), "{stall_detector:?}");
        }
        let still: Vec<_> =
            (0..4).map(|_| (stall_detector.look(900), stall_detector.stands_still()).1).collect();
        assert_eq!(still, [false, false, true, true]);
        stall_detector.look(901);
        assert!(!stall_detector.stands_still());
    }

    #[test]
    fn the_state_of_a_stalled_loop_is_not_reported() {
        let locked = LoopState { lock: LockState::Locked, position: Some(StagePosition([1e-6, 0.0])) };
        let (_sender, said) = watch::channel(locked);
        let mut liveness = LoopLiveness::new(said, Arc::default());
        assert_eq!(liveness.now(), locked);
        (0..LOOKS).for_each(|_| liveness.look());
        assert_eq!(liveness.now(), LoopState { lock: LockState::Held, position: None });
    }
}
