//! From the counters of the board to the monotonic time of the host.
//!
//! A scan arrives some time after it was taken: delayed by the line, the USB stack and the scheduler, never
//! early. The fastest arrivals therefore show the true relation of the two clocks; the slow ones contain no
//! information. Arrivals are grouped into blocks. The fastest one of each block updates a Kalman filter of
//! offset and drift. An arrival before its predicted time shows at once that the prediction is late. What
//! remains is the constant part of the delay, which must be configured (`latency_us`).
//!
//! The clock of the board is not trusted: its tick is compared with its sequence numbers
//! (`DeviceClock`), and no time is returned that the arrival excludes.

mod device_clock;
#[cfg(test)]
mod fault_tests;
mod filter;

use std::time::Duration;

use device_clock::DeviceClock;
pub use device_clock::{ScanCounters, TickFault};
use filter::{Block, Filter};
use trifacet_core::time::{Mono, NS_PER_S};

/// While a correction holds the time back, the time advances at this fraction of its normal rate.
const SLOWEST: f64 = 0.5;
/// Such a time is at most this much later than the arrival, nanoseconds.
const MOST_AFTER_NS: i64 = 10_000_000;
/// Longest delay from scan to arrival, nanoseconds, unless scans arrive in longer bursts. An earlier time is
/// excluded by the arrival.
const MAX_DELAY_NS: i64 = NS_PER_S / 2;
/// An arrival that is earlier than predicted by this and five standard uncertainties shows that the clock of the
/// board has jumped, nanoseconds.
const EARLY_NS: f64 = 10e6;
/// Standard uncertainty of a time of which only the arrival is known, as a fraction of the longest delay:
/// 1 / sqrt(12).
const ARRIVAL_ONLY: f64 = 0.288_675_134_594_812_9;
/// Drift beyond which the clock of the board is at fault. RC oscillators have 1 %, crystals 100 ppm.
const LARGE_DRIFT: f64 = 1e-3;
/// Time by the clock of the board after which the arrivals say how late the scans are, nanoseconds. Before, all of them
/// may have been delayed together, in a first block: then only the time of the start bounds the delay.
const FIRST_NS: f64 = 1e9;
/// Time after which the filter knows a large drift, nanoseconds of the board's clock.
const DRIFT_KNOWN_NS: f64 = 2e9;

/// The time of a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Time at which the scan was taken.
    pub time: Mono,
    /// Its standard uncertainty, nanoseconds.
    pub sigma_ns: f64,
    /// A fault of the board's clock that this scan shows.
    pub fault: Option<TickFault>,
}

/// Relation between the clock of the board and the clock of the host.
#[derive(Clone, Debug)]
pub struct Timebase {
    tick_hz: u32,
    tick_bits: u32,
    rate_hz: f64,
    latency_ns: i64,
    /// Longest delay from scan to arrival, nanoseconds.
    max_delay_ns: i64,
    /// Among the arrivals of this time is a fast one, nanoseconds.
    burst_ns: f64,
    /// No earlier time is returned.
    floor: Option<Mono>,
    /// When the board was asked to start.
    asked: Option<Mono>,
    state: Option<State>,
}

#[derive(Clone, Debug)]
struct State {
    clock: DeviceClock,
    /// The first arrival; the origin of the filter.
    origin: Mono,
    /// Time since the first scan by the clock of the board, nanoseconds.
    device_ns: f64,
    /// The same, also across corrections of the origin.
    elapsed_ns: f64,
    filter: Filter,
    block: Block,
    /// How early the fastest arrival of this block was relative to the prediction, nanoseconds: zero or
    /// negative.
    early_ns: f64,
    /// The last returned time, and its device time.
    given: Option<(Mono, f64)>,
    /// A drift beyond [`LARGE_DRIFT`] has been reported.
    drifts: bool,
}

impl Timebase {
    /// A relation for a clock of `tick_hz` on a board that samples at `rate_hz`. `latency_ns` is the constant
    /// part of the delay from the scan to its arrival. No time before `floor` (the time of the last scan
    /// before a reconnect) is returned.
    pub fn new(tick_hz: u32, rate_hz: f64, latency_ns: i64, floor: Option<Mono>) -> Self {
        Self {
            tick_hz,
            tick_bits: 32,
            rate_hz,
            latency_ns,
            max_delay_ns: MAX_DELAY_NS,
            burst_ns: 0.0,
            floor,
            asked: None,
            state: None,
        }
    }

