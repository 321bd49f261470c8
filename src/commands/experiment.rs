//! `trifacet experiment`: the experiment of the paper, on the twin or with a running daemon and an operator
//! at the stage.

mod choices;
mod guided;
mod plausibility;
mod steps;

use std::fs::{self, File, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use trifacet::client::Endpoint;
use trifacet::config::{Axis, Config, SourceKind};
use trifacet::exit::{self, Failure};
use trifacet::experiment::protocol::{self, Protocol};
use trifacet::experiment::reading::{self, Part, Reading, Record};
use trifacet::experiment::report::Report;
use trifacet::experiment::static_record::LEAST;
use trifacet::experiment::table::{self, Table};
use trifacet::experiment::twin::{Bench, beyond};

use super::{ConfigArg, within, written};

/// Options of `experiment`.
#[derive(Debug, clap::Args)]
pub(crate) struct ExperimentArgs {
    #[command(flatten)]
    config: ConfigArg,
    /// Folder for report.html, table2.csv and readings.csv
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Seed of the twin, instead of that of the configuration; the same seed gives the same files
    #[arg(long, value_name = "N", value_parser = within(0_u64..=1 << 53))]
    seed: Option<u64>,
    /// Take readings from a running daemon, point by point, with an operator at the stage
    #[arg(long, value_name = "HOST:PORT", value_parser = choices::endpoint, conflicts_with_all = ["config", "seed", "paper_only"])]
    connect: Option<Endpoint>,
    /// Continue with the readings in --out; only with --connect
    #[arg(long)]
    resume: bool,
    /// Make the report again from stored readings
    #[arg(long, value_name = "READINGS.csv", conflicts_with_all = [
        "config", "seed", "connect", "reference", "axes", "points", "interval", "readings", "average", "rest", "paper_only",
    ])]
    from: Option<PathBuf>,
    /// Readings of an interferometer at each point, columns axis,unit,point,reference. With --connect they
    /// are the reference; on the twin they are the positions of the mirror
    #[arg(long, value_name = "FILE.csv", conflicts_with_all = ["points", "interval"])]
    reference: Option<PathBuf>,
    /// Axes to move, such as tx,yaw; by default all
    #[arg(long, value_name = "AXES", value_delimiter = ',', value_parser = choices::axis)]
    axes: Vec<Axis>,
    /// Number of points of each axis, around the middle
    #[arg(long, value_name = "N", default_value_t = protocol::POINTS, value_parser = within(3_u32..=10_000))]
    points: u32,
    /// Interval of an axis in um or urad, such as tx=0.5,roll=10; by default that of the paper
    #[arg(long, value_name = "AXIS=X", value_delimiter = ',', value_parser = choices::interval)]
    interval: Vec<(Axis, f64)>,
    /// Number of readings at each point
    #[arg(long, value_name = "N", default_value_t = protocol::READINGS, value_parser = within(2_u32..=100_000))]
    readings: u32,
    /// Number of values averaged in each reading: samples on the twin, poses with --connect
    #[arg(long, value_name = "N", value_parser = within(1_u16..=10_000))]
    average: Option<u16>,
    /// Duration of the record at rest, for the Allan deviation, in seconds; 0: no record
    #[arg(long, value_name = "SECONDS", default_value_t = 60.0, value_parser = choices::seconds)]
    rest: f64,
    /// On the twin: omit the second run, which is not in the paper
    #[arg(long)]
    paper_only: bool,
}

/// Takes the readings, or reads stored ones, and writes the report.
pub(crate) fn experiment(args: &ExperimentArgs) -> anyhow::Result<()> {
    if args.resume && args.connect.is_none() {
        let message = "--resume continues readings of a running daemon and requires --connect HOST:PORT; \
            on the twin, start again: the same seed gives the same readings";
        return Err(Failure::new(exit::USAGE, message).into());
    }
    let new = !args.out.exists();
    let done = claimed(&args.out).and_then(|_claim| made(args));
    if new && done.is_err() {
        let _ = fs::remove_dir(&args.out); // succeeds only if the folder is empty
    }
    done
}

fn made(args: &ExperimentArgs) -> anyhow::Result<()> {
    if let Some(file) = &args.from {
        return from(file, &args.out);
    }
    let protocol = choices::protocol(args)?;
    if let Some(endpoint) = &args.connect {
        return write_report(&guided::guided(args, endpoint, &protocol)?, &args.out);
    }
    let config = twin(args)?;
    fresh(&args.out)?;
    let source = format!("digital twin, seed {}", config.twin.seed);
    let readings = on_twin(&config, &protocol, args)?;
    let record = Record { source, options: options(&protocol, config.estimation.average), readings };
    keep(&record, &args.out)?;
    write_report(&record, &args.out)
}

/// The options as text. Readings with different options must not be combined.
fn options(protocol: &Protocol, average: u16) -> String {
    format!("{protocol}, {average} averaged into each reading")
}

