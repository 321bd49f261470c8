//! `trifacet calibrate run`: measures the planned poses.

mod answer;
mod folder;
mod lines;
mod program;
mod reference;
mod scan;
mod session;

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Context;
use folder::RunFolder;
use reference::{Reference, ReferenceKind};
use session::{Outcome, Session};
use tokio::sync::{mpsc, watch};
use tokio::task::LocalSet;
use trifacet::acquisition::{BoardSource, LabjackSource, Source};
use trifacet::calibration::bench::{Bench, Links};
use trifacet::calibration::pose_list;
use trifacet::clock::SystemClock;
use trifacet::clock::simulated::SimulatedClock;
use trifacet::config::{self, Config, SourceKind};
use trifacet::core::time::Clock;
use trifacet::exit::{self, Failure};
use trifacet::realtime;
use trifacet::recording::{self, RecordSender};
use trifacet::steering::{self, Stage};
use trifacet::twin::moves::Moves;
use trifacet::twin::{Twin, TwinSource};
use trifacet_core::telemetry::Counters;
use trifacet_optics::calibration::plan::Planned;

use super::ReferenceArgs;
use crate::commands::{ConfigArg, interrupted, within};

/// Moves of the twin that may wait.
const MOVES: usize = 1;

/// Options of `calibrate run`.
#[derive(Debug, clap::Args)]
#[command(after_help = HELP)]
pub(crate) struct RunArgs {
    #[command(flatten)]
    config: ConfigArg,
    /// The poses, as written by `calibrate plan`
    #[arg(long, value_name = "FILE.csv")]
    plan: PathBuf,
    /// Folder for points.csv, scan.csv, scan-end.csv and the recording
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Continue an interrupted run in --out
    #[arg(long)]
    resume: bool,
    /// Where the measured pose of each point comes from; by default the twin's own mirror with
    /// acquisition.source = "twin", otherwise manual
    #[arg(long, value_name = "KIND", value_parser = reference::kind)]
    reference: Option<ReferenceKind>,
    #[command(flatten)]
    noise: ReferenceArgs,
    /// Time after which a pose that does not come to rest is given up, seconds
    #[arg(long, value_name = "S", default_value_t = 30.0, value_parser = within(0.1..=86_400.0))]
    rest_timeout: f64,
    /// Time after which the program of --reference command is ended, seconds
    #[arg(long, value_name = "S", default_value_t = 120.0, value_parser = within(0.1..=86_400.0))]
    command_timeout: f64,
    /// The program of --reference command, with its arguments
    #[arg(last = true, value_name = "PROGRAM")]
    program: Vec<String>,
}

const HELP: &str = "\
Kinds of reference:
  manual        each pose is shown; Enter or \"ok\" states that the mirror is there, or six typed numbers state where it
                is (um, urad; - for a coordinate that is not measured)
  file:PATH     line k of the file is the pose of point k (m, rad); the line appears when the mirror is there
  pipe:PATH     each pose is printed to standard output as kind and six coordinates (m, rad); the answer is one line
                of the pipe, six numbers (m, rad), when the mirror is there; PATH - is standard input
  command       for each pose, the program after -- is run; {point}, {kind}, {tx_m}, {ty_m}, {tz_m}, {roll_rad},
                {pitch_rad} and {yaw_rad} in its arguments are replaced; the last line that it prints is the pose (m, rad)
  twin          the mirror of the twin moves to each pose; the reference is its true pose with the stated noise";

/// Measures all poses of the plan that the folder does not contain yet.
pub(crate) fn run(args: &RunArgs) -> anyhow::Result<()> {
    let config = args.config.load()?;
    let kind = reference_kind(args, &config)?;
    let plan = pose_list::read(&args.plan)?;
    let new = !args.out.exists();
    let claim = crate::commands::experiment::claimed(&args.out)?;
    let done =
        RunFolder::open(args, &config).and_then(|folder| measured(args, &config, &plan, &kind, folder));
    drop(claim);
    if new && done.is_err() {
        let _ = std::fs::remove_dir(&args.out); // succeeds only if the folder is empty
    }
    done?.into_result()
}

