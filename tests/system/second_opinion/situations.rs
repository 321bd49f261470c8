//! Situations in which a board, the light or the stage misleads the daemon: the error, the signs, after what time they
//! are found, and what cannot be detected. `docs/honesty.md` contains the same list.

use std::sync::Mutex;

use super::board::Program;
use super::observation::{Observation, Window, observe};
use super::table::SITUATIONS;

const DOCUMENT: &str = include_str!("../../../docs/honesty.md");
/// Boards that run at the same time.
const PARALLEL: usize = 3;
/// Bits that contradict the pose or its signals. A busy machine never causes them.
const CONTRADICTIONS: [&str; 5] =
    ["INCONSISTENT", "CHANNEL_FROZEN", "POWER_STEP", "OUT_OF_RANGE", "NOT_CONVERGED"];
/// Standard uncertainties within which a pose is as stated.
const AS_STATED: f64 = 7.0;
/// Limit of the error of the times beyond five stated standard uncertainties, milliseconds: below the error of each fault
/// of the tick if the daemon believed it.
const TIME_MS: f64 = 10.0;

/// A machine that leaves the board without a processor for this long is too busy, milliseconds.
const STALL_MS: f64 = 30.0;
/// Runs of a situation on a machine that is too busy.
const RUNS: usize = 5;

/// The error of the poses that a control would use.
#[derive(Debug)]
pub(super) enum Error {
    /// Every usable pose is within its stated uncertainty.
    AsStated,
    /// The usable poses are wrong: the largest errors of position (um) and rotation (urad) are in these ranges.
    Wrong { um: [f64; 2], urad: [f64; 2] },
}

/// What tells a situation.
#[derive(Debug)]
pub(super) enum Sign {
    /// This status bit, at most this number of scans after the begin.
    Bit(&'static str, u64),
    /// This status bit, in every frame.
    Always(&'static str),
    /// This counter.
    Counter(&'static str),
    /// A line of the log that contains this.
    Log(&'static str),
}

/// A situation, with what is claimed about it.
#[derive(Debug)]
pub(super) struct Situation {
    pub(super) name: &'static str,
    /// Arguments of the board.
    pub(super) arguments: &'static str,
    /// Lines of the configuration of the daemon.
    pub(super) config: &'static str,
    /// First scan with the situation.
    pub(super) at: u64,
    pub(super) error: Error,
    /// Nothing tells the situation if there is no sign.
    pub(super) signs: &'static [Sign],
    /// What cannot be detected.
    pub(super) silent: &'static str,
}

impl Error {
    fn text(&self) -> String {
        match self {
            Error::AsStated => "none".into(),
            Error::Wrong { um, urad } => {
                format!("**{} to {} um, {} to {} urad**", um[0], um[1], urad[0], urad[1])
            }
        }
    }

    fn holds(&self, seen: &Observation) -> bool {
        match self {
            Error::AsStated => seen.sigmas < AS_STATED,
            Error::Wrong { um, urad } => [(um, seen.error[0]), (urad, seen.error[1])]
                .iter()
                .all(|(range, error)| (range[0]..range[1]).contains(error)),
        }
    }
}

impl Sign {
    fn text(&self) -> (String, String) {
        match self {
            Sign::Bit(name, scans) => (format!("`{name}`"), format!("{scans} scans")),
            Sign::Always(name) => (format!("`{name}`"), "always".into()),
            Sign::Counter(name) => (format!("counter `{name}`"), "3 s".into()),
            Sign::Log(text) => (format!("log: \"{text}\""), "3 s".into()),
        }
    }

    fn given(&self, seen: &Observation) -> bool {
        match self {
            Sign::Bit(name, scans) => seen.bits.get(name).is_some_and(|after| after <= scans),
            Sign::Always(name) => seen.always.names().any(|bit| bit == *name),
            Sign::Counter(name) => seen.counters.contains_key(*name),
            Sign::Log(text) => seen.log.iter().any(|line| line.contains(text)),
        }
    }
}

impl Situation {
    /// The row of the document.
    fn row(&self) -> String {
        let (what, when): (Vec<_>, Vec<_>) = self.signs.iter().map(Sign::text).unzip();
        let what = if what.is_empty() { "**nothing**".into() } else { what.join("; ") };
        let when = if when.is_empty() { "never".into() } else { when.join("; ") };
        let (error, silent) = (self.error.text(), self.silent);
        let config = if self.config.is_empty() { String::new() } else { format!(", `{}`", self.config) };
        format!("| {} | `{}`{config} | {error} | {what} | {when} | {silent} |", self.name, self.arguments)
    }

    fn window(&self) -> Window {
        // The loop has locked, and the noise of the channels is known.
        let from = self.at.max(1200);
        Window { from, to: from + 2000 }
    }

    /// Runs the situation; the result is what the claims missed. A run in which the machine had no time for the board
    /// is repeated if it missed anything.
    fn check(&self, program: &Program) -> Result<(), String> {
        let arguments = format!("at={} {}", self.at, self.arguments);
        let mut runs = 0;
        loop {
            let seen = observe(program, &arguments, self.config, self.window());
            println!(
                "{}: {:.2?} um, urad; {:.1} sigma; {:.2} ms; usable {} of {}; {:?}",
                self.name, seen.error, seen.sigmas, seen.time_ms, seen.usable, seen.frames, seen.bits
            );
            let missed = self.missed(&seen);
            runs += 1;
            if missed.is_empty() {
                return Ok(());
            }
            if seen.stall_ms < STALL_MS || runs == RUNS {
                return Err(format!("{}: not {missed:?}: {seen:#?}", self.name));
            }
        }
    }

    /// The claims that are not true.
    fn missed(&self, seen: &Observation) -> Vec<String> {
        let mut missed: Vec<String> =
            self.signs.iter().filter(|sign| !sign.given(seen)).map(|sign| format!("{sign:?}")).collect();
        if !self.error.holds(seen) {
            missed.push(format!("{:?}", self.error));
        }
        if seen.time_ms > TIME_MS {
            missed.push(format!("times within {TIME_MS} ms"));
        }
        if self.signs.is_empty() {
            let told = seen.bits.keys().filter(|bit| CONTRADICTIONS.contains(bit));
            missed.extend(told.map(|bit| format!("nothing tells it, but {bit} does")));
        }
        missed
    }
}

#[test]
fn every_situation_is_told_as_the_document_claims() {
    let program = Program::board();
    let (next, missed) = (Mutex::new(SITUATIONS.iter()), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..PARALLEL {
            scope.spawn(|| {
                loop {
                    let Some(situation) = next.lock().unwrap().next() else { return };
                    if let Err(what) = situation.check(&program) {
                        missed.lock().unwrap().push(what);
                    }
                }
            });
        }
    });
    let missed = missed.into_inner().unwrap();
    assert!(missed.is_empty(), "{}", missed.join("\n"));
}

/// If this fails, replace the rows of the document by those that it prints.
#[test]
fn the_table_of_the_document_has_these_rows() {
    let rows: Vec<String> = SITUATIONS.iter().map(Situation::row).collect();
    let in_document: Vec<&str> = DOCUMENT.lines().filter(|line| line.starts_with("| ")).skip(1).collect();
    assert_eq!(in_document, rows, "the rows are:\n{}", rows.join("\n"));
}
