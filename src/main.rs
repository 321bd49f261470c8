//! The command line of trifacet: each command calls one function.

mod commands;
mod limits;

use std::io::Write;
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use trifacet::config::ConfigError;
use trifacet::exit;
use trifacet::recording::reader::ReadError;

/// Six degrees of freedom from a three-facet mirror, a laser and three position-sensitive detectors.
#[derive(Debug, Parser)]
#[command(name = "trifacet", version, max_term_width = 100, after_help = EXIT_CODES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

const EXIT_CODES: &str = "Exit codes: 0 success, 1 a replay that differs, 64 wrong command line, 65 bad data (rows, a recording with gaps, or a board that breaks a rule), \
    69 nothing to communicate with, 70 a defect, 74 a file or socket failed, 75 in use by another process, \
    78 wrong configuration, 130 interrupted.";

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the daemon
    Run(commands::RunArgs),
    /// Control a running daemon
    Ctl(commands::CtlArgs),
    /// Explain a configuration, or list its errors
    Check(commands::CheckArgs),
    /// Emulate an acquisition board on a pseudo-terminal, over TCP or on a Unix socket
    Emulate(commands::EmulateArgs),
    /// Put an acquisition board through the rules of the board protocol
    BoardTest(commands::BoardTestArgs),
    /// Measure the dark offsets with the laser off, and write them into the configuration
    Dark(commands::DarkArgs),
    /// Measure the loop with small steps of the stage, and write the result into the configuration
    Tune(commands::TuneArgs),
    /// Calibrate a real head: find its numbers from measurements
    Calibrate(commands::CalibrateArgs),
    /// Compute signals from poses: CSV in, CSV out
    Trace(commands::TableArgs),
    /// Compute poses from signals: CSV in, CSV out
    Solve(commands::SolveArgs),
    /// Write samples of the digital twin with the true poses, as CSV
    Simulate(commands::SimulateArgs),
    /// Repeat the experiment of the paper, on the twin or with a running daemon, and write a report
    Experiment(commands::ExperimentArgs),
    /// State the uncertainty of a pose: the budget with all contributions
    Budget(commands::BudgetArgs),
    /// Find out why no frames or no valid frames arrive, and propose a remedy
    Doctor(commands::DoctorArgs),
    /// Print the frames of a running daemon
    Watch(commands::WatchArgs),
    /// Show the state of a running daemon: balance, pose, lock, losses
    Status(commands::StatusArgs),
    /// Send the stage to its parking position while no daemon runs
    Park(commands::ParkArgs),
    /// Recompute recorded poses, and compare them with the recorded ones
    Replay(commands::ReplayArgs),
    /// Show the contents of recordings, and whether they are complete
    Info(commands::InfoArgs),
    /// Save the readable parts of a damaged recording
    Recover(commands::RecoverArgs),
    /// Convert a recording to a table: CSV or Parquet
    Export(commands::ExportArgs),
    /// Write man pages and shell completions, for a package
    #[command(hide = true)]
    Generate(commands::GenerateArgs),
}

fn main() -> ExitCode {
    if let Err(error) = limits::make_file_size_an_error() {
        return report(&error.into());
    }
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(usage) => {
            let _ = usage.print(); // a closed standard output is not a failure
            return ExitCode::from(if usage.use_stderr() { exit::USAGE } else { 0 });
        }
    };
    let result = match cli.command {
        Command::Run(args) => commands::run(&args),
        Command::Ctl(args) => commands::ctl(&args),
        Command::Check(args) => commands::check(&args),
        Command::Emulate(args) => commands::emulate(&args),
        Command::BoardTest(args) => commands::board_test(&args),
        Command::Dark(args) => commands::dark(&args),
        Command::Tune(args) => commands::tune(&args),
        Command::Calibrate(args) => commands::calibrate(&args),
        Command::Trace(args) => commands::trace(&args),
        Command::Solve(args) => commands::solve(&args),
        Command::Simulate(args) => commands::simulate(&args),
        Command::Experiment(args) => commands::experiment(&args),
        Command::Budget(args) => commands::budget(&args),
        Command::Doctor(args) => commands::doctor(&args),
        Command::Watch(args) => commands::watch(&args),
        Command::Status(args) => commands::status(&args),
        Command::Park(args) => commands::park(&args),
        Command::Replay(args) => commands::replay(&args),
        Command::Info(args) => commands::info(&args),
        Command::Recover(args) => commands::recover(&args),
        Command::Export(args) => commands::export(&args),
        Command::Generate(args) => commands::generate(&args, Cli::command()),
    };
    result.map_or_else(|error| report(&error), |()| ExitCode::SUCCESS)
}

/// Prints the error with its causes; returns its exit code.
fn report(error: &anyhow::Error) -> ExitCode {
    if error.is::<commands::OutputClosed>() {
        return ExitCode::SUCCESS;
    }
    for line in format!("{error:#}").lines() {
        let _ = writeln!(std::io::stderr(), "trifacet: {line}"); // standard error may be closed
    }
    ExitCode::from(code(error))
}

fn code(error: &anyhow::Error) -> u8 {
    if let Some(failure) = error.downcast_ref::<exit::Failure>() {
        failure.code
    } else if let Some(unread) = error.downcast_ref::<ReadError>() {
        unread.code()
    } else if error.is::<ConfigError>() {
        exit::CONFIG
    } else if error.chain().any(<dyn std::error::Error>::is::<std::io::Error>) {
        exit::IO
    } else {
        exit::SOFTWARE
    }
}
