//! UTC from the clocks of this machine, through one [`SlewedOffset`].

use rustix::time::{ClockId, clock_gettime};
use trifacet_core::time::{Mono, NS_PER_S};
use trifacet_core::utc::{Reading, SlewedOffset};

/// UTC of the daemon: a [`SlewedOffset`] that reads both clocks once a second.
#[derive(Debug)]
pub struct Utc {
    offset: SlewedOffset,
    read: fn() -> Reading,
    due: Mono,
    followed: u32,
}

impl Utc {
    /// UTC from the clocks of this machine.
    pub fn system() -> Self {
        Self::reading(read_clocks)
    }

    /// UTC from the readings of `read`.
    pub fn reading(read: fn() -> Reading) -> Self {
        let start = read();
        Self { offset: SlewedOffset::new(start), read, due: start.0 + NS_PER_S, followed: 0 }
    }

    /// Nanoseconds of UTC since 1970 at `t`, and whether they agree with the system clock. `now` is the
    /// present time.
    pub fn at(&mut self, t: Mono, now: Mono) -> (i64, bool) {
        if now >= self.due {
            self.due = now + NS_PER_S;
            self.look();
        }
        (self.offset.utc_ns(t), self.offset.synced())
    }

    /// Number of steps of the system clock that were followed.
    pub fn steps_followed(&self) -> u32 {
        self.followed
    }

    fn look(&mut self) {
        let was_synced = self.offset.synced();
        if let Some(step_ns) = self.offset.update((self.read)()) {
            self.followed = self.followed.wrapping_add(1);
            let step_s = step_ns as f64 / 1e9;
            tracing::warn!(
                step_s,
                "the time of the frames follows a step of the system clock; a new session begins"
            );
            return;
        }
        let error_ms = self.offset.error_ns() as f64 / 1e6;
        match (was_synced, self.offset.synced()) {
            (true, false) => tracing::warn!(
                error_ms,
                "the system clock stepped; frames carry CLOCK_UNSYNCED until their time agrees with it again"
            ),
            (false, true) => tracing::info!("the time of the frames agrees with the system clock again"),
            _ => {}
        }
    }
}

/// Reads both clocks as close together as possible: the reading with the shortest interval of five attempts.
pub fn read_clocks() -> Reading {
    let ns = |id| {
        let t = clock_gettime(id);
        t.tv_sec * NS_PER_S + t.tv_nsec
    };
    let attempt = || {
        let before = ns(ClockId::Monotonic);
        let utc = ns(ClockId::Realtime);
        let width = ns(ClockId::Monotonic) - before;
        (width, (Mono(before + width / 2), utc))
    };
    let first = attempt();
    (0..4).map(|_| attempt()).fold(first, |best, next| if next.0 < best.0 { next } else { best }).1
}

#[cfg(test)]
mod tests {
    use super::*;

    const EPOCH: i64 = 1_800_000_000 * NS_PER_S;

    fn second(s: i64) -> Mono {
        Mono(s * NS_PER_S)
    }

    #[test]
    fn the_machines_clocks_are_read_together() {
        let (mono, utc) = read_clocks();
        let (later_mono, later_utc) = read_clocks();
        assert!(later_mono > mono);
        assert!(utc > 1_600_000_000 * NS_PER_S);
        let drift = (later_utc - utc) - (later_mono - mono);
        assert!(drift.abs() < NS_PER_S, "{drift} ns");
    }

    #[test]
    fn the_clocks_are_read_once_a_second() {
        // This clock reports UTC as 3 s ahead from second 1 on; the change is not seen before a second has
        // passed.
        fn read() -> Reading {
            use std::sync::atomic::{AtomicI64, Ordering};
            static CALLS: AtomicI64 = AtomicI64::new(0);
            let n = CALLS.fetch_add(1, Ordering::Relaxed);
            (second(n), EPOCH + n * NS_PER_S + if n > 0 { 3 * NS_PER_S } else { 0 })
        }
        let mut utc = Utc::reading(read);
        let almost = second(1) + -1;
        assert_eq!(utc.at(almost, almost), (EPOCH + NS_PER_S - 1, true));
        assert_eq!(utc.at(second(1), second(1)), (EPOCH + NS_PER_S, false), "flagged, not followed");
        assert_eq!(utc.at(second(2), second(2)), (EPOCH + 5 * NS_PER_S, true), "confirmed and followed");
        assert_eq!(utc.steps_followed(), 1);
    }
}
