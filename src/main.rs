//! The command line of trifacet: each command is one line to one function.

mod commands;

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

const EXIT_CODES: &str = "Exit codes: 0 fine, 1 a replay that differs, 64 wrong command line, 65 bad data (rows, or a recording with holes), \
    69 nothing there to talk to, 70 a defect, 74 a file or socket failed, 75 in use by another process, \
    78 wrong configuration, 130 interrupted.";

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the daemon
    Run(commands::RunArgs),
    /// Tell a running daemon what to do
    Ctl(commands::CtlArgs),
    /// Say what a configuration means, or what is wrong with it
    Check(commands::CheckArgs),
    /// Play an acquisition board on a pseudo-terminal
    Emulate(commands::EmulateArgs),
    /// Measure the dark offsets with the laser off, and write them into the configuration
    Dark(commands::DarkArgs),
    /// Measure the loop with small steps of the stage, and write it into the configuration
    Tune(commands::TuneArgs),
    /// Compute signals from poses: CSV in, CSV out
    Trace(commands::TableArgs),
    /// Compute poses from signals: CSV in, CSV out
    Solve(commands::TableArgs),
    /// Compute samples of the digital twin, with the truth behind them, as CSV
    Simulate(commands::SimulateArgs),
    /// Repeat the paper's experiment, on the twin or with a running daemon, and write a report
    Experiment(commands::ExperimentArgs),
    /// Say why nothing arrives, or nothing valid, and what to do
    Doctor(commands::DoctorArgs),
    /// Print the frames of a running daemon
    Watch(commands::WatchArgs),
    /// Say how a running daemon is doing: balance, pose, lock, losses
    Status(commands::StatusArgs),
    /// Send the stage to its parking position while no daemon runs
    Park(commands::ParkArgs),
    /// Compute recorded poses again, and compare
    Replay(commands::ReplayArgs),
    /// Say what recordings hold, and whether they are whole
    Info(commands::InfoArgs),
    /// Save what can be read of a damaged recording
    Recover(commands::RecoverArgs),
    /// Write a recording as a table: CSV or Parquet
    Export(commands::ExportArgs),
    /// Write man pages and shell completions, for a package
    #[command(hide = true)]
    Generate(commands::GenerateArgs),
}

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(usage) => {
            let _ = usage.print(); // help that nobody reads is no failure
            return ExitCode::from(if usage.use_stderr() { exit::USAGE } else { 0 });
        }
    };
    let result = match cli.command {
        Command::Run(args) => commands::run(&args),
        Command::Ctl(args) => commands::ctl(&args),
        Command::Check(args) => commands::check(&args),
        Command::Emulate(args) => commands::emulate(&args),
        Command::Dark(args) => commands::dark(&args),
        Command::Tune(args) => commands::tune(&args),
        Command::Trace(args) => commands::trace(&args),
        Command::Solve(args) => commands::solve(&args),
        Command::Simulate(args) => commands::simulate(&args),
        Command::Experiment(args) => commands::experiment(&args),
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

/// Says what went wrong, and why; gives the exit code for it.
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
