//! `trifacet board-test`: puts a board through the rules of the board protocol.

use std::io::{self, Write};

use clap::Args;
use trifacet::board_test::bench::Bench;
use trifacet::board_test::verdict::{Outcome, Verdict};
use trifacet::board_test::{Options, TestError, run};
use trifacet::config::BoardPlace;
use trifacet::exit::{self, Failure};

use super::written;

/// Options of `board-test`.
#[derive(Debug, Args)]
#[command(after_help = "\
Prints a verdict on each rule of docs/board-protocol.md: PASS; FAIL, with what was seen and what the document requires; or SKIP, with the
reason. Exit code 0 if no rule fails, 65 if one does, 69 if no board answers, 75 if another process or host uses the board.

Without --move no command is sent that the board may accept, so that its outputs keep their values; only a lease that still runs may end.
With --move the outputs are commanded to positions up to CODES from code 0, are held or parked there for up to 2 s, and are sent to code 0 at
the end. Codes just beyond the range are sent too: a board that wrongly accepts them moves the stage to its limit. Detach the stage if that
is not safe.")]
pub(crate) struct BoardTestArgs {
    /// Port of the board, or its address HOST:PORT, or unix:PATH of its socket
    port: String,
    /// Baud rate of a serial port
    #[arg(long, default_value_t = 921_600, value_parser = clap::value_parser!(u32).range(300..=20_000_000))]
    baud: u32,
    /// Rate of the scans; by default 1000, or the nearest that board and baud rate allow
    #[arg(long, value_name = "HZ", value_parser = rate_mhz)]
    rate: Option<u32>,
    /// Move the stage, by at most this number of output codes to either side of code 0
    #[arg(long = "move", value_name = "CODES", value_parser = clap::value_parser!(i32).range(1..))]
    amplitude: Option<i32>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// A rate in Hz as scans per 1000 seconds.
fn rate_mhz(text: &str) -> Result<u32, String> {
    match text.parse::<f64>() {
        Ok(hz) if (0.001..=1e6).contains(&hz) => Ok((hz * 1e3).round() as u32),
        _ => Err("a rate is a number from 0.001 to 1000000 Hz".into()),
    }
}

/// Tests the board.
pub(crate) fn board_test(args: &BoardTestArgs) -> anyhow::Result<()> {
    let place = BoardPlace::parse(&args.port, args.baud)
        .map_err(|error| Failure::new(exit::USAGE, format!("{}: {error}", args.port)))?;
    let options = Options { place, rate_mhz: args.rate, amplitude: args.amplitude };
    let mut bench = Bench::open(options).map_err(|error| failure(&error))?;
    let name = bench.identity.name.clone();
    let mut printed = Ok(());
    if !args.json {
        written(writeln!(io::stdout(), "{name} on {}, {} mHz", args.port, bench.rate_mhz()))?;
    }
    let outcomes = run(&mut bench, |outcome| {
        if !args.json && printed.is_ok() {
            printed = written(writeln!(io::stdout(), "{outcome}"));
        }
    });
    let outcomes = outcomes.map_err(|error| failure(&error))?;
    printed?;
    let failed: Vec<_> =
        outcomes.iter().filter(|outcome| outcome.failed()).map(|outcome| outcome.rule).collect();
    summarise(args, &name, &outcomes, &failed)?;
    if failed.is_empty() {
        return Ok(());
    }
    let message =
        format!("{name} breaks {} of {} rules: {}", failed.len(), outcomes.len(), failed.join(", "));
    Err(Failure::new(exit::DATA, message).into())
}

fn summarise(args: &BoardTestArgs, name: &str, outcomes: &[Outcome], failed: &[&str]) -> anyhow::Result<()> {
    let mut out = io::stdout();
    if args.json {
        let report = serde_json::json!({
            "port": args.port, "board": name, "passed": failed.is_empty(), "rules": outcomes,
        });
        return written(writeln!(out, "{report}"));
    }
    let skipped = outcomes.iter().filter(|outcome| matches!(outcome.verdict, Verdict::Skip(_))).count();
    let passed = outcomes.len() - skipped - failed.len();
    written(writeln!(out, "{passed} passed, {} failed, {skipped} skipped", failed.len()))
}

/// The failure with its exit code.
fn failure(error: &TestError) -> Failure {
    let code = match error {
        TestError::Busy { .. } => exit::IN_USE,
        TestError::Link(error) if error.is_in_use() => exit::IN_USE,
        TestError::Link(_) | TestError::NoBoard { .. } => exit::UNAVAILABLE,
        TestError::Io { .. } => exit::IO,
        TestError::Amplitude { .. } => exit::USAGE,
    };
    Failure::new(code, error.to_string())
}
