//! History of the status bits and of the lock state. Pure.

use serde::Serialize;
use trifacet_wire::{LockState, PoseFrame, Status};

/// The last period of each status bit, and the lock state.
#[derive(Debug, Default)]
pub struct StatusHistory {
    last: Option<(Status, LockState)>,
    lock_since_ms: f64,
    bits: [Spell; Status::NAMES.len()],
}

/// The last period in which a status bit was or is set.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Spell {
    /// Number of the bit.
    pub bit: usize,
    /// Time of the first frame with the bit, milliseconds of UTC since 1970.
    pub since_ms: f64,
    /// Time of the first frame without the bit, if the period has ended; milliseconds of UTC since 1970.
    pub until_ms: Option<f64>,
    /// Number of periods so far.
    pub times: u64,
}

impl StatusHistory {
    /// Takes every frame in turn.
    pub fn frame(&mut self, frame: &PoseFrame) {
        let now = (frame.status, frame.lock);
        if self.last == Some(now) {
            return;
        }
        let (before, lock) = self.last.unzip();
        let before = before.unwrap_or_default();
        let time_ms = frame.time_ns as f64 * 1e-6;
        for (bit, (mask, _)) in Status::NAMES.iter().enumerate() {
            let spell = &mut self.bits[bit];
            match (before.has(*mask), frame.status.has(*mask)) {
                (false, true) => {
                    *spell = Spell { bit, since_ms: time_ms, until_ms: None, times: spell.times + 1 };
                }
                (true, false) => spell.until_ms = Some(time_ms),
                _ => {}
            }
        }
        if lock != Some(frame.lock) {
            self.lock_since_ms = time_ms;
        }
        self.last = Some(now);
    }

    /// The periods of all bits that have been set.
    pub fn list(&self) -> Vec<Spell> {
        self.bits.iter().filter(|spell| spell.times > 0).copied().collect()
    }

    /// Time of the last change of the lock state, milliseconds of UTC since 1970.
    pub fn lock_since_ms(&self) -> f64 {
        self.lock_since_ms
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_of_one_frame_is_remembered_with_its_times() {
        let mut history = StatusHistory::default();
        let mut take = |ms: i64, status: Status, lock: LockState| {
            let frame = PoseFrame::example();
            history.frame(&PoseFrame { time_ns: ms * 1_000_000, status, lock, ..frame });
        };
        take(10, Status::POSE_VALID, LockState::Locked);
        take(11, Status::PSD_B_LOW, LockState::Held);
        take(12, Status::POSE_VALID, LockState::Locked);
        take(13, Status::POSE_VALID, LockState::Locked);
        take(14, Status::PSD_B_LOW, LockState::Locked);
        take(15, Status::PSD_B_LOW | Status::UNCALIBRATED, LockState::Locked);
        let list = history.list();
        let of = |name| list.iter().find(|spell| Status::NAMES[spell.bit].1 == name).copied().unwrap();
        let summary = |name| (of(name).since_ms, of(name).until_ms, of(name).times);
        assert_eq!(summary("PSD_B_LOW"), (14.0, None, 2));
        assert_eq!(summary("POSE_VALID"), (12.0, Some(14.0), 2));
        assert_eq!(summary("UNCALIBRATED"), (15.0, None, 1));
        assert_eq!(list.len(), 3);
        assert!((history.lock_since_ms() - 12.0).abs() < 1e-9);
    }
}
