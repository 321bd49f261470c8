//! `trifacet board-test`: puts a board through the rules of `docs/board-protocol.md`.
//!
//! - `line`: the port. [`bench`](mod@bench): the board on it. [`scans`]: what is read from it in a series.
//! - [`verdict`]: the results. `rules`: the rules, by the sections of the document.

pub mod bench;
mod line;
mod rules;
pub mod scans;
pub mod verdict;

use bench::Bench;
pub use line::{Options, Received, TestError};
use rules::Rule;
use verdict::{Broken, Outcome, Verdict};

/// Attempts for a rule whose check depends on the timing of host and line.
const ATTEMPTS: u32 = 3;

/// Puts the board on the bench through all rules, in their order, and leaves it stopped. After each rule `tell` gets its
/// outcome.
///
/// # Errors
/// The port fails.
pub fn run(bench: &mut Bench, mut tell: impl FnMut(&Outcome)) -> Result<Vec<Outcome>, TestError> {
    let mut outcomes = Vec::new();
    for rule in rules::ALL {
        let verdict = if rule.moves && bench.amplitude().is_none() {
            Verdict::Skip("it moves the stage: needs --move".into())
        } else {
            verdict::of(check(bench, rule)?)?
        };
        let outcome = Outcome { rule: rule.name, section: rule.section, verdict };
        tell(&outcome);
        outcomes.push(outcome);
    }
    bench.leave()?;
    Ok(outcomes)
}

/// Checks a rule. A busy computer can disturb a check that depends on the timing: it is repeated before it counts.
fn check(bench: &mut Bench, rule: &Rule) -> Result<Result<String, Broken>, TestError> {
    let attempts = if rule.timing { ATTEMPTS } else { 1 };
    let mut attempt = 1;
    loop {
        let checked = (rule.check)(bench);
        bench.settle()?;
        match checked {
            Err(Broken::Fail { .. } | Broken::Busy) if attempt < attempts => attempt += 1,
            Ok(seen) if attempt > 1 => return Ok(Ok(format!("{seen} (attempt {attempt})"))),
            checked => return Ok(checked),
        }
    }
}
