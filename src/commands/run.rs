//! `trifacet run`: runs the daemon.

use std::sync::Arc;

use clap::Args;
use trifacet::{daemon, logging};

use super::ConfigArg;

/// Options of `run`.
#[derive(Debug, Args)]
pub(crate) struct RunArgs {
    #[command(flatten)]
    config: ConfigArg,
}

/// Runs the daemon until SIGTERM, SIGINT, the loss of its terminal, or a failure.
pub(crate) fn run(args: &RunArgs) -> anyhow::Result<()> {
    let config = args.config.load()?;
    let log = Arc::new(logging::start(&config.log)?);
    let result = daemon::run(&config, args.config.path(), &log);
    if let Err(error) = &result {
        tracing::error!("{error:#}");
    }
    result
}
