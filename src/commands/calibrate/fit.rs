//! `trifacet calibrate fit`: fits the head to measured points.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use trifacet::calibration::report::Report;
use trifacet::calibration::{self, Defaults, Measured, Record, Wanted, at_calibration, nominal, table};
use trifacet::clock::SystemClock;
use trifacet::clock::utc::Utc;
use trifacet::config::{self, Config, FORMAT, Model, RecordHeader, Tables, edit, fingerprint};
use trifacet::exit::{self, Failure};
use trifacet_core::time::Clock as _;
use trifacet_optics::calibration::fit::{FitError, Fitted, Job, Progress, Stage, fields, fit as fit_points};
use trifacet_optics::calibration::mistakes;
use trifacet_optics::calibration::parameters::Tolerances;
use trifacet_optics::calibration::result::RangeUncertainty;

use crate::commands::new_file::NewFile;
use crate::commands::translated;

/// Options of `calibrate fit`.
#[derive(Debug, clap::Args)]
pub(crate) struct FitArgs {
    /// Configuration of the head before the calibration
    #[arg(long, value_name = "IN.toml")]
    config: PathBuf,
    /// Table of measured points; may be given several times
    #[arg(long, value_name = "P.csv", required = true)]
    points: Vec<PathBuf>,
    /// Table of a scan of the steering with the mirror at rest; may be given several times
    #[arg(long, value_name = "S.csv")]
    scan: Vec<PathBuf>,
    /// Folder for the results; is created
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Refuse the result if the standard uncertainty of a translation over the range is larger, micrometres
    #[arg(long, value_name = "UM", value_parser = positive)]
    want_um: Option<f64>,
    /// Refuse the result if the standard uncertainty of an angle over the range is larger, microradians
    #[arg(long, value_name = "URAD", value_parser = positive)]
    want_urad: Option<f64>,
    /// Range of the translations, to both sides of the reference's zero, millimetres
    #[arg(long, value_name = "MM", default_value_t = 1.0, value_parser = positive)]
    range_mm: f64,
    /// Range of the angles, to both sides of the reference's zero, milliradians
    #[arg(long, value_name = "MRAD", default_value_t = 5.0, value_parser = positive)]
    range_mrad: f64,
    /// Standard uncertainty of the steering's readback where the tables do not state it, micrometres
    #[arg(long, value_name = "UM", default_value_t = 0.1, value_parser = positive)]
    readback_um: f64,
    /// Standard uncertainty of the scale of the steering's readback; needed if no point has a reference
    #[arg(long, value_name = "PERCENT", value_parser = positive)]
    steering_scale_percent: Option<f64>,
    /// The reference has another zero in each table of points
    #[arg(long)]
    own_zero: bool,
    /// Tolerances of the head as TOML, instead of the built-in ones
    #[arg(long, value_name = "FILE")]
    tolerances: Option<PathBuf>,
}

fn positive(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|x: &f64| x.is_finite() && *x > 0.0);
    number.ok_or_else(|| "allowed is a finite number above 0".to_owned())
}

/// The files of a calibration, in the order in which they are written: the configuration, which names the
/// others, is the last.
const FILES: [&str; 7] = [
    "psd-a.csv",
    "psd-b.csv",
    "psd-c.csv",
    "calibration.json",
    "report.json",
    "report.html",
    "trifacet.toml",
];

/// Fits the head, judges the fit, and writes the results.
pub(crate) fn fit(args: &FitArgs) -> anyhow::Result<()> {
    refuse_existing(&args.out)?;
    let config = translated(config::load(Some(&args.config))?)?;
    if config.estimation.model != Model::Gaussian {
        let why = "estimation.model = \"ray\" in the configuration: a calibration needs the Gaussian model";
        return Err(Failure::new(exit::CONFIG, why).into());
    }
    let wanted = Wanted {
        um: args.want_um,
        urad: args.want_urad,
        range_mm: args.range_mm,
        range_mrad: args.range_mrad,
    };
    let defaults = Defaults {
        spot: config.estimation.spot_noise_um * 1e-6,
        power: config.estimation.power_noise,
        readback: args.readback_um * 1e-6,
        own_zero: args.own_zero,
    };
    let mut measured = Measured::read(&args.points, &args.scan, defaults)?;
    let own = &measured.points[..measured.scans];
    calibration::before(own, &wanted, args.steering_scale_percent).map_err(|why| refused(&why))?;
    let nominal = nominal(&config)?;
    let regression = mistakes::check(&nominal, own).map_err(|why| refused(&why))?;
    let drift = measured.without_drift(&nominal);
    let own = &measured.points[..measured.scans];
    let tolerances = tolerances(args, own.iter().all(|p| p.reference.iter().all(Option::is_none)))?;
    let fields = fields();
    let job = Job { nominal: &nominal, tolerances: &tolerances, points: &measured.points, fields: &fields };
    let fitted = fit_points(job, show).map_err(|e| refused(&unfitted(&e)))?;
    let range =
        fitted.calibration.range_uncertainty(args.range_mm * 1e-3, args.range_mrad * 1e-3, RANGE_POSES);
    let mut verdict = calibration::verdict(&fitted, &measured.points, range.as_ref(), &wanted);
    verdict.warnings.extend(drift);
    show_dropped(&fitted, &measured);
    for warning in &verdict.warnings {
        say(&format!("warning: {warning}"));
    }
    let (Some(range), true) = (range, verdict.refusals.is_empty()) else {
        return Err(refused(&verdict.refusals.join("\n")).into());
    };
    let report = Report::new(&measured, &fitted, regression.as_ref(), &range, &verdict, &wanted);
    write(args, &config, (&fitted, measured.scans), &report, &range)?;
    say(&report.verdict);
    say(&format!("written to {}", args.out.display()));
    Ok(())
}

