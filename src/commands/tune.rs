//! `trifacet tune`: identifies the loop on the live system and writes the results into the configuration.

mod plot;
mod report;
mod show;

use std::fs::OpenOptions;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context;
use report::Report;
use show::Show;
use tokio::sync::{mpsc, watch};
use tokio::task::LocalSet;
use tokio_util::sync::CancellationToken;
use trifacet::acquisition::{BoardSource, LabjackSource, Source};
use trifacet::clock::SystemClock;
use trifacet::config::{Config, SourceKind, edit};
use trifacet::exit::{self, Failure};
use trifacet::identification::findings::Findings;
use trifacet::identification::observation::Observer;
use trifacet::identification::plan::{Choices, Settings};
use trifacet::identification::record::Recording;
use trifacet::identification::task;
use trifacet::steering::{self, Stage};
use trifacet::twin::{Twin, TwinSource};
use trifacet::{acquisition, realtime};
use trifacet_core::pipeline::Mapping;
use trifacet_core::steering::StagePosition;
use trifacet_core::telemetry::Counters;

use super::{ConfigArg, interrupted, within, written};

/// Number of samples that may wait for the identification.
const QUEUE: usize = 1024;

/// Options of `tune`.
#[derive(Debug, clap::Args)]
pub(crate) struct TuneArgs {
    #[command(flatten)]
    config: ConfigArg,
    /// Length of a step; by default 20 um, or less if the beam or the stage requires it
    #[arg(long, value_name = "UM", value_parser = positive)]
    step: Option<f64>,
    /// Number of steps of each axis, back and forth
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = within(10_u32..=10_000))]
    steps: u32,
    /// Time that the stage rests after each step; by default ten times the sum of the configured delay and
    /// lag, at least 50 ms
    #[arg(long, value_name = "MS", value_parser = positive)]
    dwell: Option<f64>,
    /// Position of a stage without readback; the stage is sent there first
    #[arg(long, value_name = "X_UM,Y_UM", value_parser = position, allow_hyphen_values = true)]
    at: Option<StagePosition>,
    /// Draw the response to the steps into a file
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    /// Write an origin beyond tune.origin_limit_um: the laser is known to be displaced, not a PSD
    #[arg(long)]
    accept_origin: bool,
    /// Print the results and do not change the file
    #[arg(long)]
    print: bool,
    /// Only print what would be done
    #[arg(long)]
    dry_run: bool,
}

/// Measures, reports the results, and writes them into the file of `--config` if they are reliable.
pub(crate) fn tune(args: &TuneArgs) -> anyhow::Result<()> {
    let config = args.config.load()?;
    let file = args.config.path().filter(|_| !args.print);
    can_be_written(file, args.plot.as_deref())?;
    let Some(recording) = measure(&config, args)? else { return Ok(()) };
    let findings = Findings::new(&recording, 1.0 / config.acquisition.rate_hz)?;
    let report = Report { config: &config, plan: &recording.plan, findings: &findings };
    eprint!("{report}");
    // The results are stored even if the plot fails.
    let drawn = args.plot.as_deref().map_or(Ok(()), |file| draw(file, &findings, &recording));
    let kept = keep(file, &findings, &report, args.accept_origin);
    if let (Err(error), Err(_)) = (&drawn, &kept) {
        eprintln!("{error:#}");
    }
    kept.and(drawn)
}

/// Checks, before anything moves, that the results can be written.
fn can_be_written(file: Option<&Path>, plot: Option<&Path>) -> anyhow::Result<()> {
    if let Some(file) = file {
        edit::check(file).with_context(|| format!("cannot write into {}", file.display()))?;
    }
    if let Some(plot) = plot {
        let new = !plot.exists();
        let opened = OpenOptions::new().append(true).create(true).open(plot).map(drop);
        let left = opened.and_then(|()| if new { std::fs::remove_file(plot) } else { Ok(()) });
        left.with_context(|| format!("cannot write the plot to {}", plot.display()))?;
    }
    Ok(())
}

fn draw(file: &Path, findings: &Findings, recording: &Recording) -> anyhow::Result<()> {
    std::fs::write(file, plot::svg(findings, &recording.plan))
        .with_context(|| format!("cannot write the plot to {}", file.display()))?;
    eprintln!("plot: {}", file.display());
    Ok(())
}

