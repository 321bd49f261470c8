//! A year of a daemon on a board, in pure code: what grows, wraps, drifts or steps in this time.
//!
//! A year at 1 kHz has 3.15e10 scans. Each day a stretch of scans is computed; for the rest of the day the cable is out,
//! and only the time passes, for daemon and board. In each stretch the tick of the board wraps, the settings are
//! reloaded, the clock of the board drifts by up to 30 ppm, and there may be a fault. On single days the counters are
//! near their ends, or the system clock steps.
//!
//! The short form computes a tenth of the days and 4 s of each of them. The whole, with so many scans of each day:
//! `YEAR_SCANS=500000 cargo test --release --test numeric year -- --ignored --nocapture`; docs/soak.md has its result.

mod machine;

use machine::{Machine, PERIOD_NS, TICKS};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use trifacet::config::{Axis, Config, FaultKind, Motion, MotionKind, parse};
use trifacet::core::estimation::PoseReport;
use trifacet::core::stamp::Stamp;
use trifacet::core::time::{Mono, NS_PER_S};
use trifacet::core::utc::SlewedOffset;
use trifacet_wire::{LockState, PoseFrame, Status};

const DAY_NS: f64 = 86_400e9;
/// UTC at the start of the year, minus the monotonic clock.
const EPOCH_NS: i64 = 1_800_000_000 * NS_PER_S;
/// The largest error, in stated standard uncertainties.
const MOST: f64 = 7.0;
/// A time in a frame agrees with the system clock within this, besides its stated uncertainty.
const SYNCED_NS: f64 = 1e6;

/// UTC of the daemon, and the system clock that it follows.
struct SystemClock {
    followed: SlewedOffset,
    offset_ns: i64,
    due: Mono,
    /// The clock has stepped since the last reading, which the daemon cannot know.
    unseen: bool,
}

impl SystemClock {
    fn new(now: Mono) -> Self {
        let followed = SlewedOffset::new((now, now.0 + EPOCH_NS));
        Self { followed, offset_ns: EPOCH_NS, due: now, unseen: false }
    }

    fn step(&mut self, ns: i64) {
        self.offset_ns += ns;
        self.unseen = true;
    }

    fn tick(&mut self, now: Mono) {
        if now >= self.due {
            self.due = now + NS_PER_S;
            self.followed.update((now, now.0 + self.offset_ns));
            self.unseen = false;
        }
    }
}

/// What was found.
#[derive(Clone, Copy, Debug, Default)]
struct Found {
    computed: u64,
    usable: u64,
    pose_sigmas: f64,
    time_ns: f64,
}

struct Year {
    machine: Machine,
    clock: SystemClock,
    random: Pcg64,
    found: Found,
    frames: u64,
}

impl Year {
    fn new() -> Self {
        let machine = Machine::new(config());
        let clock = SystemClock::new(machine.now());
        Self { machine, clock, random: Pcg64::seed_from_u64(1), found: Found::default(), frames: 0 }
    }

    /// A stretch of `scans`, of which the first half may have a fault.
    fn stretch(&mut self, day: u64, scans: u64) {
        let fault_s = scans as f64 * 1e-3 * 0.4 * self.random.random::<f64>();
        let kind = match self.random.random_range(0..8) {
            0 => Some(FaultKind::BeamBlocked),
            1 => Some(FaultKind::PsdDark { psd: self.random.random_range(0..3) }),
            2 => Some(FaultKind::Corrupted { fraction: 0.02 }),
            3 => Some(FaultKind::Dropped { fraction: 0.02 }),
            4 => Some(FaultKind::SteeringStuck),
            _ => None,
        };
        if let Some(kind) = kind {
            self.machine.inject(kind, fault_s.min(20.0));
        }
        for scan in 0..scans {
            let part = scan as f64 / scans as f64;
            self.machine.drift = 30e-6 * (std::f64::consts::TAU * part).sin();
            self.events(day, scan, scans);
            self.clock.tick(self.machine.now());
            let (truth, report) = self.machine.step();
            self.found.computed += 1;
            if let Some(report) = report {
                self.check(&report, &truth);
            }
        }
        assert_eq!(self.machine.centering.state().lock, LockState::Locked, "day {day}, {kind:?}");
        self.counted(day);
    }

