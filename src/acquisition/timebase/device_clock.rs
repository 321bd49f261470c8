//! The time between two scans by the counters of the board.
//!
//! A scan carries two counters: the tick of the board's clock and its sequence number. They must agree: a
//! scan comes every `tick_hz / rate` ticks. While they agree, the tick gives the time, because it is finer.
//! Where they disagree, the arrival of the scan excludes what is impossible, and what lasts is decided by the
//! arrivals of a second.

use std::fmt;

use trifacet_core::time::{Mono, NS_PER_S};

/// Ticks and sequence agree within this part of a period ...
const PART_OF_PERIOD: f64 = 0.5;
/// ... and within this part of the time between the two scans, or since the trial began.
const PART_OF_TIME: f64 = 1e-3;
/// The arrivals of at least this time decide which counter is right, nanoseconds ...
const TRIAL_NS: i64 = NS_PER_S;
/// ... and of at least this many scans.
const TRIAL_SCANS: u32 = 16;
/// A trial with fewer disagreements than this part of its scans finds single errors, not a wrong clock.
const FEW: f64 = 0.1;
/// After this many agreements, a single disagreement is an error of the tick; after a series of disagreements,
/// this many agreements are needed.
const CONFIRMED: u32 = 10;
/// Two sample rates are the same within this part.
const SAME_RATE: f64 = 0.01;
/// In a trial, a counter is right if it agrees with the clock of the host to this part.
const RIGHT: f64 = 0.05;

/// A disagreement of the board's tick with its sequence numbers or with the clock of the host.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TickFault {
    /// The tick is the same as that of the scan before.
    Still,
    /// The tick is earlier than that of the scan before.
    Back {
        /// By this many ticks.
        ticks: u64,
    },
    /// The tick advanced by another amount than the sequence numbers require.
    Jump {
        /// By this many ticks.
        ticks: u64,
        /// Required number.
        expected: f64,
    },
    /// The tick starts again at 2^bits, below its declared width.
    Narrow {
        /// Width of the counter.
        bits: u32,
        /// Declared width: 32 or 64.
        declared: u32,
    },
    /// The tick runs at another rate than the board declares.
    Rate {
        /// Measured by the clock of the host, Hz.
        measured_hz: f64,
        /// As declared, Hz.
        declared_hz: f64,
    },
    /// The board samples at the right rate on average, but irregularly; its tick is right.
    Irregular,
    /// The board's clock has gained time that did not pass on the host: it jumped, or the host slept.
    Ahead {
        /// The time that it gained, nanoseconds.
        ns: i64,
    },
    /// The board samples at another rate than it answered to START; its tick is right.
    SampleRate {
        /// Measured by the clock of the host, Hz.
        measured_hz: f64,
        /// As answered, Hz.
        answered_hz: f64,
    },
}

impl fmt::Display for TickFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Still => write!(f, "the tick stands still"),
            Self::Back { ticks } => write!(f, "the tick went back by {ticks}"),
            Self::Jump { ticks, expected } => {
                write!(f, "the tick advanced by {ticks}; the sequence numbers require {expected:.0}")
            }
            Self::Narrow { bits, declared } => {
                write!(f, "the tick starts again at 2^{bits}; the protocol requires 2^{declared}")
            }
            Self::Rate { measured_hz, declared_hz } => {
                write!(f, "the tick runs at {measured_hz:.4e} Hz; the board declares {declared_hz:.4e} Hz")
            }
            Self::Irregular => write!(f, "the board samples irregularly: a scan differs by half a period"),
            Self::Ahead { ns } => {
                write!(
                    f,
                    "the clock of the board has gained {:.3} s on the clock of the host",
                    *ns as f64 * 1e-9
                )
            }
            Self::SampleRate { measured_hz, answered_hz } => {
                write!(f, "the board samples at {measured_hz:.5} Hz; it answered {answered_hz:.5} Hz")
            }
        }
    }
}

/// The counters of a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanCounters {
    /// The tick of the board's clock.
    pub tick: u64,
    /// Number of periods since the previous scan that arrived; at least 1.
    pub periods: u32,
}

/// The time since the previous scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Step {
    /// Nanoseconds of the board's clock.
    pub ns: f64,
    /// Standard uncertainty that the counters leave, nanoseconds; `None` if nothing confirms the time.
    pub sigma_ns: Option<f64>,
    /// Where the counters disagree.
    pub fault: Option<TickFault>,
    /// A trial has decided which counter to trust: earlier times were not those of this counter.
    pub decided: bool,
}

/// Which counter gives the time of a scan whose counters disagree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Trust {
    /// The one that the arrival does not exclude.
    Arrival,
    /// The tick: a trial found that the board samples at another rate, or irregularly.
    Tick,
    /// The sequence: a trial found the tick to be wrong.
    Sequence,
}

