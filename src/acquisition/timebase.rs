//! From ticks of the board's clock to the monotonic time of the host.
//!
//! A scan arrives some time after it was taken: delayed by the line, the USB stack and the scheduler, never
//! early. The fastest arrivals therefore show the true relation of the two clocks; the slow ones contain no
//! information. Arrivals are grouped into blocks. The fastest one of each block updates a Kalman filter of
//! offset and drift. An arrival before its predicted time shows at once that the prediction is late. What
//! remains is the constant part of the delay, which must be configured (`latency_us`).

use trifacet_core::time::{Mono, NS_PER_S};

/// Standard uncertainty of the offset at the start, nanoseconds: the possible delay of a first arrival.
const FIRST_SIGMA_NS: f64 = 1e6;
/// Standard uncertainty of the drift at the start: cheap crystals are within 100 ppm.
const DRIFT_SIGMA: f64 = 100e-6;
/// Random walk of the drift (temperature), per square root of a second.
const DRIFT_WANDER: f64 = 0.05e-6;
/// Random walk of the offset, nanoseconds per square root of a second.
const OFFSET_WANDER_NS: f64 = 300.0;
/// Smallest standard uncertainty of the fastest arrival of a block, nanoseconds.
const ARRIVAL_SIGMA_NS: f64 = 500.0;
/// Smallest number of arrivals in a block: among this many, one is fast.
const BLOCK_ARRIVALS: u32 = 16;
/// Longest duration of a block that has enough arrivals, nanoseconds.
const BLOCK_NS: f64 = 0.25e9;
/// Early blocks last this fraction of the elapsed time, so that the filter converges quickly.
const BLOCK_PART: f64 = 0.25;
/// A block whose fastest arrival is later than predicted by this many standard uncertainties is rejected.
const GATE: f64 = 5.0;
/// After this many rejections in a row, the delay itself has become longer.
const REJECTED_IN_A_ROW: u32 = 8;
/// While a correction holds the time back, the time advances at this fraction of its normal rate.
const SLOWEST: f64 = 0.5;

/// The time of a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Time at which the scan was taken.
    pub time: Mono,
    /// Its standard uncertainty, nanoseconds.
    pub sigma_ns: f64,
}

/// Relation between the ticks of the board and the clock of the host.
#[derive(Clone, Debug)]
pub struct Timebase {
    tick_ns: f64,
    latency_ns: i64,
    /// No earlier time is returned.
    floor: Option<Mono>,
    state: Option<State>,
}

#[derive(Clone, Debug)]
struct State {
    last_tick: u32,
    last_arrival: Mono,
    /// The first arrival; the origin of the filter.
    origin: Mono,
    /// Time since the first scan by the clock of the board, nanoseconds.
    device_ns: f64,
    filter: Filter,
    block: Block,
    /// How early the fastest arrival of this block was relative to the prediction, nanoseconds: zero or
    /// negative.
    early_ns: f64,
    /// The last returned time, and its device time.
    given: Option<(Mono, f64)>,
}

impl Timebase {
    /// A relation for a clock of `tick_hz`. `latency_ns` is the constant part of the delay from the scan to
    /// its arrival. No time before `floor` (the time of the last scan before a reconnect) is returned.
    pub fn new(tick_hz: u32, latency_ns: i64, floor: Option<Mono>) -> Self {
        Self { tick_ns: NS_PER_S as f64 / f64::from(tick_hz), latency_ns, floor, state: None }
    }

    /// Time of the scan with this tick that arrived at `arrival`. Ticks and arrivals must be in order.
    pub fn moment(&mut self, tick: u32, arrival: Mono) -> Moment {
        let tick_ns = self.tick_ns;
        let state = self.state.get_or_insert_with(|| State::new(tick, arrival));
        state.advance(tick, arrival, tick_ns);
        let estimate = state.estimate() + -self.latency_ns;
        let slowest = state.given.map(|(time, at)| time + ((state.device_ns - at) * SLOWEST).round() as i64);
        let time = estimate.max(slowest.or(self.floor.map(|floor| floor + 1)).unwrap_or(estimate));
        state.given = Some((time, state.device_ns));
        let held_back = (time - estimate) as f64;
        Moment {
            time,
            sigma_ns: state.filter.variance[0].max(tick_ns * tick_ns / 12.0).sqrt().max(held_back),
        }
    }

    /// Estimated rate error of the board's clock: 10e-6 means that the clock gains 10 microseconds per
    /// second.
    pub fn drift(&self) -> Option<f64> {
        self.state.as_ref().map(|state| -state.filter.drift)
    }
}

impl State {
    fn new(tick: u32, arrival: Mono) -> Self {
        Self {
            last_tick: tick,
            last_arrival: arrival,
            origin: arrival,
            device_ns: 0.0,
            filter: Filter::default(),
            block: Block::default(),
            early_ns: 0.0,
            given: None,
        }
    }

