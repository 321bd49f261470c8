//! `trifacet board-test`: puts a board through the rules of `docs/board-protocol.md`.
//!
//! - `line`: the port. [`bench`]: the board on it. [`scans`]: what is read from it in a series.
//! - [`verdict`]: the results. `rules`: the rules, by the sections of the document.

pub mod bench;
mod line;
mod rules;
pub mod scans;
pub mod verdict;

use bench::Bench;
pub use line::{Options, Received, TestError};
use rules::Rule;
use verdict::{Outcome, Verdict};

/// Puts the board on the bench through all rules, in their order, and leaves it stopped. After each rule `tell` gets its
/// outcome.
///
/// # Errors
/// The port fails.
pub fn run(bench: &mut Bench, mut tell: impl FnMut(&Outcome)) -> Result<Vec<Outcome>, TestError> {
    let mut outcomes = Vec::new();
    for Rule { name, section, moves, check } in rules::ALL {
        let verdict = if *moves && bench.amplitude().is_none() {
            Verdict::Skip("it moves the stage: needs --move".into())
        } else {
            let checked = check(bench);
            bench.settle()?;
            verdict::of(checked)?
        };
        let outcome = Outcome { rule: name, section, verdict };
        tell(&outcome);
        outcomes.push(outcome);
    }
    bench.leave()?;
    Ok(outcomes)
}
