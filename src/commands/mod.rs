//! The commands of `trifacet`, one module each. `main.rs` only dispatches.

use std::fmt::Display;
use std::io;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::Context;
use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;
use trifacet::config::{self, Config, NO_TILT, SteeringKind};
use trifacet::exit::{self, Failure};

mod board_test;
mod budget;
mod calibrate;
mod check;
mod ctl;
mod dark;
mod doctor;
mod emulate;
mod experiment;
mod export;
mod generate;
mod info;
mod new_file;
mod park;
mod recover;
mod replay;
mod run;
mod running;
mod silence;
mod simulate;
mod solve;
mod status;
mod table;
mod trace;
mod tune;
mod watch;

pub(crate) use board_test::{BoardTestArgs, board_test};
pub(crate) use budget::{BudgetArgs, budget};
pub(crate) use calibrate::{CalibrateArgs, calibrate};
pub(crate) use check::{CheckArgs, check};
pub(crate) use ctl::{CtlArgs, ctl};
pub(crate) use dark::{DarkArgs, dark};
pub(crate) use doctor::{DoctorArgs, doctor};
pub(crate) use emulate::{EmulateArgs, emulate};
pub(crate) use experiment::{ExperimentArgs, experiment};
pub(crate) use export::{ExportArgs, export};
pub(crate) use generate::{GenerateArgs, generate};
pub(crate) use info::{InfoArgs, info};
pub(crate) use park::{ParkArgs, park};
pub(crate) use recover::{RecoverArgs, recover};
pub(crate) use replay::{ReplayArgs, replay};
pub(crate) use run::{RunArgs, run};
pub(crate) use simulate::{SimulateArgs, simulate};
pub(crate) use solve::{SolveArgs, solve};
pub(crate) use status::{StatusArgs, status};
pub(crate) use trace::{TableArgs, trace};
pub(crate) use tune::{TuneArgs, tune};
pub(crate) use watch::{WatchArgs, watch};

/// The option of all commands that use a configuration.
#[derive(Debug, clap::Args)]
pub(crate) struct ConfigArg {
    /// Configuration file; by default all keys have their default values
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

impl ConfigArg {
    /// Path of the configuration file, if one was given.
    pub(crate) fn path(&self) -> Option<&Path> {
        self.config.as_deref()
    }

    /// The checked configuration, with a beam that is translated.
    pub(crate) fn load(&self) -> anyhow::Result<Config> {
        translated(self.load_any_beam()?)
    }

    /// The checked configuration. The beam may be tilted.
    pub(crate) fn load_any_beam(&self) -> anyhow::Result<Config> {
        Ok(config::load(self.config.as_deref())?)
    }
}

/// The configuration, unless a mirror tilts its beam.
pub(crate) fn translated(config: Config) -> anyhow::Result<Config> {
    if config.steering.kind == SteeringKind::Tilt {
        let why = format!("steering.kind = \"tilt\" is not possible here: {NO_TILT}");
        return Err(Failure::new(exit::CONFIG, why).into());
    }
    Ok(config)
}

/// A parser of an option that is a number within this range, for its error message too.
pub(crate) fn within<T>(
    allowed: RangeInclusive<T>,
) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static
where
    T: FromStr + PartialOrd + Display + Clone + Send + Sync + 'static,
{
    move |text| {
        let number = text.parse().ok().filter(|number| allowed.contains(number));
        number.ok_or_else(|| format!("allowed is {} to {}", allowed.start(), allowed.end()))
    }
}

/// A token that SIGINT or SIGTERM cancels.
pub(crate) fn interrupted() -> io::Result<CancellationToken> {
    let stop = CancellationToken::new();
    let (mut interrupt, mut terminate) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
    let token = stop.clone();
    tokio::task::spawn_local(async move {
        tokio::select! { _ = interrupt.recv() => {}, _ = terminate.recv() => {} }
        token.cancel();
    });
    Ok(stop)
}

/// Standard output was closed by its reader, as by `head`. This is not an error.
#[derive(Debug, thiserror::Error)]
#[error("standard output was closed")]
pub(crate) struct OutputClosed;

/// Converts the result of writing to standard output to the result of a command.
pub(crate) fn written(result: io::Result<()>) -> anyhow::Result<()> {
    match result {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Err(OutputClosed.into()),
        result => result.context("cannot write to standard output"),
    }
}
