//! `trifacet run`: the daemon.

use clap::Args;
use trifacet::{daemon, logging};

use super::ConfigArg;

/// Options of `run`.
#[derive(Debug, Args)]
pub(crate) struct RunArgs {
    #[command(flatten)]
    config: ConfigArg,
}

/// Runs the daemon until it is told to stop.
pub(crate) fn run(args: &RunArgs) -> anyhow::Result<()> {
    let config = args.config.load()?;
    let _written_at_the_end = logging::start(&config.log)?;
    let result = daemon::run(&config);
    if let Err(error) = &result {
        tracing::error!("{error:#}");
    }
    result
}