    /// Reloads, and steps of the system clock.
    fn events(&mut self, day: u64, scan: u64, scans: u64) {
        match scan * 100 / scans {
            55 if scan * 100 % scans < 100 => {
                self.machine.reload(|config| config.frames.tool.translation_mm = [0.0, 0.0, -40.0]);
            }
            60 if scan * 100 % scans < 100 => {
                self.machine.reload(|config| config.frames.tool.translation_mm = [0.0; 3]);
            }
            70 if scan * 100 % scans < 100 => self.clock.step(match day {
                60 => 3600 * NS_PER_S,
                70 => -3600 * NS_PER_S,
                180 => -NS_PER_S, // a leap second
                day if day % 20 == 0 => 30_000_000,
                day if day % 20 == 10 => -30_000_000,
                _ => 0,
            }),
            _ => {}
        }
    }

    fn check(&mut self, report: &PoseReport, truth: &machine::Truth) {
        let time_ns = self.clock.followed.utc_ns(report.time);
        let synced = self.clock.followed.synced();
        let (session, config, sequence) = (1, report.config, self.frames);
        let stamp = Stamp { session, config, sequence, time_ns, synced, sent: self.machine.now() };
        self.frames += 1;
        let frame = PoseFrame::decode(&report.frame(stamp).encode()).unwrap();
        if !frame.status.usable(Status::SIMULATED) {
            return;
        }
        self.found.usable += 1;
        let errors = frame.pose.into_iter().zip(truth.pose.to_array());
        let sigmas =
            errors.zip(frame.deviations).map(|((x, true_x), sigma)| (x - true_x).abs() / f64::from(sigma));
        let worst = sigmas.fold(0.0, f64::max);
        assert!(worst <= MOST, "{worst} sigma: {frame:?}, {:?}", truth.pose);
        self.found.pose_sigmas = self.found.pose_sigmas.max(worst);
        if !self.clock.unseen {
            let error_ns = (time_ns - self.clock.offset_ns) as f64 - truth.time_ns;
            let sigma_ns = report.time_sigma_ns.expect("the board has a clock").max(1.0);
            let beyond = (error_ns.abs() - SYNCED_NS).max(0.0) / sigma_ns;
            assert!(beyond <= MOST, "{error_ns} ns, sigma {sigma_ns} ns: {frame:?}");
            self.found.time_ns = self.found.time_ns.max(error_ns.abs());
        }
    }

    /// The counters show what was sent.
    fn counted(&self, day: u64) {
        let (counters, tally) = (&self.machine.counters, self.machine.tally);
        assert_eq!(counters.frames_corrupted.get(), tally.corrupted, "day {day}");
        assert_eq!(counters.clock_faults.get(), 0, "day {day}");
        let silent = [&counters.scans_repeated, &counters.scans_late, &counters.frames_unknown];
        assert!(silent.iter().all(|counter| counter.get() == 0), "day {day}: {counters:?}");
    }

    /// The cable is out until the stretch of this day.
    fn night(&mut self, until_ns: f64) {
        let report = self.machine.unplug(until_ns - self.machine.time_ns);
        assert!(report.pose.is_none() && report.status.has(Status::SOURCE_DOWN), "{report:?}");
        self.clock.tick(self.machine.now());
        self.machine.plug_in();
    }
}

