//! Boards whose counters are wrong: every time is right within its stated uncertainty, or is flagged.

use std::time::Duration;

use proptest::prelude::*;
use rand::SeedableRng;
use rand_distr::{Distribution, Exp1};
use rand_pcg::Pcg64Mcg;
use trifacet_core::time::{Mono, NS_PER_S};

use super::{MOST_AFTER_NS, ScanCounters, TickFault, Timebase};

const START: Mono = Mono(1_000_000_000_000);
/// A larger uncertainty sets `CLOCK_UNSYNCED` (`trifacet_core::stamp`).
const FLAGGED_NS: f64 = 5e6;

/// A board that declares 1 MHz and answers 1 kHz.
struct Board {
    /// Its sample rate.
    rate_hz: f64,
    /// What it sends as the tick of scan `k`, instead of the right number of ticks.
    tick: Box<dyn Fn(u64, u64) -> u64>,
    /// What it sends as the sequence number of scan `k`.
    sequence: Box<dyn Fn(u64) -> u64>,
    /// Declared width of the tick.
    tick_bits: u32,
}

impl Board {
    fn with_tick(tick: impl Fn(u64, u64) -> u64 + 'static) -> Self {
        Self { rate_hz: 1000.0, tick: Box::new(tick), sequence: Box::new(|k| k), tick_bits: 32 }
    }

    /// The first `scans` scans: what the timebase returns, and its error in nanoseconds.
    fn run(&self, scans: u64) -> Vec<Outcome> {
        let mut random = Pcg64Mcg::seed_from_u64(11);
        let mut timebase = Timebase::new(1_000_000, 1000.0, 0, None).with_tick_bits(self.tick_bits);
        let mut last = None;
        let mut last_arrival = START;
        let scan = |k: u64| {
            let t_s = k as f64 / self.rate_hz;
            let tick = (self.tick)(k, (t_s * 1e6).round() as u64) & (u64::MAX >> (64 - self.tick_bits));
            let sequence = (self.sequence)(k) as u32;
            let periods = last.replace(sequence).map_or(1, |last| sequence.wrapping_sub(last));
            let late: f64 = Exp1.sample(&mut random);
            let arrival = (START + (t_s * 1e9 + late * 100e3) as i64).max(last_arrival);
            last_arrival = arrival;
            let moment = timebase.moment(ScanCounters { tick, periods }, arrival);
            assert!(moment.time <= arrival + MOST_AFTER_NS, "scan {k} is in the future");
            Outcome { k, error_ns: (moment.time - START) as f64 - t_s * 1e9, moment }
        };
        (0..scans).map(scan).collect()
    }
}

#[derive(Debug)]
struct Outcome {
    k: u64,
    error_ns: f64,
    moment: super::Moment,
}

impl Outcome {
    fn flagged(&self) -> bool {
        self.moment.sigma_ns > FLAGGED_NS
    }
}

/// No time is wrong by more than five stated uncertainties and the mean delay of the line.
fn assert_honest(outcomes: &[Outcome]) {
    for outcome in outcomes {
        let allowed = 5.0 * outcome.moment.sigma_ns + 100e3;
        assert!(outcome.error_ns.abs() <= allowed, "{outcome:?}");
    }
}

fn faults(outcomes: &[Outcome]) -> Vec<(u64, TickFault)> {
    outcomes.iter().filter_map(|o| o.moment.fault.map(|fault| (o.k, fault))).collect()
}

#[test]
fn a_single_wrong_tick_costs_nothing() {
    for wrong in [-1500_i64, -65_536, 65_536, 1_000_000_000, 700] {
        let outcomes = Board::with_tick(
            move |k, ticks| {
                if k == 2500 { ticks.wrapping_add_signed(wrong) } else { ticks }
            },
        )
        .run(5000);
        assert_honest(&outcomes);
        assert!(!outcomes.iter().any(Outcome::flagged));
        let found = faults(&outcomes);
        assert_eq!(found.iter().map(|(k, _)| *k).collect::<Vec<_>>(), [2500], "{wrong}: {found:?}");
    }
}

