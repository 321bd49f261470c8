//! `trifacet calibrate`: finds the numbers of a real head from measurements.

mod fit;
mod plan;
mod report;
mod run;

use clap::Subcommand;

use crate::commands::within;

/// Options of `calibrate`.
#[derive(Debug, clap::Args)]
pub(crate) struct CalibrateArgs {
    #[command(subcommand)]
    step: Step,
}

#[derive(Debug, Subcommand)]
enum Step {
    /// Choose the poses of a calibration, so that they cover the PSDs evenly
    Plan(plan::PlanArgs),
    /// Measure the planned poses, with a reference that states the pose of the mirror
    Run(run::RunArgs),
    /// Fit the head to measured points, and write a calibrated configuration into a new folder
    Fit(Box<fit::FitArgs>),
    /// Write the certificate of a calibration
    Report(report::ReportArgs),
}

/// Runs one step of a calibration.
pub(crate) fn calibrate(args: &CalibrateArgs) -> anyhow::Result<()> {
    match &args.step {
        Step::Plan(args) => plan::plan(args),
        Step::Run(args) => run::run(args),
        Step::Fit(args) => fit::fit(args),
        Step::Report(args) => report::report(args),
    }
}

/// Standard uncertainties of the reference, of each coordinate.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(crate) struct ReferenceArgs {
    /// Standard uncertainty of each translation of the reference, micrometres
    #[arg(long, value_name = "UM", default_value_t = 0.1, value_parser = within(0.001..=10_000.0))]
    reference_um: f64,
    /// Standard uncertainty of each rotation of the reference, microradians
    #[arg(long, value_name = "URAD", default_value_t = 0.5, value_parser = within(0.001..=10_000.0))]
    reference_urad: f64,
}

impl ReferenceArgs {
    fn noise(self) -> trifacet::calibration::effort::ReferenceNoise {
        trifacet::calibration::effort::ReferenceNoise {
            metres: self.reference_um * 1e-6,
            radians: self.reference_urad * 1e-6,
        }
    }
}