    fn advance(&mut self, tick: u32, arrival: Mono, tick_ns: f64) {
        let step_ns = self.step(tick, arrival, tick_ns);
        self.device_ns += step_ns;
        self.last_tick = tick;
        self.last_arrival = arrival;
        self.filter.predict(step_ns);
        let residual_ns = (arrival - self.origin) as f64 - self.device_ns - self.filter.offset_ns;
        self.early_ns = self.early_ns.min(residual_ns);
        self.block.add(residual_ns, step_ns);
        if let Some((late_ns, sigma_ns)) = self.block.close(self.device_ns) {
            self.filter.update(late_ns, sigma_ns);
            self.early_ns = 0.0;
        }
    }

    /// Host time of the newest scan, as if the delay were zero.
    fn estimate(&self) -> Mono {
        self.origin + (self.device_ns + self.filter.offset_ns + self.early_ns).round() as i64
    }

    /// Device time since the previous scan, nanoseconds. The ticks give this time modulo the range of the
    /// counter; the arrival times give the number of wraps.
    fn step(&self, tick: u32, arrival: Mono, tick_ns: f64) -> f64 {
        let turn_ns = (f64::from(u32::MAX) + 1.0) * tick_ns;
        let step_ns = f64::from(tick.wrapping_sub(self.last_tick)) * tick_ns;
        let turns = (((arrival - self.last_arrival) as f64 - step_ns) / turn_ns).round().max(0.0);
        step_ns + turns * turn_ns
    }
}

/// Offset and drift with their covariance.
#[derive(Clone, Debug)]
struct Filter {
    /// Host time minus device time, from their common origin, nanoseconds.
    offset_ns: f64,
    /// Rate of the offset, nanoseconds per nanosecond.
    drift: f64,
    /// Variance of the offset, covariance, variance of the drift.
    variance: [f64; 3],
    refused: u32,
}

impl Default for Filter {
    fn default() -> Self {
        let variance = [FIRST_SIGMA_NS * FIRST_SIGMA_NS, 0.0, DRIFT_SIGMA * DRIFT_SIGMA];
        Self { offset_ns: 0.0, drift: 0.0, variance, refused: 0 }
    }
}

impl Filter {
    fn predict(&mut self, step_ns: f64) {
        let seconds = step_ns / NS_PER_S as f64;
        let [offset, mixed, drift] = self.variance;
        self.offset_ns += self.drift * step_ns;
        self.variance = [
            offset
                + step_ns * (2.0 * mixed + step_ns * drift)
                + OFFSET_WANDER_NS * OFFSET_WANDER_NS * seconds,
            mixed + step_ns * drift,
            drift + DRIFT_WANDER * DRIFT_WANDER * seconds,
        ];
    }

    /// Updates the filter with the delay of the fastest arrival of a block. A much longer delay means only a
    /// busy host, unless it persists; a much shorter one is always true.
    fn update(&mut self, late_ns: f64, sigma_ns: f64) {
        let expected_ns = (self.variance[0] + sigma_ns * sigma_ns).sqrt();
        if late_ns.abs() > GATE * expected_ns {
            self.refused += 1;
            if late_ns > 0.0 && self.refused < REJECTED_IN_A_ROW {
                return;
            }
            self.variance[0] += late_ns * late_ns;
        }
        self.refused = 0;
        let [offset, mixed, drift] = self.variance;
        let gain = [offset, mixed].map(|v| v / (offset + sigma_ns * sigma_ns));
        self.offset_ns += gain[0] * late_ns;
        self.drift += gain[1] * late_ns;
        self.variance = [offset * (1.0 - gain[0]), mixed * (1.0 - gain[0]), drift - gain[1] * mixed];
    }
}

/// A series of arrivals, of which the fastest is used.
#[derive(Clone, Debug, Default)]
struct Block {
    arrivals: u32,
    duration_ns: f64,
    fastest_ns: f64,
    sum_ns: f64,
}

impl Block {
    fn add(&mut self, residual_ns: f64, step_ns: f64) {
        self.fastest_ns = if self.arrivals == 0 { residual_ns } else { self.fastest_ns.min(residual_ns) };
        self.arrivals += 1;
        self.sum_ns += residual_ns;
        self.duration_ns += step_ns;
    }

    /// Delay of the fastest arrival and its standard uncertainty, nanoseconds, once the block is complete.
    /// The fastest of n arrivals is delayed by about 1/n of their mean delay, whether the delay is
    /// distributed exponentially or uniformly.
    fn close(&mut self, age_ns: f64) -> Option<(f64, f64)> {
        if self.arrivals < BLOCK_ARRIVALS || self.duration_ns < BLOCK_NS.min(age_ns * BLOCK_PART) {
            return None;
        }
        let n = f64::from(self.arrivals);
        let spread_ns = (self.sum_ns / n - self.fastest_ns) / n;
        let closed = (self.fastest_ns, spread_ns.max(ARRIVAL_SIGMA_NS));
        *self = Self::default();
        Some(closed)
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
        first_tick: u32,
        drift: f64,
        /// Of the fastest arrival.
        fixed_ns: f64,
        random: Pcg64Mcg,
    }