#[test]
fn a_tick_of_another_rate_is_flagged_and_named_and_the_sequence_gives_the_time() {
    type Tick = fn(u64, u64) -> u64;
    let cases: [(&str, Tick); 5] = [
        ("ten times too fast", |_, ticks| ticks * 10),
        ("a thousand times too slow", |_, ticks| ticks / 1000),
        ("a third too slow", |_, ticks| ticks * 2 / 3),
        ("at rest", |_, _| 77),
        ("random", |k, _| k.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 13),
    ];
    for (name, tick) in cases {
        let outcomes = Board::with_tick(tick).run(5000);
        assert_honest(&outcomes);
        let late = outcomes.iter().skip(3).filter(|o| !o.flagged()).count();
        assert_eq!(late, 0, "{name}: {late} times are believed");
        assert!(outcomes.iter().all(|o| o.error_ns.abs() < 20e6), "{name}");
        let rate = faults(&outcomes).into_iter().find(|(_, f)| matches!(f, TickFault::Rate { .. }));
        assert!(rate.is_some_and(|(k, _)| k < 1200), "{name}: {rate:?}");
    }
}

#[test]
fn a_narrow_tick_is_named_and_the_time_stays_right() {
    let outcomes = Board::with_tick(|_, ticks| ticks & 0xffff).run(5000);
    assert_honest(&outcomes);
    let found = faults(&outcomes);
    assert!(
        found.len() > 70 && found.iter().all(|(_, f)| *f == TickFault::Narrow { bits: 16, declared: 32 }),
        "{found:?}"
    );
    assert!(outcomes.iter().skip(1000).all(|o| o.error_ns.abs() < 50e3));
}

#[test]
fn a_tick_of_64_bits_that_wraps_at_32_is_named() {
    let begin = u64::from(u32::MAX) - 2_500_000;
    let wraps = move |_, ticks: u64| (ticks + begin) & u64::from(u32::MAX);
    let outcomes = Board { tick_bits: 64, ..Board::with_tick(wraps) }.run(5000);
    assert_honest(&outcomes);
    let found = faults(&outcomes);
    assert_eq!(
        found.iter().map(|(_, f)| *f).collect::<Vec<_>>(),
        [TickFault::Narrow { bits: 32, declared: 64 }]
    );
    let healthy = Board { tick_bits: 64, ..Board::with_tick(move |_, ticks| ticks + begin) }.run(5000);
    assert!(faults(&healthy).is_empty() && healthy.iter().skip(1000).all(|o| o.error_ns.abs() < 50e3));
}

#[test]
fn a_clock_that_jumps_goes_on_after_one_scan() {
    for jump in [5_000_000_u64, 0xffff_0000] {
        let outcomes =
            Board::with_tick(move |k, ticks| if k >= 2500 { ticks.wrapping_add(jump) } else { ticks })
                .run(5000);
        assert_honest(&outcomes);
        assert_eq!(faults(&outcomes).len(), 1);
        assert!(!outcomes.iter().any(Outcome::flagged));
    }
}

#[test]
fn another_sample_rate_than_answered_is_named_and_the_tick_gives_the_time() {
    for rate_hz in [100.0, 800.0, 1300.0] {
        let board = Board { rate_hz, ..Board::with_tick(|_, ticks| ticks) };
        let outcomes = board.run((4.0 * rate_hz) as u64);
        assert_honest(&outcomes);
        let last = outcomes.last().unwrap();
        assert!(!last.flagged() && last.error_ns.abs() < 100e3, "{rate_hz} Hz: {last:?}");
        let named = faults(&outcomes).into_iter().find_map(|(_, fault)| match fault {
            TickFault::SampleRate { measured_hz, .. } => Some(measured_hz),
            _ => None,
        });
        // A rate that is nearly right agrees with the sequence from scan to scan.
        let measured_hz = named.unwrap_or(1000.0);
        assert!((measured_hz / rate_hz - 1.0).abs() < 0.35, "{rate_hz} Hz: {measured_hz} Hz");
    }
}