/// The kind of reference: stated, or by the source.
fn reference_kind(args: &RunArgs, config: &Config) -> Result<ReferenceKind, Failure> {
    let twin = config.acquisition.source == SourceKind::Twin;
    let kind =
        args.reference.clone().unwrap_or(if twin { ReferenceKind::Twin } else { ReferenceKind::Manual });
    let wrong = |code, what: &str| Err(Failure::new(code, what));
    match (&kind, config.acquisition.source) {
        (_, SourceKind::Replay) => {
            wrong(exit::CONFIG, "acquisition.source = \"replay\": a recording cannot be measured again")
        }
        (ReferenceKind::Twin, SourceKind::Board | SourceKind::Serial | SourceKind::Labjack) => {
            wrong(exit::USAGE, "--reference twin requires acquisition.source = \"twin\"")
        }
        (ReferenceKind::Command, _) if args.program.is_empty() => wrong(
            exit::USAGE,
            "--reference command requires a program: --reference command -- PROGRAM ARG...",
        ),
        (ReferenceKind::Command, _) => Ok(kind),
        _ if !args.program.is_empty() => {
            wrong(exit::USAGE, "a program after -- requires --reference command")
        }
        _ => Ok(kind),
    }
}

/// Connects the source, and measures.
fn measured(
    args: &RunArgs,
    config: &Config,
    plan: &[Planned],
    kind: &ReferenceKind,
    folder: RunFolder,
) -> anyhow::Result<Outcome> {
    let counters = Arc::<Counters>::default();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let recording =
        config::RecordingConfig { folder: args.out.join("recording"), ..config.recording.clone() };
    let recording = config::RecordingConfig { mode: config::RecordingMode::Always, ..recording };
    let (records, handle, recorder) =
        recording::recorder::start(&recording, &counters).context("cannot start the recorder")?;
    realtime::apply(&config.realtime);
    let job = Job { args, config, plan, folder, records, counters: Arc::clone(&counters) };
    let result = if config.acquisition.source == SourceKind::Twin {
        // In simulated time: as fast as the machine computes, and with the same result each time.
        let (clock, silence) = (SimulatedClock::starting_now(), config.acquisition.silence_times());
        let (moves, requests) = mpsc::channel(MOVES);
        let source = TwinSource::new(Twin::new(config)?, clock.clone(), Arc::clone(&counters), silence);
        let source = source.context("cannot start the source")?.with_moves(Moves::new(requests));
        let seed = config.twin.seed + job.folder.done.len() as u64;
        let reference = match kind {
            ReferenceKind::Twin => Reference::twin(moves, seed, args.noise.noise()),
            other => Reference::of(args, other)?,
        };
        LocalSet::new().block_on(&runtime, job.run(source, clock, reference))
    } else if config.acquisition.source == SourceKind::Labjack {
        let source = LabjackSource::new(config, SystemClock, Arc::clone(&counters));
        LocalSet::new().block_on(&runtime, job.run(source, SystemClock, Reference::of(args, kind)?))
    } else {
        let source = BoardSource::open(config, SystemClock, Arc::clone(&counters))?;
        LocalSet::new().block_on(&runtime, job.run(source, SystemClock, Reference::of(args, kind)?))
    };
    recorder.join();
    let lost = counters.recording_overflows.get() + counters.recording_lost.get();
    if lost > 0 {
        eprintln!("the recording is incomplete: {lost} entries are missing; points.csv is not affected");
    }
    if let Some(why) = handle.state.tell()["fault"].as_str() {
        eprintln!("the recording failed: {why}; points.csv is not affected");
    }
    result
}

/// What a run needs besides its source.
struct Job<'a> {
    args: &'a RunArgs,
    config: &'a Config,
    plan: &'a [Planned],
    folder: RunFolder,
    records: RecordSender,
    counters: Arc<Counters>,
}

impl Job<'_> {
    /// Runs the session. The stage is parked in every case.
    async fn run<S: Source, C: Clock>(
        self,
        source: S,
        clock: C,
        reference: Reference,
    ) -> anyhow::Result<Outcome> {
        let Self { args, config, plan, folder, records, counters } = self;
        // The limits do not change in the meantime, so the sender can be dropped.
        let limits = watch::channel(config.steering.clone()).1;
        let Stage { driver, task, outputs } = steering::configured(config, limits)?;
        if let Some(task) = task {
            tokio::task::spawn_local(async move { task.run(&counters).await });
        }
        let simulated = config.acquisition.source == SourceKind::Twin;
        let links =
            Links { source, clock, stage: (driver, outputs), records, stop: interrupted()?, simulated };
        let mut session = Session::new(args, config, plan, Bench::new(config, links)?, reference, folder)?;
        let done = session.all().await;
        let (outcome, bench) = session.into_parts();
        if let Some((position, complaint)) = bench.finish().await {
            let [x, y] = position.map(|metres| metres * 1e6);
            match complaint {
                None => eprintln!("the stage is parked at {x:.1} {y:.1} um"),
                Some(complaint) => eprintln!("the stage was sent to {x:.1} {y:.1} um, but {complaint}"),
            }
        }
        done.map_err(|e| outcome.explain(e))?;
        Ok(outcome)
    }
}
