//! The lock state with its cause, and its changes.

use trifacet_wire::LockState;

use super::LockCause;
use crate::time::Mono;

/// A change of the lock state, with its cause.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transition {
    /// State before.
    pub from: LockState,
    /// State after.
    pub to: LockState,
    /// The cause.
    pub cause: LockCause,
}

/// The present lock state and why the loop is in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LockCondition {
    /// Number of changes before this one.
    pub number: u64,
    /// State before the last change.
    pub from: LockState,
    /// The state.
    pub lock: LockState,
    /// The present cause. It can change while the state remains: first no light, then too little light.
    pub cause: LockCause,
    /// Time of the last change.
    pub since: Mono,
}

impl LockCondition {
    /// The condition at the start of the loop.
    pub fn initial(lock: LockState, cause: LockCause, now: Mono) -> Self {
        Self { number: 0, from: lock, lock, cause, since: now }
    }

    /// The condition after a change.
    #[must_use]
    pub fn after(self, change: Transition, now: Mono) -> Self {
        let Transition { from, to: lock, cause } = change;
        Self { number: self.number + 1, from, lock, cause, since: now }
    }

    /// This condition, if it explains the lock state of a frame. It does not if the frame is from before the
    /// last change, or if the frame shows `held` because its signals are invalid or the loop is stalled.
    pub fn explaining(self, lock: LockState) -> Option<Self> {
        (self.lock == lock).then_some(self)
    }
}