    /// The same for a tick of this width, 32 or 64 bits, instead of 32.
    #[must_use]
    pub fn with_tick_bits(self, tick_bits: u32) -> Self {
        Self { tick_bits, ..self }
    }

    /// The same for scans that arrive in bursts, at intervals of at most `interval`.
    #[must_use]
    pub fn with_bursts(self, interval: Duration) -> Self {
        let interval_ns = interval.as_nanos() as i64;
        let burst_ns = interval_ns.min(NS_PER_S) as f64;
        Self { max_delay_ns: MAX_DELAY_NS.max(interval_ns), burst_ns, ..self }
    }

    /// The same for a board that was asked to start at `asked`: it has taken none of its scans before.
    #[must_use]
    pub fn started(self, asked: Mono) -> Self {
        Self { asked: Some(asked), ..self }
    }

    /// Time of the scan with these counters that arrived at `arrival`. Arrivals must be in order.
    pub fn moment(&mut self, counters: ScanCounters, arrival: Mono) -> Moment {
        let Self { tick_hz, tick_bits, rate_hz, max_delay_ns, burst_ns, asked, .. } = *self;
        let state = match &mut self.state {
            Some(state) => state,
            None => self.state.insert(State::new(
                DeviceClock::new(tick_hz, tick_bits, rate_hz, counters.tick, arrival),
                arrival,
            )),
        };
        let (sigma_ns, fault) = state.advance(counters, arrival, max_delay_ns, burst_ns);
        let (possible, excluded_ns) = state.bounded(arrival, max_delay_ns);
        let estimate = possible + -self.latency_ns;
        let time =
            estimate.max(state.slowest(arrival).or(self.floor.map(|floor| floor + 1)).unwrap_or(estimate));
        state.given = Some((time, state.device_ns));
        let held_back = (time - estimate) as f64;
        let tick_ns = state.clock.tick_ns();
        let known = state.filter.variance[0].max(tick_ns * tick_ns / 12.0).sqrt();
        let period_ns = NS_PER_S as f64 / rate_hz;
        let late_ns = asked.map_or(0.0, |asked| state.possibly_late_ns(possible, asked, period_ns));
        let known = known.max(state.filter.doubt_ns).max(late_ns * ARRIVAL_ONLY);
        let sigma_ns =
            known.max(sigma_ns.unwrap_or(max_delay_ns as f64 * ARRIVAL_ONLY)).max(held_back).max(excluded_ns);
        Moment { time, sigma_ns, fault }
    }

    /// Estimated rate error of the board's clock: 10e-6 means that the clock gains 10 microseconds per
    /// second.
    pub fn drift(&self) -> Option<f64> {
        self.state.as_ref().map(|state| -state.filter.drift)
    }
}

impl State {
    fn new(clock: DeviceClock, arrival: Mono) -> Self {
        Self {
            clock,
            origin: arrival,
            device_ns: 0.0,
            elapsed_ns: 0.0,
            filter: Filter::default(),
            block: Block::default(),
            early_ns: 0.0,
            given: None,
            drifts: false,
        }
    }

    /// Takes a scan. Returns the standard uncertainty that its counters leave, and their fault.
    fn advance(
        &mut self,
        counters: ScanCounters,
        arrival: Mono,
        max_delay_ns: i64,
        burst_ns: f64,
    ) -> (Option<f64>, Option<TickFault>) {
        if self.given.is_none() {
            self.block.add(0.0, 0.0); // the first arrival is the origin
            return (Some(0.0), None);
        }
        let (predicted_ns, drift) = (self.device_ns + self.filter.offset_ns, self.filter.drift);
        let since_origin_ns = (arrival - self.origin) as f64;
        let early_ns = 5.0 * self.filter.variance[0].sqrt();
        let possible = |step_ns: f64| {
            let delay_ns = since_origin_ns - predicted_ns - step_ns * (1.0 + drift);
            (-early_ns..=max_delay_ns as f64).contains(&delay_ns)
        };
        let step = self.clock.step(counters, arrival, possible);
        self.elapsed_ns += step.ns;
        if step.decided {
            self.filter.drift = 0.0; // that of another counter
            self.anchor(arrival);
            return (step.sigma_ns, step.fault);
        }
        self.device_ns += step.ns;
        self.filter.predict(step.ns);
        let residual_ns = since_origin_ns - self.device_ns - self.filter.offset_ns;
        if residual_ns < -early_ns - EARLY_NS {
            self.anchor(arrival);
            let ahead = TickFault::Ahead { ns: (-residual_ns) as i64 };
            let reported = -residual_ns > max_delay_ns as f64;
            return (step.sigma_ns, step.fault.or(reported.then_some(ahead)));
        }
        self.early_ns = self.early_ns.min(residual_ns);
        self.block.add(residual_ns, step.ns);
        let mut fault = step.fault;
        if let Some((late_ns, sigma_ns)) = self.block.close(self.device_ns, burst_ns) {
            self.filter.update(late_ns, sigma_ns);
            self.early_ns = 0.0;
            fault = fault.or(self.large_drift());
        }
        (step.sigma_ns, fault)
    }