/// The clock of the board.
#[derive(Clone, Debug)]
pub(super) struct DeviceClock {
    tick_ns: f64,
    /// The largest tick; the next one is 0.
    largest: u64,
    answered_ns: f64,
    /// Time from scan to scan, nanoseconds: as answered, or as measured.
    period_ns: f64,
    /// Arrival of the previous scan.
    arrived: Mono,
    /// Tick of the previous scan.
    last: u64,
    /// What the tick of the previous scan would have been without its fault.
    expected: u64,
    trust: Trust,
    /// Time from scan to scan by the tick, nanoseconds, if the last trial found the tick to be right.
    candidate: Option<f64>,
    /// Agreements since the last disagreement.
    agreements: u32,
    /// Number of agreements that are needed until the counters vouch for the time again.
    suspect: u32,
    trial: Trial,
}

/// Scans since the begin of a trial.
#[derive(Clone, Copy, Debug)]
struct Trial {
    began: Mono,
    scans: u32,
    faults: u32,
    periods: u64,
    /// Sum of the steps of the tick, nanoseconds.
    tick_ns: f64,
    /// Sum of the steps of the sequence, nanoseconds.
    sequence_ns: f64,
    /// By how much the accepted steps of the tick exceed those of the sequence, nanoseconds.
    ahead_ns: f64,
}

impl Trial {
    fn new(began: Mono) -> Self {
        Self { began, scans: 0, faults: 0, periods: 0, tick_ns: 0.0, sequence_ns: 0.0, ahead_ns: 0.0 }
    }
}

impl DeviceClock {
    /// A clock of `tick_hz` with a tick of `tick_bits` on a board that samples at `rate_hz`, at its first scan.
    pub fn new(tick_hz: u32, tick_bits: u32, rate_hz: f64, tick: u64, arrival: Mono) -> Self {
        let period_ns = NS_PER_S as f64 / rate_hz;
        Self {
            tick_ns: NS_PER_S as f64 / f64::from(tick_hz),
            largest: u64::MAX >> (64 - tick_bits),
            answered_ns: period_ns,
            period_ns,
            arrived: arrival,
            last: tick,
            expected: tick,
            trust: Trust::Arrival,
            candidate: None,
            agreements: 0,
            suspect: 0,
            trial: Trial::new(arrival),
        }
    }

    /// Resolution of the tick, nanoseconds.
    pub fn tick_ns(&self) -> f64 {
        self.tick_ns
    }

    /// The time since the previous scan. `possible` says whether a step in nanoseconds is compatible with the
    /// arrival.
    pub fn step(&mut self, counters: ScanCounters, arrival: Mono, possible: impl Fn(f64) -> bool) -> Step {
        let sequence_ns = f64::from(counters.periods) * self.period_ns;
        let by_last = self.unwrap(self.since(counters.tick, self.last), sequence_ns);
        let by_expected = self.unwrap(self.since(counters.tick, self.expected), sequence_ns);
        // After a single wrong tick the expected one continues; after a jump of the clock, the last one.
        let agreeing = [by_expected, by_last].into_iter().find(|ns| self.agrees(*ns, sequence_ns));
        let fault = agreeing.is_none().then(|| self.name(counters.tick, sequence_ns));
        self.judge(fault.is_some());
        let verdict = self.try_out(counters, by_last, fault.is_some(), arrival);
        let ns = match agreeing {
            Some(ns) if self.trust != Trust::Sequence => ns,
            Some(_) => sequence_ns,
            None => {
                let tick_first = self.trust == Trust::Tick;
                let counters = if tick_first { [by_last, sequence_ns] } else { [sequence_ns, by_last] };
                // Where neither counter is possible, only the clock of the host is left.
                let elapsed_ns = (arrival - self.arrived) as f64;
                counters.into_iter().find(|ns| possible(*ns)).unwrap_or(elapsed_ns)
            }
        };
        self.arrived = arrival;
        self.trial.sequence_ns += sequence_ns;
        self.trial.ahead_ns += agreeing.map_or(0.0, |ns| ns - sequence_ns);
        self.expected = match agreeing {
            Some(_) => counters.tick,
            None => self.expected.wrapping_add_signed((ns / self.tick_ns).round() as i64) & self.largest,
        };
        self.last = counters.tick;
        Step {
            ns,
            sigma_ns: self.sigma_ns(fault.is_some(), sequence_ns),
            fault: verdict.or(fault),
            decided: verdict.is_some(),
        }
    }

    /// Ticks from one tick to another.
    fn since(&self, tick: u64, before: u64) -> u64 {
        tick.wrapping_sub(before) & self.largest
    }

    /// Nanoseconds of a step in ticks. The tick gives it modulo the range of the counter; the sequence gives
    /// the number of wraps.
    fn unwrap(&self, ticks: u64, sequence_ns: f64) -> f64 {
        let turn_ns = (self.largest as f64 + 1.0) * self.tick_ns;
        let step_ns = ticks as f64 * self.tick_ns;
        step_ns + ((sequence_ns - step_ns) / turn_ns).round().max(0.0) * turn_ns
    }

    fn tolerance_ns(&self, sequence_ns: f64) -> f64 {
        (PART_OF_PERIOD * self.period_ns).max(PART_OF_TIME * sequence_ns) + 2.0 * self.tick_ns
    }

