//! Converts recorded time to present time. Pure.

use std::time::Duration;

use trifacet_core::pipeline::SilenceTimes;
use trifacet_core::time::{Mono, NS_PER_S};

/// A larger step back in time means another recording, or another boot of the machine.
const BACK_NS: i64 = NS_PER_S;

/// Relation of recorded time to present time.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    speed: f64,
    /// A recorded time, and the present time that corresponds to it.
    anchor: (Mono, Mono),
    /// The latest recorded time so far.
    latest: Option<Mono>,
}

impl Pace {
    /// Replays at `speed` times the recorded speed. `then` corresponds to `now`.
    pub fn new(speed: f64, then: Mono, now: Mono) -> Self {
        Self { speed, anchor: (then, now), latest: None }
    }

    /// The next recorded time will correspond to the present.
    pub fn anew(&mut self) {
        self.latest = None;
    }

    /// The time at which an entry recorded at `then` is due. After a step back in recorded time: now.
    pub fn due(&mut self, then: Mono, now: Mono) -> Mono {
        if self.latest.is_none_or(|latest| then.0 < latest.0.saturating_sub(BACK_NS)) {
            (self.anchor, self.latest) = ((then, now), Some(then));
        }
        self.latest = self.latest.max(Some(then));
        self.present(then)
    }

    /// The present time that corresponds to a recorded time.
    pub fn present(&self, then: Mono) -> Mono {
        let (recorded, present) = self.anchor;
        let since = then.0.saturating_sub(recorded.0) as f64 / self.speed;
        Mono(present.0.saturating_add(since as i64))
    }

    /// The recorded time that corresponds to a present time.
    pub fn recorded(&self, now: Mono) -> Mono {
        let (recorded, present) = self.anchor;
        Mono(recorded.0.saturating_add(((now - present) as f64 * self.speed) as i64))
    }

    /// Present time without an entry that counts as silence, nanoseconds, for a recording with samples at
    /// `rate_hz`: `shortest`, or five periods if longer.
    pub fn patience_ns(&self, rate_hz: f64, shortest: Duration) -> i64 {
        SilenceTimes::new(rate_hz * self.speed, shortest).first.as_nanos() as i64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    #[test]
    fn at_double_speed_an_entry_of_one_second_later_is_due_after_half_a_second() {
        let (then, now) = (Mono(70 * NS_PER_S), Mono(5 * NS_PER_S));
        let mut pace = Pace::new(2.0, Mono(0), Mono(0));
        assert_eq!(pace.due(then, now), now);
        assert_eq!(pace.due(then + NS_PER_S, now), now + NS_PER_S / 2);
        assert_eq!(pace.recorded(now + NS_PER_S / 2), then + NS_PER_S);
        // A silence has a slightly later time than the sample that ended it.
        assert_eq!(pace.due(then + (NS_PER_S - MS), now), now + (NS_PER_S - MS) / 2);
    }

    #[test]
    fn recorded_time_that_goes_back_restarts_at_the_present() {
        let mut pace = Pace::new(1.0, Mono(0), Mono(0));
        pace.due(Mono(70 * NS_PER_S), Mono(0));
        let now = Mono(3 * NS_PER_S);
        assert_eq!(pace.due(Mono(10 * NS_PER_S), now), now, "another boot");
        assert_eq!(pace.due(Mono(11 * NS_PER_S), now), now + NS_PER_S);
        pace.anew();
        assert_eq!(pace.due(Mono(12 * NS_PER_S), now), now);
    }

    #[test]
    fn patience_is_in_present_time() {
        let of = |speed, rate_hz| {
            Pace::new(speed, Mono(0), Mono(0)).patience_ns(rate_hz, Duration::from_millis(20))
        };
        assert_eq!([of(1.0, 1000.0), of(100.0, 1000.0), of(0.1, 1000.0)], [20 * MS, 20 * MS, 50 * MS]);
    }
}