/// Number of poses over which the uncertainty is averaged.
const RANGE_POSES: usize = 200;

fn refused(why: &str) -> Failure {
    Failure::new(exit::DATA, format!("no calibration, nothing was written: {why}"))
}

/// Why there is no fit, with the more likely cause first.
fn unfitted(error: &FitError) -> String {
    match error {
        FitError::NotConverged { pointing: Some(pointing), steps } => format!(
            "the fit does not converge within {steps} steps: {}. If that is not the cause, the head is too far from \
             its tolerances",
            calibration::pointing_advice(pointing)
        ),
        _ => error.to_string(),
    }
}

fn refuse_existing(folder: &Path) -> Result<(), Failure> {
    let existing = FILES.iter().map(|name| folder.join(name)).find(|path| path.symlink_metadata().is_ok());
    existing.map_or(Ok(()), |path| {
        Err(Failure::new(exit::IO, format!("{} exists already: choose another folder", path.display())))
    })
}

fn tolerances(args: &FitArgs, no_reference: bool) -> anyhow::Result<Tolerances> {
    let mut tolerances = Tolerances::default();
    if let Some(file) = &args.tolerances {
        let text = fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
        tolerances = toml::from_str(&text)
            .map_err(|e| Failure::new(exit::CONFIG, format!("{}: {e}", file.display())))?;
        if let Some(wrong) = tolerances.wrong() {
            return Err(Failure::new(exit::CONFIG, format!("{}: {wrong}", file.display())).into());
        }
    }
    if args.steering_scale_percent.is_some() {
        tolerances.steering_scale_percent = args.steering_scale_percent;
    }
    if no_reference {
        // Nothing tells the frames: those of the configuration hold.
        (tolerances.frame_mm, tolerances.frame_mrad) = (1e-6, 1e-6);
    }
    Ok(tolerances)
}

fn show(progress: Progress) {
    say(&match progress {
        Progress::Step { stage, step, cost } => {
            let stage = match stage {
                Stage::First => "all points",
                Stage::Robust => "gross errors",
                Stage::Last => "points that remain",
            };
            format!("{stage}, step {step}: chi-square per row {cost:.4}")
        }
        Progress::Prior { field, ln_likelihood } => format!(
            "ripple of {:.1} um over {:.1} mm, knots of {:.2} mm: log likelihood {ln_likelihood:.1}",
            field.rms * 1e6,
            field.length * 1e3,
            field.knots * 1e3
        ),
    });
}

fn show_dropped(fitted: &Fitted, measured: &Measured) {
    for (point, why) in &fitted.dropped {
        say(&format!("{}: dropped: {}", measured.place(*point), calibration::report::reason(*why)));
    }
}

/// Standard error may be closed.
fn say(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

fn write(
    args: &FitArgs,
    config: &Config,
    (fitted, points): (&Fitted, usize),
    report: &Report,
    range: &RangeUncertainty,
) -> anyhow::Result<()> {
    let calibrated = &fitted.calibration;
    let now = SystemClock.now();
    let time = jiff::Timestamp::from_nanosecond(Utc::system().at(now, now).0.into())?;
    let date = time.strftime("%Y-%m-%dT%H:%M:%SZ").to_string();
    let tables = [0, 1, 2].map(|psd| table(calibrated, psd, &date));
    let text = fs::read_to_string(&args.config)?;
    let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
    let mut written = edit::edited(text, &calibration::edits(calibrated, config))?;
    if !written.ends_with('\n') {
        written.push('\n');
    }
    // Without a file, since its tables do not exist yet.
    let new = config::parse(&written, None).context("the calibrated configuration is not valid")?;
    let contents = Tables(tables.each_ref().map(|text| Some(text.as_bytes().to_vec())));
    let fits = fingerprint(&new, &new.channels(&contents)?);
    let micro = |from: usize| [0, 1, 2].map(|i| range.deviation[from + i] * 1e6);
    let header = RecordHeader {
        format: FORMAT,
        version: env!("CARGO_PKG_VERSION").to_owned(),
        date,
        method: report.method.clone(),
        fits,
        range_mm: args.range_mm,
        range_mrad: args.range_mrad,
        std_um: micro(0),
        std_urad: micro(3),
        expires: None,
        at_calibration: Some(at_calibration(&fitted.steering[..points], &report.parameters, config)),
    };
    let record = Record::new(header, calibrated, serde_json::to_value(report)?);
    let [a, b, c] = tables;
    let texts = [
        a,
        b,
        c,
        serde_json::to_string(&record)?,
        serde_json::to_string_pretty(report)? + "\n",
        report.html(),
        written,
    ];
    fs::create_dir_all(&args.out).with_context(|| format!("cannot create {}", args.out.display()))?;
    for (name, text) in FILES.iter().zip(texts) {
        NewFile::write(&args.out.join(name), text.as_bytes())?;
    }
    Ok(())
}