    impl Board {
        fn new(tick_hz: u32) -> Self {
            Self {
                timebase: Timebase::new(tick_hz, 0, None),
                tick_hz,
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
            let tick = self.first_tick.wrapping_add(ticks as u32);
            let late: f64 = Exp1.sample(&mut self.random);
            let arrival = START + (t_s * 1e9 + self.fixed_ns + late * 100e3 + extra_ns) as i64;
            let moment = self.timebase.moment(tick, arrival);
            (moment, (moment.time - START) as f64 - t_s * 1e9)
        }

        /// Runs at `rate_hz` between two times and returns the largest error, nanoseconds.
        fn run(&mut self, rate_hz: f64, from_s: f64, until_s: f64) -> f64 {
            let scans = (from_s * rate_hz) as u64..(until_s * rate_hz) as u64;
            scans.map(|k| self.scan(k as f64 / rate_hz, 0.0).1.abs()).fold(0.0, f64::max)
        }
    }

    #[test]
    fn acquisition_times_are_estimated_despite_jitter_and_drift() {
        let mut board = Board::new(1_000_000);
        assert!(board.run(1000.0, 0.0, 1.0) < 2e6);
        assert!(board.run(1000.0, 1.0, 10.0) < 20e3);
        let worst = board.run(1000.0, 10.0, 60.0);
        assert!(worst < 3e3, "{worst} ns");
        let drift = board.timebase.drift().unwrap();
        assert!((drift - 50e-6).abs() < 0.5e-6, "{drift}");
        let (moment, error) = board.scan(60.0, 0.0);
        assert!(moment.sigma_ns < 3e3 && error.abs() < 5.0 * moment.sigma_ns, "{error} of {moment:?}");
    }

    #[test]
    fn the_first_times_are_late_by_no_more_than_their_arrival() {
        let mut board = Board::new(1_000_000);
        for k in 0..100 {
            let (moment, error) = board.scan(f64::from(k) * 1e-3, 0.0);
            assert!(error < 5.0 * moment.sigma_ns, "{error} of {moment:?}");
        }
    }

    #[test]
    fn a_pause_of_the_host_does_not_shift_the_time() {
        for (rate_hz, hiccup) in [(1000.0, 5), (1000.0, 2000), (10_000.0, 50), (20.0, 3)] {
            let mut board = Board::new(10_000_000);
            board.run(rate_hz, 0.0, 60.0);
            let begin = (60.0 * rate_hz) as u64;
            for k in 0..hiccup {
                let (_, error) = board.scan((begin + k) as f64 / rate_hz, 5e6);
                assert!(error.abs() < 25e3, "{rate_hz} Hz, scan {k} of the hiccup: {error} ns");
            }
            let after = board.run(rate_hz, 60.0 + hiccup as f64 / rate_hz, 62.0 + hiccup as f64 / rate_hz);
            assert!(after < 25e3, "{rate_hz} Hz: {after} ns after the hiccup");
        }
    }

    #[test]
    fn a_longer_delay_is_accepted_after_some_time_and_a_shorter_one_at_once() {
        let mut board = Board::new(1_000_000);
        board.run(1000.0, 0.0, 30.0);
        board.fixed_ns = 3e6;
        assert!(board.run(1000.0, 30.0, 31.0) < 20e3);
        board.run(1000.0, 31.0, 35.0);
        let (_, error) = board.scan(35.0, 0.0);
        assert!((error - 3e6).abs() < 100e3, "{error} ns");
        board.fixed_ns = 0.0;
        board.run(1000.0, 35.001, 35.05);
        assert!(board.run(1000.0, 35.05, 36.0) < 100e3);
    }

    #[test]
    fn ticks_wrap_also_many_times_between_two_scans() {
        let mut board = Board::new(1_000_000_000);
        board.run(1000.0, 0.0, 20.0);
        for t_s in [20.0, 24.9, 60.0, 60.001] {
            let (_, error) = board.scan(t_s, 0.0);
            assert!(error.abs() < 300e3, "{t_s} s: {error} ns");
        }
    }

    #[test]
    fn time_never_goes_back_also_across_restarts() {
        let mut timebase = Timebase::new(1_000_000, 250_000, Some(START + 5_000_000));
        let first = timebase.moment(0, START + 1_000_000);
        assert_eq!(first.time, START + 5_000_001);
        assert!(first.sigma_ns >= 4e6);
        let mut last = first.time;
        for k in 1..100_u32 {
            let late_ns = if k > 20 { 100_000 } else { 1_000_000 };
            let arrival = START + (i64::from(k) * 1_000_000 + late_ns);
            let moment = timebase.moment(k * 1000, arrival);
            assert!(moment.time - last >= 499_999, "{k}: {}", moment.time - last);
            last = moment.time;
        }
        assert!((last - START - (99_000_000 + 100_000 - 250_000)).abs() < 50_000);
    }
}