#[test]
fn irregular_sampling_is_named_and_the_tick_gives_the_time() {
    // Every second scan is 0.7 ms late, and its tick says so: the harness states times without this delay.
    let outcomes = Board::with_tick(|k, ticks| ticks + 700 * (k % 2)).run(5000);
    assert!(faults(&outcomes).iter().any(|(_, fault)| *fault == TickFault::Irregular));
    let last = outcomes.last().unwrap();
    assert!(!last.flagged() && last.error_ns.abs() < 1e6, "{last:?}");
}

#[test]
fn an_oscillator_of_one_percent_is_followed_and_named() {
    for drift in [0.01, -0.01] {
        let outcomes =
            Board::with_tick(move |_, ticks| (ticks as f64 * (1.0 + drift)).round() as u64).run(20_000);
        // Until the first block that disagrees is complete, nothing shows such a drift.
        for outcome in &outcomes {
            let unseen_ns = drift.abs() * (outcome.k as f64 * 1e6).clamp(32e6, 250e6);
            let allowed = 5.0 * outcome.moment.sigma_ns + unseen_ns + 100e3;
            assert!(outcome.error_ns.abs() <= allowed, "{outcome:?}");
        }
        let named = faults(&outcomes).into_iter().find_map(|(k, fault)| match fault {
            TickFault::Rate { measured_hz, .. } => Some((k, measured_hz)),
            _ => None,
        });
        let (k, measured_hz) = named.unwrap();
        assert!(k < 10_000 && (measured_hz / 1e6 - 1.0 - drift).abs() < 0.002, "{k}: {measured_hz}");
        assert!(outcomes.iter().skip(10_000).all(|o| o.error_ns.abs() < 1e6 && !o.flagged()));
    }
}

#[test]
fn a_wrong_sequence_number_does_not_move_the_time() {
    for jump in [1000_u64, 100_000, 0x7000_0000] {
        let board = Board {
            sequence: Box::new(move |k| if k >= 2500 { k + jump } else { k }),
            ..Board::with_tick(|_, ticks| ticks)
        };
        let outcomes = board.run(5000);
        assert!(outcomes.iter().all(|o| o.error_ns.abs() < 5e6 || o.flagged()), "{jump}");
        assert!(outcomes.last().unwrap().error_ns.abs() < 1e6, "{jump}: {:?}", outcomes.last());
        assert_eq!(faults(&outcomes).len(), 1, "{jump}");
    }
}

/// When the scans of a healthy board arrive at a host that pauses again and again in the first two seconds: in bursts.
fn arrivals_with_pauses(seed: u64) -> Vec<Mono> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let (mut pause_s, mut last) = (0.0..0.0, START);
    let arrival = |k: u64| {
        let t_s = k as f64 * 1e-3;
        if t_s >= pause_s.end && t_s < 2.0 {
            let [until, length]: [f64; 2] = std::array::from_fn(|_| Exp1.sample(&mut random));
            let begin_s = t_s + 0.03 * until;
            pause_s = begin_s..begin_s + (0.15 * length).min(0.45);
        }
        let late: f64 = Exp1.sample(&mut random);
        let held_s = if pause_s.contains(&t_s) { pause_s.end } else { t_s };
        last = last.max(START + (held_s * 1e9 + late * 100e3) as i64);
        last
    };
    (0..5000).map(arrival).collect()
}

