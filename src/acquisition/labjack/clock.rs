//! From the timer of the device to the time of the host. Pure.

use std::time::Duration;

use trifacet_core::time::Mono;

use super::registers::CORE_TIMER_HZ;
use super::scans::StreamScan;
use crate::acquisition::timebase::{Moment, ScanCounters, Timebase};

/// Number of ticks after which the timer starts again.
const WRAP: f64 = 4_294_967_296.0;

/// The clock of the device.
#[derive(Clone, Debug)]
pub struct ScanClock {
    timebase: Timebase,
    /// Ticks per scan.
    period: f64,
    last: Option<u32>,
}

impl ScanClock {
    /// For a stream of this rate. The other arguments are those of [`Timebase`].
    pub fn new(rate_hz: f64, latency_ns: i64, silence: Duration, floor: Option<Mono>) -> Self {
        let timebase = Timebase::new(CORE_TIMER_HZ, rate_hz, latency_ns, floor).with_bursts(silence);
        Self { timebase, period: f64::from(CORE_TIMER_HZ) / rate_hz, last: None }
    }

    /// The time of a scan that arrived at `arrival`, and the number of periods since the scan before.
    pub fn moment(&mut self, scan: &StreamScan, arrival: Mono) -> (Moment, u32) {
        let last = self.last.replace(scan.tick);
        let periods = last.map_or(1, |last| self.periods(scan, last));
        (self.timebase.moment(ScanCounters { tick: scan.tick.into(), periods }, arrival), periods)
    }

    /// As the device has counted. It may count the separating scan among those that it skipped; the timer decides.
    fn periods(&self, scan: &StreamScan, last: u32) -> u32 {
        let counted = scan.lost.saturating_add(1);
        if !scan.skipped {
            return counted;
        }
        let ticks = f64::from(scan.tick.wrapping_sub(last));
        let wraps = ((f64::from(counted) * self.period - ticks) / WRAP).round().max(0.0);
        let timed = ((ticks + wraps * WRAP) / self.period).round() as u32;
        if timed.abs_diff(counted) <= 1 { timed.max(1) } else { counted }
    }
}

#[cfg(test)]
mod tests {
    use trifacet_wire::channel::MAX_CHANNELS;

    use super::*;

    /// The clock at 1 kHz after a scan at tick `last`, and a scan after `periods` periods.
    fn next(last: u32, periods: u32, lost: u32, skipped: bool) -> (Moment, u32) {
        let mut clock = ScanClock::new(1000.0, 0, Duration::from_millis(20), None);
        let scan = |tick, lost, skipped| StreamScan { tick, samples: [0; MAX_CHANNELS], lost, skipped };
        clock.moment(&scan(last, 0, false), Mono(0));
        let arrival = Mono(i64::from(periods) * 1_000_000);
        clock.moment(&scan(last.wrapping_add(periods.wrapping_mul(40_000)), lost, skipped), arrival)
    }

    #[test]
    fn the_timer_wraps_without_a_jump_of_the_time() {
        let (moment, periods) = next(u32::MAX - 10_000, 1, 0, false);
        assert_eq!((moment.time, periods, moment.fault), (Mono(1_000_000), 1, None));
    }

    #[test]
    fn the_timer_tells_whether_the_separating_scan_is_counted() {
        assert_eq!(next(0, 51, 50, true).1, 51);
        assert_eq!(next(0, 50, 50, true).1, 50);
        assert_eq!(next(0, 52, 50, true).1, 52);
        assert_eq!(next(5, 110_000, 110_000, true).1, 110_000, "after more than one turn of the timer");
        let (moment, periods) = next(0, 70, 50, true);
        assert_eq!(periods, 51, "the counts of the device and its timer differ");
        assert!(moment.fault.is_some());
    }
}