/// Prints the keys and writes them, if the results are reliable.
fn keep(
    file: Option<&Path>,
    findings: &Findings,
    report: &Report,
    accept_origin: bool,
) -> anyhow::Result<()> {
    if !findings.doubts.is_empty() {
        let why = findings.doubts.join("\n");
        return Err(Failure::new(
            exit::DATA,
            format!("nothing is written, because the results are not reliable:\n{why}"),
        )
        .into());
    }
    if !accept_origin && let Some(doubt) = report.origin_doubt()? {
        return Err(Failure::new(exit::DATA, format!("nothing is written: {doubt}")).into());
    }
    let edits = report.edits()?;
    written(write!(io::stdout(), "{}", edit::edited("", &edits)?))?;
    file.map_or(Ok(()), |file| write(file, &edits))
}

fn write(file: &Path, edits: &[edit::Edit]) -> anyhow::Result<()> {
    edit::write(file, edits).with_context(|| format!("cannot write into {}", file.display()))?;
    eprintln!("written to {}", file.display());
    Ok(())
}

fn measure(config: &Config, args: &TuneArgs) -> anyhow::Result<Option<Recording>> {
    let counters = Arc::new(Counters::default());
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    realtime::apply(&config.realtime);
    match config.acquisition.source {
        SourceKind::Board | SourceKind::Serial => {
            let source = BoardSource::open(config, SystemClock, Arc::clone(&counters))?;
            LocalSet::new().block_on(&runtime, with(|| Ok(source), config, args, counters))
        }
        SourceKind::Labjack => {
            let source = LabjackSource::new(config, SystemClock, Arc::clone(&counters));
            LocalSet::new().block_on(&runtime, with(|| Ok(source), config, args, counters))
        }
        SourceKind::Replay => {
            let why = "acquisition.source = \"replay\": a recording cannot be measured again";
            Err(Failure::new(exit::CONFIG, why).into())
        }
        SourceKind::Twin => {
            let twin = Twin::new(config)?;
            let counted = Arc::clone(&counters);
            let silence = config.acquisition.silence_times();
            let source = || TwinSource::new(twin, SystemClock, counted, silence);
            LocalSet::new().block_on(&runtime, with(source, config, args, counters))
        }
    }
}

/// Connects the tasks of the daemon's fast thread, with the identification in place of the loop.
async fn with<S: Source + 'static>(
    source: impl FnOnce() -> io::Result<S>,
    config: &Config,
    args: &TuneArgs,
    counters: Arc<Counters>,
) -> anyhow::Result<Option<Recording>> {
    let (samples_in, samples) = mpsc::channel(QUEUE);
    // The limits do not change in the meantime, so the sender can be dropped.
    let limits = watch::channel(config.steering.clone()).1;
    let Stage { driver, task: stage, outputs } = steering::configured(config, limits)?;
    let stop_acquisition = CancellationToken::new();
    let acquisition = tokio::task::spawn_local(acquisition::task::run(
        source().context("cannot start the source")?,
        Mapping::new(config.read_channels()?),
        SystemClock,
        Arc::clone(&counters),
        acquisition::task::AcquisitionLinks {
            samples: samples_in,
            newest: watch::Sender::default(),
            outputs,
            down: watch::Sender::default(),
            changes: mpsc::channel(1).1,
        },
        stop_acquisition.clone(),
    ));
    let observer = Observer::new(config)?;
    let choices = Choices {
        step: args.step.map(|um| um * 1e-6),
        steps: args.steps,
        dwell: args.dwell.map(|ms| ms * 1e-3),
        at: args.at,
    };
    let settings = Settings::new(config, observer.beam_sigma(), choices);
    let links = task::IdentificationLinks { samples, stop: interrupted()? };
    let mut show = Show::new(args.dry_run);
    if let Some(stage) = stage {
        tokio::task::spawn_local(async move { stage.run(&counters).await });
    }
    let result = task::run(settings, observer, driver, SystemClock, links, &mut show).await;
    show.end();
    stop_acquisition.cancel();
    acquisition.await.context("the task acquisition failed at the end")?;
    Ok(result?)
}

/// Why the value of an option is not valid.
#[derive(Debug, thiserror::Error)]
enum OptionError {
    /// A length or a time.
    #[error("must be a number above 0, at most 1000000")]
    Positive,
    /// A position of the stage.
    #[error("must be two numbers, such as -12.5,30")]
    Position,
}

fn positive(text: &str) -> Result<f64, OptionError> {
    match text.parse() {
        Ok(number) if number > 0.0 && number <= 1e6 => Ok(number),
        _ => Err(OptionError::Positive),
    }
}

fn position(text: &str) -> Result<StagePosition, OptionError> {
    let two = text.split_once(',').and_then(|(x, y)| x.trim().parse().ok().zip(y.trim().parse().ok()));
    match two {
        Some((x, y)) if f64::is_finite(x) && f64::is_finite(y) => Ok(StagePosition([x * 1e-6, y * 1e-6])),
        _ => Err(OptionError::Position),
    }
}