#[test]
fn pauses_of_the_host_do_not_accuse_the_clock_of_the_board() {
    for seed in 0..1000 {
        let mut timebase = Timebase::new(1_000_000, 1000.0, 0, None);
        for (k, arrival) in (0..).zip(arrivals_with_pauses(seed)) {
            let moment = timebase.moment(ScanCounters { tick: 1000 * k, periods: 1 }, arrival);
            let error_ns = (moment.time - START) as f64 - k as f64 * 1e6;
            // Nothing shows how late the first arrival of a burst was: 30 ms are the mean time between pauses.
            let honest = error_ns.abs() < 5.0 * moment.sigma_ns + 30e6;
            let outcome = Outcome { k, error_ns, moment };
            assert!(honest && outcome.moment.fault.is_none(), "seed {seed}: {outcome:?}");
        }
    }
}

#[test]
fn a_host_that_slept_begins_again() {
    let mut timebase = Timebase::new(1_000_000, 1000.0, 0, None);
    let mut take = |k: u64, slept: u64| {
        let device_ms = k + slept;
        let arrival = START + (k * 1_000_000) as i64;
        let periods = if k == 2000 && slept > 0 { 1 + slept as u32 } else { 1 };
        let moment = timebase.moment(ScanCounters { tick: device_ms * 1000, periods }, arrival);
        ((moment.time - arrival).abs(), moment.fault)
    };
    for k in 0..2000 {
        take(k, 0);
    }
    let (error_ns, fault) = take(2000, 3_600_000);
    assert!(error_ns < 2_000_000 && matches!(fault, Some(TickFault::Ahead { ns }) if ns > 3599 * NS_PER_S));
    for k in 2001..4000 {
        let (error_ns, fault) = take(k, 3_600_000);
        assert!(error_ns < 2_000_000 && fault.is_none());
    }
}

proptest! {
    /// Whatever a board sends, times are in order, and not after their arrival by more than what order needs.
    #[test]
    fn no_counters_make_a_time_that_the_arrival_excludes(
        scans in prop::collection::vec((any::<u64>(), prop_oneof![1_u32..4, any::<u32>()], 0_i64..50_000_000), 1..200),
        tick_hz in 10_000_u32..=1_000_000_000, rate_hz in 1.0_f64..20_000.0, wide: bool,
    ) {
        let mut timebase = Timebase::new(tick_hz, rate_hz, 0, None).with_tick_bits(if wide { 64 } else { 32 });
        let (mut arrival, mut last, mut count) = (START, Mono(0), 0);
        for (tick, periods, pause_ns) in scans {
            arrival = arrival + pause_ns;
            let tick = if wide { tick } else { tick >> 32 };
            let moment = timebase.moment(ScanCounters { tick, periods }, arrival);
            prop_assert!(moment.time <= arrival + MOST_AFTER_NS + count && moment.time > last);
            prop_assert!(moment.sigma_ns.is_finite());
            count += 1;
            last = moment.time;
        }
    }
}

/// As through a converter that delivers blocks, or a network that pauses: no scan comes alone.
#[test]
fn scans_in_blocks_have_their_times_or_are_flagged_from_the_first_one_on() {
    for block in [10_u64, 100] {
        let mut timebase =
            Timebase::new(1_000_000, 1000.0, 0, None).with_bursts(Duration::from_millis(250)).started(START);
        let mut flagged = 0;
        for k in 0..5000 {
            // The last scan of each block arrives when it is taken.
            let arrival = START + ((k / block + 1) * block - 1) as i64 * 1_000_000;
            let moment = timebase.moment(ScanCounters { tick: k * 1000, periods: 1 }, arrival);
            let error_ns = (moment.time - START) as f64 - k as f64 * 1e6;
            assert!(error_ns.abs() <= 5.0 * moment.sigma_ns, "{block}, {k}: {error_ns} ns, {moment:?}");
            assert!(moment.fault.is_none(), "{block}, {k}: {moment:?}");
            flagged += u64::from(moment.sigma_ns > FLAGGED_NS);
            let settled = k < 1000 || error_ns.abs() < 1e5 && moment.sigma_ns < 1e6;
            assert!(settled, "{block}, {k}: {error_ns} ns, {moment:?}");
        }
        assert!(flagged < 300, "{block}: {flagged} scans are flagged");
    }
}
