//! `trifacet calibrate`: from measured points to a calibrated configuration.

use clap::Subcommand;

mod fit;

/// Options of `calibrate`.
#[derive(Debug, clap::Args)]
pub(crate) struct CalibrateArgs {
    #[command(subcommand)]
    command: Calibrate,
}

#[derive(Debug, Subcommand)]
enum Calibrate {
    /// Fit the head to measured points, and write a calibrated configuration into a new folder
    Fit(Box<fit::FitArgs>),
}

/// Runs a command of `calibrate`.
pub(crate) fn calibrate(args: &CalibrateArgs) -> anyhow::Result<()> {
    match &args.command {
        Calibrate::Fit(args) => fit::fit(args),
    }
}
