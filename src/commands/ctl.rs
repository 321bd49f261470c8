//! `trifacet ctl`: sends a command to a running daemon.

mod people;

use std::io::{IsTerminal as _, Write as _};

use clap::{Args, Subcommand, ValueEnum};
use trifacet::control::{self, Command};
use trifacet::exit::{self, Failure};
use trifacet::recording::RecorderCommand;
use trifacet::twin::MirrorMove;
use trifacet::twin::moves::DEFAULT_S;
use trifacet_core::centering::LoopMode;
use trifacet_core::telemetry::heartbeat::{Drill, Task};

use super::running::{RunningArg, SocketArg};
use super::written;

/// Options of `ctl`.
#[derive(Debug, Args)]
pub(crate) struct CtlArgs {
    #[command(flatten)]
    socket: SocketArg,
    #[command(flatten)]
    running: RunningArg,
    /// Print JSON on a terminal too
    #[arg(long)]
    json: bool,
    #[command(subcommand)]
    order: CtlCommand,
}

#[derive(Debug, Subcommand)]
enum CtlCommand {
    /// Print the state of the daemon
    Status,
    /// Let the present pose read zero (tare)
    Tare(TareArgs),
    /// Switch the centering loop. shadow: it computes its moves but does not move the stage; manual: see
    /// `move`
    Loop {
        /// Mode of the loop
        #[arg(value_enum)]
        mode: Mode,
    },
    /// Set the desired offset of the beam from the apex
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
    /// Move the stage to a position; only if the loop is manual
    #[command(allow_negative_numbers = true)]
    Move {
        /// First axis, micrometres
        x_um: f64,
        /// Second axis, micrometres
        y_um: f64,
    },
    /// Switch the loop to manual and park the stage
    Park,
    /// Search for the apex now, even if all earlier searches have failed
    Search,
    /// Move the beam over a small pattern, and test whether the pose depends on it; the mirror must be at rest
    SelfCheck,
    /// Move the mirror of the twin, as a stage under it would, and wait until it is there; with the twin only.
    /// Its configured motion ends
    #[command(allow_negative_numbers = true)]
    TwinPose {
        /// tx, ty, tz in micrometres, then roll, pitch, yaw in microradians
        #[arg(num_args = 6, required = true, value_names = ["TX", "TY", "TZ", "ROLL", "PITCH", "YAW"])]
        micro: Vec<f64>,
        /// Duration of the move, seconds
        #[arg(long, value_name = "S", default_value_t = DEFAULT_S)]
        over_s: f64,
    },
    /// Simulate a failure of a task, to test your supervision; with the twin only
    Drill {
        /// Failure of the task
        #[arg(value_enum)]
        what: What,
        /// Task that fails
        #[arg(value_enum)]
        task: Which,
    },
    /// Record, or print the state of the recording
    Record {
        /// Action
        #[arg(value_enum)]
        what: Recording,
    },
    /// Reload the configuration file, as on SIGHUP
    Reload,
}

#[derive(Debug, Args)]
struct TareArgs {
    /// `clear` removes the tare
    #[arg(value_enum)]
    what: Option<Clear>,
    /// Also write the tare into the configuration file; otherwise it is lost when the daemon ends
    #[arg(long)]
    save: bool,
    /// Number of poses to average; by default those of 0.1 s, at most those of 10 s
    #[arg(long, value_name = "N", value_parser = poses, conflicts_with = "what")]
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
    /// The task waits for ever; the other tasks continue
    Stall,
    /// The task does not return, so that all tasks of the thread wait
    Block,
    /// The task ends
    End,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Recording {
    /// Start a recording
    Start,
    /// End the recording
    Stop,
    /// Record as after a fault; only with [recording] mode = "on-fault"
    Trigger,
    /// Print the state of the recording, and its file
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

/// The daemon, which knows the rate of the poses, checks the upper limit.
fn poses(text: &str) -> Result<u32, &'static str> {
    text.parse().ok().filter(|poses| *poses > 0).ok_or("allowed is 1 to the number of poses in 10 s")
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
            CtlCommand::SelfCheck => Command::SelfCheck,
            CtlCommand::Setpoint { x_um, y_um } => Command::Setpoint([x_um, y_um]),
            CtlCommand::Gains { kp, ki_per_s } => Command::Gains { kp, ki_per_s },
            CtlCommand::TwinPose { ref micro, over_s } => {
                // clap takes six values.
                let micro = std::array::from_fn(|i| micro.get(i).copied().unwrap_or_default());
                Command::TwinPose(MirrorMove { micro, over_s })
            }
            CtlCommand::Drill { what, task } => Command::Drill(what.into(), task.into()),
            CtlCommand::Record { what: Recording::Start } => Command::Record(RecorderCommand::Start),
            CtlCommand::Record { what: Recording::Stop } => Command::Record(RecorderCommand::Stop),
            CtlCommand::Record { what: Recording::Trigger } => Command::Record(RecorderCommand::Trigger),
            CtlCommand::Record { what: Recording::Status } => Command::Recording,
            CtlCommand::Reload => Command::Reload,
        }
    }
}

/// Prints the daemon's answer: one line of JSON, or lines for a person on a terminal. Fails if the daemon refuses
/// the command.
pub(crate) fn ctl(args: &CtlArgs) -> anyhow::Result<()> {
    let socket = args.running.socket(&args.socket)?;
    let answer = control::client::ask(&socket, &args.order.command())?;
    let mut out = std::io::stdout();
    let error = answer["error"].as_str();
    if args.json || !out.is_terminal() {
        written(writeln!(out, "{answer}"))?;
    } else if error.is_none() {
        written(out.write_all(people::lines(&answer).as_bytes()))?;
    }
    let Some(error) = error else { return Ok(()) };
    let code = answer["code"].as_u64().and_then(|code| u8::try_from(code).ok()).unwrap_or(exit::SOFTWARE);
    Err(Failure::new(code, error).into())
}