    /// Begins again at this arrival, because the predicted time is later. The drift is kept.
    fn anchor(&mut self, arrival: Mono) {
        let drift = self.filter.drift;
        (self.origin, self.device_ns, self.early_ns) = (arrival, 0.0, 0.0);
        (self.filter, self.block) = (Filter::with_drift(drift), Block::default());
        self.block.add(0.0, 0.0);
        self.given = self.given.map(|(time, _)| (time, 0.0));
    }

    /// The earliest time that keeps times in order. Scans of one read arrive together: so that their times differ
    /// by a sensible amount, they may lie after the arrival by a few milliseconds.
    fn slowest(&self, arrival: Mono) -> Option<Mono> {
        let (time, at) = self.given?;
        let slowest = time + ((self.device_ns - at) * SLOWEST).round() as i64;
        Some(slowest.min(arrival + MOST_AFTER_NS).max(time + 1))
    }

    /// A drift that no clock has which runs at its declared rate; reported once.
    fn large_drift(&mut self) -> Option<TickFault> {
        let drift = -self.filter.drift;
        let known = self.device_ns > DRIFT_KNOWN_NS;
        let large = known && drift.abs() > LARGE_DRIFT + 3.0 * self.filter.variance[2].sqrt();
        let news = large && !std::mem::replace(&mut self.drifts, large);
        let declared_hz = NS_PER_S as f64 / self.clock.tick_ns();
        news.then_some(TickFault::Rate { measured_hz: declared_hz * (1.0 + drift), declared_hz })
    }

    /// By how many nanoseconds a time may be too late because all arrivals so far were delayed: the scans were taken
    /// after the board was asked to start.
    fn possibly_late_ns(&self, time: Mono, asked: Mono, period_ns: f64) -> f64 {
        let early = self.elapsed_ns < FIRST_NS;
        if early { ((time - asked) as f64 - self.elapsed_ns - period_ns).max(0.0) } else { 0.0 }
    }

    /// Host time of the newest scan, as if the delay were zero, within what its arrival allows; and by how
    /// many nanoseconds the estimate was outside.
    fn bounded(&self, arrival: Mono, max_delay_ns: i64) -> (Mono, f64) {
        let estimate = self.origin + (self.device_ns + self.filter.offset_ns + self.early_ns).round() as i64;
        let possible = estimate.clamp(arrival + -max_delay_ns, arrival);
        (possible, (possible - estimate).abs() as f64)
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, Exp1};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    const START: Mono = Mono(1_000_000_000_000);

    /// A board whose clock gains 50 ppm, with a delay of about 100 us.
    struct Board {
        timebase: Timebase,
        tick_hz: u32,
        rate_hz: f64,
        last_sequence: Option<u64>,
        first_tick: u32,
        drift: f64,
        /// Of the fastest arrival.
        fixed_ns: f64,
        random: Pcg64Mcg,
    }

    impl Board {
        fn new(tick_hz: u32, rate_hz: f64) -> Self {
            Self {
                timebase: Timebase::new(tick_hz, rate_hz, 0, None),
                tick_hz,
                rate_hz,
                last_sequence: None,
                first_tick: u32::MAX - 1_500_000,
                drift: 50e-6,
                fixed_ns: 0.0,
                random: Pcg64Mcg::seed_from_u64(7),
            }
        }

        /// Takes a scan at `t_s`, delivers it `extra_ns` later than usual, and returns the result of the
        /// timebase with its error in nanoseconds.
        fn scan(&mut self, t_s: f64, extra_ns: f64) -> (Moment, f64) {
            let ticks = (t_s * (1.0 + self.drift) * f64::from(self.tick_hz)).round() as u64;
            let tick = self.first_tick.wrapping_add(ticks as u32).into();
            let late: f64 = Exp1.sample(&mut self.random);
            let arrival = START + (t_s * 1e9 + self.fixed_ns + late * 100e3 + extra_ns) as i64;
            let sequence = (t_s * self.rate_hz).round() as u64;
            let periods = self.last_sequence.replace(sequence).map_or(1, |last| (sequence - last) as u32);
            let moment = self.timebase.moment(ScanCounters { tick, periods }, arrival);
            (moment, (moment.time - START) as f64 - t_s * 1e9)
        }

