//! Status and lock state of the newest frame in one atomic word, for occasional readers.

use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;

use trifacet_wire::{LockState, Status};

use crate::estimation::PoseReport;

/// Written for every frame, read on demand.
#[derive(Debug, Default)]
pub struct LatestStatus(AtomicU64);

/// Set once there was a frame.
const SEEN: u64 = 1 << 63;

impl LatestStatus {
    /// Records a report that has just been published.
    pub fn at(&self, report: &PoseReport) {
        let word = SEEN | u64::from(report.lock as u8) << 32 | u64::from(report.status.0);
        self.0.store(word, Relaxed);
    }

    /// Status and lock state of the newest frame; `None` before the first one.
    pub fn newest(&self) -> Option<(Status, LockState)> {
        let word = self.0.load(Relaxed);
        let lock = LockState::ALL.get((word >> 32 & 0xff) as usize)?;
        (word & SEEN != 0).then_some((Status(word as u32), *lock))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_written_status_is_read() {
        let glance = LatestStatus::default();
        assert_eq!(glance.newest(), None);
        for lock in LockState::ALL {
            let status = Status(u32::MAX >> lock as u8);
            glance.at(&PoseReport { status, lock, ..PoseReport::example() });
            assert_eq!(glance.newest(), Some((status, lock)));
        }
    }
}
