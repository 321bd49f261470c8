//! When something went wrong: once an episode. Pure.

use super::Entry;
use crate::centering::LockState;
use crate::clock::{Mono, NS_PER_S};
use crate::estimation::Status;

/// Looks for faults. An episode ends when nothing has been wrong for a while; until then, nothing that
/// goes wrong is news.
#[derive(Clone, Debug)]
pub struct Trigger {
    calm_ns: i64,
    /// Since when nothing has been wrong; none before the first frame.
    calm: Option<Mono>,
    /// Something is wrong, or was until just now. So it begins: a start is no fault.
    episode: bool,
}

impl Trigger {
    /// An episode ends after so many seconds without fault.
    pub fn new(calm_s: f64) -> Self {
        Self { calm_ns: (calm_s * NS_PER_S as f64) as i64, calm: None, episode: true }
    }

    /// Takes every entry in turn; says what went wrong when an episode begins.
    pub fn see(&mut self, entry: &Entry) -> Option<&'static str> {
        let (time, wrong) = match entry {
            Entry::Frame { frame, time, .. } => {
                let wrong = if frame.status.has(Status::SOURCE_DOWN) {
                    Some("the source is down")
                } else if frame.lost > 0 {
                    Some("samples were lost")
                } else if frame.status.has(Status::POSE_VALID) {
                    None
                } else {
                    Some("there is no valid pose")
                };
                (*time, wrong)
            }
            Entry::Lock { time, before: LockState::Locked, .. } => (*time, Some("the lock is lost")),
            _ => return None,
        };
        if wrong.is_some() {
            self.calm = None;
            return wrong.filter(|_| !std::mem::replace(&mut self.episode, true));
        }
        let calm = *self.calm.get_or_insert(time);
        if time - calm >= self.calm_ns {
            self.episode = false;
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::publishing::PoseFrame;
    use crate::publishing::stamp::tests::{report, stamp};

    fn frame(second: i64, status: Status, lost: u16) -> Entry {
        let frame = PoseFrame { status, lost, ..PoseFrame::from_report(&report(), stamp()) };
        Entry::Frame { frame, time: Mono(second * NS_PER_S), covariance: None }
    }

    #[test]
    fn each_episode_triggers_once_and_the_start_is_none() {
        let good = |second| frame(second, Status::POSE_VALID, 0);
        let mut trigger = Trigger::new(3.0);
        assert_eq!(trigger.see(&frame(0, Status::default(), 0)), None, "nothing was fine before");
        for second in 1..=4 {
            assert_eq!(trigger.see(&good(second)), None);
        }
        assert_eq!(trigger.see(&frame(5, Status::SOURCE_DOWN, 0)), Some("the source is down"));
        assert_eq!(trigger.see(&frame(6, Status::default(), 0)), None, "the same episode");
        assert_eq!(trigger.see(&good(7)), None);
        assert_eq!(trigger.see(&frame(8, Status::POSE_VALID, 2)), None, "still the same");
        for second in 9..=12 {
            assert_eq!(trigger.see(&good(second)), None);
        }
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