        /// Runs between two times and returns the largest error, nanoseconds.
        fn run(&mut self, from_s: f64, until_s: f64) -> f64 {
            let rate_hz = self.rate_hz;
            let scans = (from_s * rate_hz) as u64..(until_s * rate_hz) as u64;
            scans.map(|k| self.scan(k as f64 / rate_hz, 0.0).1.abs()).fold(0.0, f64::max)
        }
    }

    #[test]
    fn acquisition_times_are_estimated_despite_jitter_and_drift() {
        let mut board = Board::new(1_000_000, 1000.0);
        assert!(board.run(0.0, 1.0) < 2e6);
        assert!(board.run(1.0, 10.0) < 20e3);
        let worst = board.run(10.0, 60.0);
        assert!(worst < 3e3, "{worst} ns");
        let drift = board.timebase.drift().unwrap();
        assert!((drift - 50e-6).abs() < 0.5e-6, "{drift}");
        let (moment, error) = board.scan(60.0, 0.0);
        assert!(moment.sigma_ns < 3e3 && error.abs() < 5.0 * moment.sigma_ns, "{error} of {moment:?}");
    }

    #[test]
    fn the_first_times_are_late_by_no_more_than_their_arrival() {
        let mut board = Board::new(1_000_000, 1000.0);
        for k in 0..100 {
            let (moment, error) = board.scan(f64::from(k) * 1e-3, 0.0);
            assert!(error < 5.0 * moment.sigma_ns, "{error} of {moment:?}");
        }
    }

    #[test]
    fn a_pause_of_the_host_does_not_shift_the_time() {
        for (rate_hz, hiccup) in [(1000.0, 5), (1000.0, 2000), (10_000.0, 50), (20.0, 3)] {
            let mut board = Board::new(10_000_000, rate_hz);
            board.run(0.0, 60.0);
            let begin = (60.0 * rate_hz) as u64;
            for k in 0..hiccup {
                let (_, error) = board.scan((begin + k) as f64 / rate_hz, 5e6);
                assert!(error.abs() < 25e3, "{rate_hz} Hz, scan {k} of the hiccup: {error} ns");
            }
            let after = board.run(60.0 + hiccup as f64 / rate_hz, 62.0 + hiccup as f64 / rate_hz);
            assert!(after < 25e3, "{rate_hz} Hz: {after} ns after the hiccup");
        }
    }

    #[test]
    fn a_longer_delay_is_accepted_after_some_time_and_a_shorter_one_at_once() {
        let mut board = Board::new(1_000_000, 1000.0);
        board.run(0.0, 30.0);
        board.fixed_ns = 3e6;
        assert!(board.run(30.0, 31.0) < 20e3);
        board.run(31.0, 35.0);
        let (_, error) = board.scan(35.0, 0.0);
        assert!((error - 3e6).abs() < 100e3, "{error} ns");
        board.fixed_ns = 0.0;
        board.run(35.001, 35.05);
        assert!(board.run(35.05, 36.0) < 100e3);
    }

    #[test]
    fn ticks_wrap_also_many_times_between_two_scans() {
        let mut board = Board::new(1_000_000_000, 1000.0);
        board.run(0.0, 20.0);
        for t_s in [20.0, 24.9, 60.0, 60.001] {
            let (_, error) = board.scan(t_s, 0.0);
            assert!(error.abs() < 300e3, "{t_s} s: {error} ns");
        }
    }

    #[test]
    fn time_never_goes_back_also_across_restarts() {
        let mut timebase = Timebase::new(1_000_000, 1000.0, 250_000, Some(START + 900_000));
        let first = timebase.moment(ScanCounters { tick: 0, periods: 1 }, START + 1_000_000);
        assert_eq!(first.time, START + 900_001, "not before the last scan, although it was taken earlier");
        assert!(first.sigma_ns >= 150e3);
        let mut last = first.time;
        for k in 1..100_u32 {
            let late_ns = if k > 20 { 100_000 } else { 1_000_000 };
            let arrival = START + (i64::from(k) * 1_000_000 + late_ns);
            let moment = timebase.moment(ScanCounters { tick: u64::from(k) * 1000, periods: 1 }, arrival);
            assert!(moment.time - last >= 499_999, "{k}: {}", moment.time - last);
            last = moment.time;
        }
        assert!((last - START - (99_000_000 + 100_000 - 250_000)).abs() < 50_000);
    }
}
