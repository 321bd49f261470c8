//! `trifacet budget`: the uncertainty budget of a pose relative to the tare.

use std::io::{self, Write};
use std::path::PathBuf;

use trifacet::budget::assessment::{AssessmentError, Basis, PoseCovariance};
use trifacet::budget::formats::{Range, Report};
use trifacet::budget::record::Recorded;
use trifacet::config::{CalibrationContext, Components};
use trifacet::exit::{self, Failure};
use trifacet_core::uncertainty::InstrumentError;
use trifacet_optics::Pose;

use super::{ConfigArg, within, written};

/// Options of `budget`.
#[derive(Debug, clap::Args)]
pub(crate) struct BudgetArgs {
    #[command(flatten)]
    config: ConfigArg,
    /// Pose relative to the tare: tx,ty,tz in um, roll,pitch,yaw in urad
    #[arg(long, value_name = "TX,TY,TZ,ROLL,PITCH,YAW", value_parser = pose, allow_hyphen_values = true, conflicts_with = "range")]
    pose: Option<Pose>,
    /// The worst pose within plus and minus these translations and angles
    #[arg(long, value_name = "MM,MRAD", value_parser = range, allow_hyphen_values = true, default_value = "1,5")]
    range: [f64; 2],
    /// Samples that are averaged in the pose; by default estimation.average
    #[arg(long, value_name = "N", value_parser = within(1_u32..=1_000_000_000))]
    average: Option<u32>,
    /// Coverage probability of the expanded uncertainty and of the Monte Carlo intervals
    #[arg(long, value_name = "P", value_parser = within(0.5..=0.9999), default_value = "0.9545")]
    probability: f64,
    /// Trials of the Monte Carlo method; 0: none
    #[arg(long, value_name = "N", value_parser = trials, default_value = "100000")]
    trials: usize,
    /// Seed of the Monte Carlo method; the same seed gives the same numbers
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = within(0_u64..=1 << 53))]
    seed: u64,
    /// Format of the output
    #[arg(long, value_name = "FORMAT", value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// Formats of the budget.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// A table of at most 100 columns
    Text,
    /// A page that prints on A4
    Html,
    /// A line for each quantity and measurand
    Csv,
    /// All numbers
    Json,
    /// A project of the Python package suncal
    Suncal,
    /// A Python script that uses the package GTC
    Gtc,
}

/// Numbers separated by commas.
fn numbers<const N: usize>(text: &str, what: &str) -> Result<[f64; N], String> {
    let values = text.split(',').map(|part| part.trim().parse().ok().filter(|x: &f64| x.is_finite()));
    let values: Option<Vec<f64>> = values.collect();
    values.and_then(|v| v.try_into().ok()).ok_or_else(|| format!("allowed is {what}, separated by commas"))
}

fn pose(text: &str) -> Result<Pose, String> {
    let values = numbers::<6>(text, "six numbers, tx,ty,tz in um and roll,pitch,yaw in urad")?;
    let wrong = values.iter().any(|value| value.abs() > 1e6);
    if wrong {
        Err("allowed is -1000000 to 1000000, each".into())
    } else {
        Ok(Pose::from_array(values.map(|x| x * 1e-6)))
    }
}

fn range(text: &str) -> Result<[f64; 2], String> {
    let [mm, mrad] = numbers::<2>(text, "two numbers, translation in mm and angle in mrad")?;
    let fine = (0.0..=1000.0).contains(&mm) && (0.0..=1000.0).contains(&mrad);
    if fine { Ok([mm * 1e-3, mrad * 1e-3]) } else { Err("allowed is 0 to 1000, each".into()) }
}

/// Zero, or enough for an interval.
fn trials(text: &str) -> Result<usize, String> {
    let value = text.parse().ok().filter(|n| *n == 0 || (1000..=10_000_000).contains(n));
    value.ok_or_else(|| "allowed is 0, or 1000 to 10000000".into())
}

/// Prints the budget.
pub(crate) fn budget(args: &BudgetArgs) -> anyhow::Result<()> {
    let context = CalibrationContext::read(args.config.load()?).map_err(Failure::from)?;
    let config = &context.config;
    let average = args.average.unwrap_or(config.estimation.average.into());
    let recorded = recorded(&context)?;
    let mut instrument =
        config.instrument().map_err(|error| Failure::new(exit::CONFIG, error.to_string()))?;
    let table = recorded.as_ref().map(PoseCovariance::table);
    if let Some(table) = table {
        instrument = instrument.calibrated_at(table);
    }
    let basis = Basis {
        instrument,
        components: Components::new(config, average, table.as_ref()),
        calibration: recorded.as_ref().map(|recorded| recorded as &dyn PoseCovariance),
        objection: context.calibration.objection(),
    };
    let (assessment, range) = if let Some(pose) = &args.pose {
        (basis.assess(pose).map_err(|error| failure(&error))?, None)
    } else {
        let [metres, radians] = args.range;
        let (worst, largest) = basis.worst(args.range).map_err(|error| failure(&error))?;
        (worst, Some(Range { metres, radians, largest }))
    };
    let exported = matches!(args.format, Format::Suncal | Format::Gtc | Format::Csv);
    let trials = if args.trials > 0 && !exported {
        Some(
            basis
                .monte_carlo(&assessment, args.probability, args.trials, args.seed)
                .map_err(|error| failure(&error))?,
        )
    } else {
        None
    };
    let report = Report {
        configuration: args.config.path().map_or("none (defaults)".into(), |path| path.display().to_string()),
        tared: basis.instrument.tared(),
        average,
        probability: args.probability,
        assessment,
        trials,
        range,
    };
    let text = match args.format {
        Format::Text => report.text(),
        Format::Html => report.html(),
        Format::Csv => report.csv()?,
        Format::Json => report.json(),
        Format::Suncal => report.suncal(),
        Format::Gtc => report.gtc(),
    };
    written(io::stdout().lock().write_all(text.as_bytes()))
}

/// The calibration record, if it belongs to the configuration.
fn recorded(context: &CalibrationContext) -> Result<Option<Recorded>, Failure> {
    let path = context.config.calibration.record.as_ref().filter(|_| context.calibration.belongs());
    let read = |path: &PathBuf| {
        let wrong =
            |error| Failure::new(exit::CONFIG, format!("calibration.record: {}: {error}", path.display()));
        Recorded::read(path).map_err(wrong)
    };
    path.map(read).transpose()
}

/// A pose outside the range is wrong data; a head that does not exist is a wrong configuration.
fn failure(error: &AssessmentError) -> Failure {
    let code = match error {
        AssessmentError::Instrument(InstrumentError::Tare(_)) => exit::CONFIG,
        AssessmentError::Instrument(_) | AssessmentError::Calibration => exit::DATA,
        AssessmentError::Budget(_) | AssessmentError::Sampler(_) => exit::SOFTWARE,
    };
    Failure::new(code, error.to_string())
}
