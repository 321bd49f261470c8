//! The command line of trifacet.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use trifacet::exit::{self, Failure};

mod commands;

#[derive(Parser)]
#[command(version, about)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Watch(commands::WatchArgs),
}

fn main() -> ExitCode {
    let Command::Watch(args) = Cli::parse().command;
    match commands::watch(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("error: {e:#}");
            ExitCode::from(e.downcast_ref::<Failure>().map_or(exit::SOFTWARE, |f| f.code))
        }
    }
}
