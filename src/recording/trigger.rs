//! Detects the beginning of a fault. Pure.

use trifacet_core::time::{Mono, NS_PER_S};
use trifacet_wire::{LockState, PoseFrame, Status};

use super::Entry;

/// Detects the beginning of faults. A fault that lasts triggers once.
#[derive(Clone, Debug)]
pub struct Trigger {
    calm_ns: i64,
    /// Start of the current time without faults; `None` before the first frame and during a fault.
    calm: Option<Mono>,
    /// There was once enough time without faults. Before that, faults belong to the start and do not count.
    armed: bool,
    /// The last frame had a fault.
    wrong: bool,
}

impl Trigger {
    /// A trigger that needs `calm_s` seconds without faults before the first fault counts.
    pub fn new(calm_s: f64) -> Self {
        Self { calm_ns: (calm_s * NS_PER_S as f64) as i64, calm: None, armed: false, wrong: false }
    }

    /// Takes every entry in turn. Returns the cause when a fault begins.
    pub fn see(&mut self, entry: &Entry) -> Option<&'static str> {
        match entry {
            Entry::Frame { frame, time, .. } => {
                let wrong = what_is_wrong(frame);
                let before = std::mem::replace(&mut self.wrong, wrong.is_some());
                self.calm = if wrong.is_some() { None } else { self.calm.or(Some(*time)) };
                self.armed |= self.calm.is_some_and(|calm| *time - calm >= self.calm_ns);
                wrong.filter(|_| self.armed && !before)
            }
            Entry::Lock { before: LockState::Locked, .. } => {
                self.calm = None;
                self.armed.then_some("the lock is lost")
            }
            _ => None,
        }
    }
}

fn what_is_wrong(frame: &PoseFrame) -> Option<&'static str> {
    if frame.status.has(Status::SOURCE_DOWN) {
        Some("the source is down")
    } else if frame.lost > 0 {
        Some("samples were lost")
    } else if frame.status.has(Status::POSE_VALID) {
        None
    } else {
        Some("there is no valid pose")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(second: i64, status: Status, lost: u16) -> Entry {
        let frame = PoseFrame { status, lost, ..PoseFrame::example() };
        Entry::Frame { frame, time: Mono(second * NS_PER_S), covariance: None }
    }

    #[test]
    fn each_fault_triggers_at_its_begin_and_the_start_does_not() {
        let good = |second| frame(second, Status::POSE_VALID, 0);
        let mut trigger = Trigger::new(3.0);
        assert_eq!(trigger.see(&frame(0, Status::default(), 0)), None, "no time without faults before");
        assert_eq!(trigger.see(&good(1)), None);
        assert_eq!(trigger.see(&frame(2, Status::default(), 0)), None, "not long enough");
        for second in 3..=6 {
            assert_eq!(trigger.see(&good(second)), None);
        }
        assert_eq!(trigger.see(&frame(7, Status::SOURCE_DOWN, 0)), Some("the source is down"));
        assert_eq!(trigger.see(&frame(8, Status::default(), 0)), None, "the same fault");
        assert_eq!(trigger.see(&good(9)), None);
        assert_eq!(trigger.see(&frame(10, Status::POSE_VALID, 2)), Some("samples were lost"), "another one");
        let lock = |before| Entry::Lock {
            time: Mono(13 * NS_PER_S),
            before,
            after: LockState::Held,
            cause: "dark".into(),
        };
        assert_eq!(trigger.see(&lock(LockState::Acquiring)), None);
        assert_eq!(trigger.see(&lock(LockState::Locked)), Some("the lock is lost"));
    }
}
