//! UTC for output: monotonic time plus one offset that only slews.
//!
//! The offset follows the system clock at no more than 500 ppm, so that the time between two frames is
//! correct to 0.05 % whatever happens to the system clock. A step of that clock is flagged, and the offset
//! approaches it at the slew rate. A step that would take minutes to slew (the clock was set, or the machine
//! slept) is followed at once, when a second reading confirms it.

use crate::time::Mono;

/// The slew is one part in this many: 500 ppm.
const SLEW: i64 = 2000;

/// If the system clock is farther away than this (1 ms), it has stepped, and the time is not UTC.
const STEP_NS: i64 = 1_000_000;

/// If the system clock is farther away than this (0.1 s, 200 s of slewing), the offset follows its step.
const FOLLOW_NS: i64 = 100_000_000;

/// A moment read from both clocks: monotonic, and nanoseconds of UTC since 1970.
pub type Reading = (Mono, i64);

/// One linear piece of the offset: it moves from `offset` by `change`, at the slew rate.
#[derive(Clone, Copy, Debug)]
struct Piece {
    from: Mono,
    offset: i64,
    change: i64,
}

impl Piece {
    fn offset_at(&self, t: Mono) -> i64 {
        let reach = ((t - self.from) / SLEW).max(0);
        self.offset + self.change.clamp(-reach, reach)
    }
}

/// The slewed offset. Pure: both clock readings are inputs, about once a second.
#[derive(Clone, Copy, Debug)]
pub struct SlewedOffset {
    /// The previous piece. Samples are older than the last update, and their time must not depend on when the
    /// update came.
    before: Piece,
    now: Piece,
}

impl SlewedOffset {
    /// An offset that agrees with both clocks at the start.
    pub fn new((mono, utc): Reading) -> Self {
        let piece = Piece { from: mono, offset: utc - mono.0, change: 0 };
        Self { before: piece, now: piece }
    }

    /// Takes a later reading of both clocks. Returns the size of a step that was followed, nanoseconds. From
    /// then on all moments, also earlier ones, have the new offset: two time scales are never mixed.
    pub fn update(&mut self, (mono, utc): Reading) -> Option<i64> {
        let offset = self.now.offset_at(mono);
        let change = utc - mono.0 - offset;
        let confirmed = (change - self.now.change).abs() <= STEP_NS;
        if change.abs() > FOLLOW_NS && confirmed {
            *self = Self::new((mono, utc));
            return Some(change);
        }
        self.before = self.now;
        self.now = Piece { from: mono, offset, change };
        None
    }

    /// Nanoseconds of UTC since 1970 at this moment.
    pub fn utc_ns(&self, t: Mono) -> i64 {
        let piece = if t < self.now.from { &self.before } else { &self.now };
        t.0 + piece.offset_at(t)
    }

    /// How far the system clock was from this offset at the last reading, nanoseconds.
    pub fn error_ns(&self) -> i64 {
        self.now.change
    }

    /// Whether the system clock is within 1 ms; false after a step, until the slew is complete.
    pub fn synced(&self) -> bool {
        self.error_ns().abs() <= STEP_NS
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::NS_PER_S;

    const EPOCH: i64 = 1_800_000_000 * NS_PER_S;

    fn second(s: i64) -> Mono {
        Mono(s * NS_PER_S)
    }

    #[test]
    fn agrees_from_the_start_and_follows_small_errors_within_a_second() {
        let mut offset = SlewedOffset::new((second(5), EPOCH + 5 * NS_PER_S));
        assert_eq!(offset.utc_ns(second(7)), EPOCH + 7 * NS_PER_S);
        offset.update((second(10), EPOCH + 10 * NS_PER_S + 300_000));
        assert!(offset.synced());
        assert_eq!(offset.utc_ns(second(10)), EPOCH + 10 * NS_PER_S, "no jump at the update");
        assert_eq!(offset.utc_ns(second(11)), EPOCH + 11 * NS_PER_S + 300_000, "there, and no further");
    }

    #[test]
    fn a_step_is_flagged_and_slewed_at_500_ppm() {
        for step in [10_000_000, -10_000_000] {
            let mut offset = SlewedOffset::new((second(0), EPOCH));
            for s in 1..=17 {
                offset.update((second(s), EPOCH + s * NS_PER_S + step));
                assert!(!offset.synced(), "{s} s after a step of 10 ms");
            }
            assert_eq!(offset.utc_ns(second(18)), EPOCH + 18 * NS_PER_S + step / 10 * 17 / 2);
            for s in 18..=30 {
                offset.update((second(s), EPOCH + s * NS_PER_S + step));
            }
            assert!(offset.synced());
            assert_eq!(offset.utc_ns(second(31)), EPOCH + 31 * NS_PER_S + step);
        }
    }

    #[test]
    fn a_large_step_is_followed_once_it_is_confirmed() {
        for step in [3600 * NS_PER_S, -3600 * NS_PER_S, 101_000_000] {
            let mut offset = SlewedOffset::new((second(0), EPOCH));
            let reading = |s: i64, step: i64| (second(s), EPOCH + s * NS_PER_S + step);
            assert_eq!(offset.update(reading(1, step)), None, "one reading may be wrong");
            assert!(!offset.synced());
            assert_eq!(offset.utc_ns(second(1)), EPOCH + NS_PER_S);
            let followed = offset.update(reading(2, step)).unwrap();
            assert!((followed - step).abs() <= NS_PER_S / 2000, "{followed}");
            assert!(offset.synced());
            assert_eq!(offset.utc_ns(second(3)), EPOCH + 3 * NS_PER_S + step);
            assert_eq!(offset.utc_ns(second(1)), EPOCH + NS_PER_S + step, "one scale for all moments");
            assert_eq!(offset.update(reading(4, step)), None);
        }
        let mut offset = SlewedOffset::new((second(0), EPOCH));
        for s in 1..10 {
            let wild = s * 2 * NS_PER_S;
            assert_eq!(offset.update((second(s), EPOCH + s * NS_PER_S + wild)), None, "still being set");
            assert!(!offset.synced());
        }
    }

    #[test]
    fn time_runs_on_evenly_for_samples_older_than_the_update() {
        let mut offset = SlewedOffset::new((second(0), EPOCH));
        offset.update((second(1), EPOCH + NS_PER_S - 5_000_000));
        let sample = second(2) + -200_000_000;
        let early = offset.utc_ns(sample);
        offset.update((second(2), EPOCH + 2 * NS_PER_S - 5_000_000));
        assert_eq!(offset.utc_ns(sample), early);
        let later = offset.utc_ns(sample + 50_000);
        assert_eq!(later - early, 50_000 - 25);
    }
}
