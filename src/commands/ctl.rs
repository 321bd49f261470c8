//! `trifacet ctl`: tells a running daemon what to do.

use std::io::Write as _;
use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};
use trifacet::control::{self, Command};
use trifacet::exit::{self, Failure};
use trifacet::recording::RecorderCommand;
use trifacet_core::centering::LoopMode;
use trifacet_core::telemetry::heartbeat::{Drill, Task};

use super::written;

/// Options of `ctl`.
#[derive(Debug, Args)]
pub(crate) struct CtlArgs {
    /// The daemon's control socket, as `[control] socket` in its configuration
    #[arg(long, value_name = "PATH", default_value = "/run/trifacet/control.sock")]
    socket: PathBuf,
    #[command(subcommand)]
    order: CtlCommand,
}

#[derive(Debug, Subcommand)]
enum CtlCommand {
    /// Say what is going on
    Status,
    /// Let the present pose read zero
    Tare(TareArgs),
    /// Switch the centering loop; in the shadow it computes, and moves nothing; manual: see `move`
    Loop {
        /// What it shall do
        #[arg(value_enum)]
        mode: Mode,
    },
    /// Bring the beam to another place than the apex
    #[command(allow_negative_numbers = true)]
    Setpoint {
        /// Along x, micrometres
        x_um: f64,
        /// Along y, micrometres
        y_um: f64,
    },
    /// Change the gains of the loop
    #[command(allow_negative_numbers = true)]
    Gains {
        /// Proportional gain
        kp: f64,
        /// Integral gain, per second
        ki_per_s: f64,
    },
    /// Send the stage to a place; only while the loop is manual
    #[command(allow_negative_numbers = true)]
    Move {
        /// First axis, micrometres
        x_um: f64,
        /// Second axis, micrometres
        y_um: f64,
    },
    /// Take the loop off the stage and park it; the loop is manual then
    Park,
    /// Look for the apex now, however often that was in vain
    Search,
    /// Let a task of the daemon misbehave, to see whether your supervision notices; with the twin only
    Drill {
        /// What it shall do
        #[arg(value_enum)]
        what: What,
        /// The task
        #[arg(value_enum)]
        task: Which,
    },
    /// Record, or say what is recorded
    Record {
        /// What to do
        #[arg(value_enum)]
        what: Recording,
    },
    /// Read the configuration file again, as on SIGHUP
    Reload,
}

#[derive(Debug, Args)]
struct TareArgs {
    /// No tare any more
    #[arg(value_enum)]
    what: Option<Clear>,
    /// Write it into the configuration file too; otherwise it goes with the daemon
    #[arg(long)]
    save: bool,
    /// Poses to average; those of 0.1 s if absent
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), conflicts_with = "what")]
    poses: Option<u32>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Clear {
    Clear,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Mode {
    On,
    Off,
    Shadow,
    Manual,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum What {
    /// Wait for ever, while the others go on
    Stall,
    /// Never come back, so that all wait for it
    Block,
    /// End by itself
    End,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Recording {
    /// Record from now on
    Start,
    /// End the recording
    Stop,
    /// Do as if there were a fault: with [recording] mode = "on-fault"
    Trigger,
    /// Say what is recorded, and where
    Status,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Which {
    Acquisition,
    Centering,
    Estimation,
}

impl From<What> for Drill {
    fn from(what: What) -> Self {
        match what {
            What::Stall => Self::Stall,
            What::Block => Self::Block,
            What::End => Self::End,
        }
    }
}

impl From<Which> for Task {
    fn from(task: Which) -> Self {
        match task {
            Which::Acquisition => Self::Acquisition,
            Which::Centering => Self::Centering,
            Which::Estimation => Self::Estimation,
        }
    }
}

impl CtlCommand {
    fn command(&self) -> Command {
        match *self {
            CtlCommand::Status => Command::Status,
            CtlCommand::Tare(TareArgs { what: Some(Clear::Clear), save, .. }) => Command::ClearTare { save },
            CtlCommand::Tare(TareArgs { what: None, save, poses }) => Command::Tare { poses, save },
            CtlCommand::Loop { mode: Mode::On } => Command::Loop(LoopMode::On),
            CtlCommand::Loop { mode: Mode::Off } => Command::Loop(LoopMode::Off),
            CtlCommand::Loop { mode: Mode::Shadow } => Command::Loop(LoopMode::Shadow),
            CtlCommand::Loop { mode: Mode::Manual } => Command::Loop(LoopMode::Manual),
            CtlCommand::Move { x_um, y_um } => Command::Move([x_um, y_um]),
            CtlCommand::Park => Command::Park,
            CtlCommand::Search => Command::Search,
            CtlCommand::Setpoint { x_um, y_um } => Command::Setpoint([x_um, y_um]),
            CtlCommand::Gains { kp, ki_per_s } => Command::Gains { kp, ki_per_s },
            CtlCommand::Drill { what, task } => Command::Drill(what.into(), task.into()),
            CtlCommand::Record { what: Recording::Start } => Command::Record(RecorderCommand::Start),
            CtlCommand::Record { what: Recording::Stop } => Command::Record(RecorderCommand::Stop),
            CtlCommand::Record { what: Recording::Trigger } => Command::Record(RecorderCommand::Trigger),
            CtlCommand::Record { what: Recording::Status } => Command::Recording,
            CtlCommand::Reload => Command::Reload,
        }
    }
}

/// Prints the daemon's answer, a line of JSON; fails with what it refuses.
pub(crate) fn ctl(args: &CtlArgs) -> anyhow::Result<()> {
    let answer = control::client::ask(&args.socket, &args.order.command())?;
    written(writeln!(std::io::stdout(), "{answer}"))?;
    let Some(error) = answer["error"].as_str() else { return Ok(()) };
    let code = answer["code"].as_u64().and_then(|code| u8::try_from(code).ok()).unwrap_or(exit::SOFTWARE);
    Err(Failure::new(code, error).into())
}