    /// Whether the step agrees with the sequence, and so do all accepted steps of the trial together: a small
    /// difference that repeats is a wrong rate.
    fn agrees(&self, ns: f64, sequence_ns: f64) -> bool {
        let (ahead_ns, trial) = (ns - sequence_ns, &self.trial);
        ahead_ns.abs() <= self.tolerance_ns(sequence_ns)
            && (trial.ahead_ns + ahead_ns).abs() <= self.tolerance_ns(trial.sequence_ns + sequence_ns)
    }

    /// What is wrong with a tick that disagrees.
    fn name(&self, tick: u64, sequence_ns: f64) -> TickFault {
        let step = self.since(tick, self.last);
        let narrow = [8, 16, 24, 32].into_iter().find(|bits| {
            let turn = 1_u64 << bits;
            let within = (step.wrapping_add(turn) & self.largest) as f64 * self.tick_ns;
            turn <= self.largest && tick < turn && self.last < turn && self.agrees(within, sequence_ns)
        });
        match narrow {
            Some(bits) => TickFault::Narrow { bits, declared: self.largest.count_ones() },
            None if step == 0 => TickFault::Still,
            None if step > self.largest / 2 => TickFault::Back { ticks: step.wrapping_neg() & self.largest },
            None => TickFault::Jump { ticks: step, expected: sequence_ns / self.tick_ns },
        }
    }

    /// After many agreements, a single disagreement is an error of the tick. Otherwise neither counter is
    /// reliable until they have agreed for some time.
    fn judge(&mut self, disagrees: bool) {
        if !disagrees {
            self.agreements = self.agreements.saturating_add(1);
            self.suspect = self.suspect.saturating_sub(1);
            return;
        }
        let single = self.agreements >= CONFIRMED && self.suspect == 0;
        if !single {
            self.suspect = CONFIRMED;
        }
        self.agreements = 0;
    }

    /// Counts the scan in the present trial, and ends the trial when it is long enough. Returns what a trial
    /// found.
    fn try_out(
        &mut self,
        counters: ScanCounters,
        by_last: f64,
        disagrees: bool,
        arrival: Mono,
    ) -> Option<TickFault> {
        let trial = &mut self.trial;
        trial.scans += 1;
        trial.faults += u32::from(disagrees);
        trial.periods += u64::from(counters.periods);
        trial.tick_ns += by_last;
        if trial.scans < TRIAL_SCANS || arrival - trial.began < TRIAL_NS {
            return None;
        }
        let trial = std::mem::replace(trial, Trial::new(arrival));
        if f64::from(trial.faults) < FEW * f64::from(trial.scans) {
            self.candidate = None;
            if self.trust == Trust::Sequence {
                self.trust = Trust::Arrival;
            }
            return None;
        }
        self.decide(&trial, (arrival - trial.began) as f64)
    }

    /// Decides a trial of `elapsed_ns` by the clock of the host, in which the counters disagreed.
    /// One that finds the tick to be right needs a second one: the arrivals of a busy host are unreliable, and the
    /// times are flagged until then.
    fn decide(&mut self, trial: &Trial, elapsed_ns: f64) -> Option<TickFault> {
        let is_right = |ns: f64| (ns / elapsed_ns - 1.0).abs() < RIGHT;
        let measured_ns = elapsed_ns / trial.periods as f64;
        let by_tick = Some(trial.tick_ns / trial.periods as f64).filter(|_| is_right(trial.tick_ns));
        let before = std::mem::replace(&mut self.candidate, by_tick);
        if let Some(period_ns) = by_tick {
            before.filter(|before| (period_ns / before - 1.0).abs() < RIGHT)?;
            self.trust = Trust::Tick;
            self.period_ns = period_ns;
            let [measured_hz, answered_hz] =
                [self.period_ns, self.answered_ns].map(|period_ns| NS_PER_S as f64 / period_ns);
            let irregular = (measured_hz / answered_hz - 1.0).abs() < SAME_RATE;
            return Some(if irregular {
                TickFault::Irregular
            } else {
                TickFault::SampleRate { measured_hz, answered_hz }
            });
        }
        self.trust = Trust::Sequence;
        if !is_right(trial.periods as f64 * self.period_ns) {
            self.period_ns = measured_ns;
        }
        let declared_hz = NS_PER_S as f64 / self.tick_ns;
        Some(TickFault::Rate { measured_hz: declared_hz * trial.tick_ns / elapsed_ns, declared_hz })
    }

    /// Standard uncertainty of a step. A single time is predicted by the sequence to the tolerance of the
    /// comparison; where disagreements follow each other, only the host vouches for the time.
    fn sigma_ns(&self, disagrees: bool, sequence_ns: f64) -> Option<f64> {
        match self.trust {
            Trust::Sequence => None,
            Trust::Tick => Some(0.0),
            Trust::Arrival if self.suspect > 0 => None,
            Trust::Arrival if !disagrees => Some(0.0),
            Trust::Arrival => Some(self.tolerance_ns(sequence_ns) / f64::sqrt(3.0)),
        }
    }
}
