//! The lock state and its cause, as sent beside the frames.

use trifacet_core::centering::lock::LockCondition;
use trifacet_wire::stream::LockEvent;

use super::columns::rfc3339;
use crate::clock::utc::read_clocks;

/// The lock state, its cause and the time of the last change, in words.
pub fn lock_event(condition: &LockCondition) -> LockEvent {
    let LockCondition { number, from, lock, cause, since } = *condition;
    let (now, utc_ns) = read_clocks();
    LockEvent {
        number,
        from: from.name().into(),
        lock: lock.name().into(),
        cause: cause.label().into(),
        text: cause.text().into(),
        since: rfc3339(utc_ns.saturating_sub(now - since)),
    }
}