fn config() -> Config {
    let mut config = parse("acquisition.rate_hz = 1000\n[twin]\nmotion = []\n", None).unwrap();
    let motion = |axis: Axis, amount: f64, hz: f64| Motion {
        axis,
        kind: MotionKind::Sine,
        amount_um: Some(amount).filter(|_| !axis.is_turn()),
        amount_urad: Some(amount).filter(|_| axis.is_turn()),
        frequency_hz: Some(hz),
        from_s: 0.0,
        until_s: None,
        high_hz: None,
        phase_deg: 0.0,
    };
    config.twin.motion = vec![
        motion(Axis::Tx, 30.0, 0.31),
        motion(Axis::Ty, 20.0, 0.17),
        motion(Axis::Tz, 20.0, 0.07),
        motion(Axis::Roll, 60.0, 0.23),
        motion(Axis::Yaw, 60.0, 0.11),
    ];
    config
}

/// Resident memory, bytes.
fn resident() -> u64 {
    let pages = std::fs::read_to_string("/proc/self/statm").unwrap();
    pages.split(' ').nth(1).unwrap().parse::<u64>().unwrap() * 4096
}

/// A year in which every `every`-th day has a stretch of `scans`.
fn year(every: u64, scans: u64) {
    let mut year = Year::new();
    year.machine.plug_in();
    let mut early = None;
    for day in (0..=365).step_by(every as usize) {
        let begin_ns = day as f64 * DAY_NS;
        let half_ns = scans as f64 / 2.0 * PERIOD_NS;
        // On day 104 the monotonic clock passes 2^53 ns, the end of the integers of a double.
        let passes = 2_f64.powi(53) - begin_ns;
        let at_ns =
            if (0.0..every as f64 * DAY_NS).contains(&passes) { 2_f64.powi(53) - half_ns } else { begin_ns };
        if day > 0 {
            year.night(at_ns);
        }
        // The tick wraps in the middle of every stretch.
        year.machine.tick = (1 << 32) - scans / 2 * TICKS;
        // The index passes 2^53, and on the last day it comes near the end of its range.
        let last = day + every > 365;
        year.machine.next_index =
            (day == 200).then_some((1 << 53) - scans / 2).or(last.then_some(u64::MAX - 2 * scans));
        year.stretch(day, scans);
        if day >= 30 && early.is_none() {
            early = Some(resident());
        }
    }
    let growth = resident() as f64 - early.expect("more than 30 days") as f64;
    let Found { computed, usable, pose_sigmas, time_ns } = year.found;
    println!(
        "a year: {computed} scans computed of 3.15e10, {usable} usable frames; at worst a pose is wrong by \
         {pose_sigmas:.1} sigma and a time by {:.2} ms; memory grew by {:.0} kB",
        time_ns / 1e6,
        growth / 1e3
    );
    assert!(usable > computed / 2);
    assert!(growth < 4e6, "memory grew by {growth} bytes");
}

#[test]
fn short() {
    year(10, 4000);
}

#[test]
#[ignore = "a command: takes an hour"]
fn whole() {
    year(1, std::env::var("YEAR_SCANS").map_or(500_000, |text| text.parse().unwrap()));
}

/// The sequence numbers of the board pass the end of their 32 bits, without a restart.
#[test]
fn sequence_numbers_wrap() {
    let mut year = Year::new();
    year.machine.plug_in();
    year.stretch(0, 3000);
    let counted = year.machine.counters.scans_lost.get();
    let mut lost = 0;
    // Twice almost half of the range is not sent: 50 days in which the daemon is stopped and the board runs on.
    for to in [(1_u64 << 31) - 10, (1 << 32) - 1500] {
        let skipped = to - year.machine.sequence.unwrap();
        lost += skipped;
        year.machine.sequence = Some(to);
        year.machine.time_ns += skipped as f64 * PERIOD_NS;
        year.clock.due = year.machine.now();
        let (truth, report) = year.machine.step();
        year.clock.tick(year.machine.now());
        if let Some(report) = report {
            year.check(&report, &truth);
        }
    }
    year.stretch(1, 6000);
    assert!(year.machine.sequence.unwrap() > 1 << 32);
    assert_eq!(year.machine.counters.scans_lost.get() - counted - year.machine.tally.lost, lost);
}