/// Makes the report of stored readings: in their folder, or in another one together with a copy.
fn from(file: &Path, out: &Path) -> anyhow::Result<()> {
    let mut record = reading::read(file)?;
    if record.source.is_empty() {
        record.source = format!("readings of {}", file.display());
    }
    let own = out.join(READINGS);
    let same = own.exists() && fs::canonicalize(&own).ok() == fs::canonicalize(file).ok();
    if !same {
        fresh(out)?;
        keep(&record, out)?;
    }
    write_report(&record, out)
}

/// The configuration of the twin with the options applied.
fn twin(args: &ExperimentArgs) -> anyhow::Result<Config> {
    let mut config = args.config.load()?;
    if config.acquisition.source != SourceKind::Twin {
        let message = "the source of the configuration is not the twin (acquisition.source): run the daemon with \
            this configuration, and take its readings with --connect HOST:PORT";
        return Err(Failure::new(exit::CONFIG, message).into());
    }
    config.twin.seed = args.seed.unwrap_or(config.twin.seed);
    config.estimation.average = args.average.unwrap_or(config.estimation.average);
    let poses = args.rest * config.acquisition.rate_hz / f64::from(config.estimation.average);
    long_enough(args.rest, poses)?;
    Ok(config)
}

/// Checks that a record at rest of this duration has enough poses, or that none is requested.
fn long_enough(seconds: f64, poses: f64) -> Result<(), Failure> {
    if seconds == 0.0 || poses >= LEAST as f64 {
        return Ok(());
    }
    let message =
        format!("--rest {seconds} gives {poses:.0} poses: at least {LEAST} are needed, or --rest 0");
    Err(Failure::new(exit::USAGE, message))
}

fn on_twin(config: &Config, protocol: &Protocol, args: &ExperimentArgs) -> anyhow::Result<Vec<Reading>> {
    let parts = if args.paper_only { 1 } else { 2 };
    let bar = bar(parts * protocol.total());
    let mut taken = || bar.inc(1);
    let mut bench = Bench::new(config)?;
    let mut readings = bench.measure(protocol, Part::Table2, &mut taken)?;
    if !args.paper_only {
        readings.extend(Bench::new(&beyond(config))?.measure(protocol, Part::Beyond, &mut taken)?);
    }
    bar.set_message("at rest");
    readings.extend(bench.rest(args.rest)?);
    bar.finish_and_clear();
    Ok(readings)
}

/// A progress bar on standard error, if it is a terminal.
fn bar(length: u64) -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} readings {msg}");
    ProgressBar::new(length).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

const READINGS: &str = "readings.csv";

/// Opens the folder and locks it for this session, as long as the result is kept.
pub(super) fn claimed(out: &Path) -> anyhow::Result<File> {
    fs::create_dir_all(out).with_context(|| format!("cannot create the folder {}", out.display()))?;
    let folder = File::open(out).with_context(|| format!("cannot open the folder {}", out.display()))?;
    match folder.try_lock() {
        Err(TryLockError::WouldBlock) => {
            let message = format!("another session uses {}: choose another folder with --out", out.display());
            Err(Failure::new(exit::IN_USE, message).into())
        }
        // The file system does not support locks: continue without one.
        Ok(()) | Err(TryLockError::Error(_)) => Ok(folder),
    }
}

/// Checks before the measurement that no file will be overwritten.
pub(super) fn fresh(out: &Path) -> anyhow::Result<()> {
    let mut inside =
        fs::read_dir(out).with_context(|| format!("cannot open the folder {}", out.display()))?;
    if inside.next().is_some() {
        let message = format!(
            "{} is not empty, and its files are not overwritten: choose a new folder with --out",
            out.display()
        );
        return Err(Failure::new(exit::IO, message).into());
    }
    Ok(())
}

/// Stores all readings. The file is replaced atomically, so it is always complete.
fn keep(record: &Record, out: &Path) -> anyhow::Result<()> {
    let (file, new) = (out.join(READINGS), out.join(".readings.new"));
    let kept = File::create(&new).and_then(|to| {
        reading::write(record, &to)?;
        to.sync_all()?;
        fs::rename(&new, &file)
    });
    if kept.is_err() {
        let _ = fs::remove_file(&new); // the file may not exist yet
    }
    kept.with_context(|| format!("cannot write {}", file.display()))
}

/// Writes table and report, and prints the table.
fn write_report(record: &Record, out: &Path) -> anyhow::Result<()> {
    let report = Report::new(&record.readings, record.source.clone())?;
    let put = |name: &str, text: &str| {
        let file = out.join(name);
        fs::write(&file, text).with_context(|| format!("cannot write {}", file.display()))
    };
    if let Some(why) = report.rest.as_ref().and_then(|rest| rest.uneven.as_ref()) {
        eprintln!("no Allan deviation: {why}");
    }
    put("table2.csv", &table::csv(&report.table2))?;
    put("report.html", &report.html())?;
    let mut stdout = io::stdout().lock();
    written(write!(stdout, "{}", Table(&report.table2)))?;
    if !report.beyond.is_empty() {
        written(write!(stdout, "\nbeyond the paper:\n{}", Table(&report.beyond)))?;
    }
    written(writeln!(stdout, "\n{}", out.join("report.html").display()))
}
