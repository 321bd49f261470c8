//! The fast thread: acquisition, centering and estimation with their channels, or a replay in their place.

use std::io;
use std::sync::Arc;
use std::thread::JoinHandle;

use anyhow::Context;
use tokio::runtime::Builder;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::task::{self, LocalSet};
use tokio_util::sync::CancellationToken;
use trifacet_core::centering::lock::LockCondition;
use trifacet_core::estimation::PoseReport;
use trifacet_core::pipeline::Pipeline;
use trifacet_core::telemetry::heartbeat::{Heartbeats, Task, counted};
use trifacet_core::telemetry::{CommandGauge, Counters, LatestStatus};
use trifacet_wire::stream::Descriptor;

use crate::acquisition::{BoardSource, LabjackSource, Source, SourceError};
use crate::clock::SystemClock;
use crate::config::{CalibrationContext, Config, RealtimeConfig, SourceKind};
use crate::control::FastLink;
use crate::doubts::Doubter;
use crate::estimation::warnings::Warnings;
use crate::exit::{self, Failure};
use crate::publishing::Publisher;
use crate::publishing::descriptor::calibration_entry;
use crate::recording::{Entry, EstimationRecorder, RecordSender};
use crate::replay::{self, RecordingHeader};
use crate::steering::{OutputLink, StageDriver};
use crate::twin::moves::Moves;
use crate::twin::{MoveRequest, Twin, TwinSource};
use crate::{acquisition, centering, estimation, realtime};

/// Samples that can wait for estimation.
const QUEUE: usize = 1024;

/// Everything the fast thread needs.
pub(super) struct Parts {
    pub(super) config: Config,
    pub(super) pipeline: Pipeline,
    /// The driver of the stage, and the outputs on the side of the source; without use in a replay.
    pub(super) stage: (StageDriver, OutputLink),
    pub(super) publisher: Publisher<SystemClock>,
    pub(super) counters: Arc<Counters>,
    pub(super) heartbeats: Arc<Heartbeats>,
    pub(super) glance: Arc<LatestStatus>,
    /// The lock state and its cause; stays `None` in a replay, which has no loop.
    pub(super) lock: watch::Sender<Option<LockCondition>>,
    /// Why the source is down.
    pub(super) source_down: watch::Sender<Option<SourceError>>,
    pub(super) control: FastLink,
    pub(super) context: Arc<CalibrationContext>,
    /// The beginning of the recording, if that is the source.
    pub(super) header: Option<RecordingHeader>,
    pub(super) descriptor: watch::Sender<Descriptor>,
    pub(super) records: RecordSender,
    pub(super) commands: Arc<CommandGauge>,
    pub(super) doubter: Doubter,
    pub(super) stop: CancellationToken,
}

/// The fast thread, and the result of its tasks: an error if a task ended by itself.
pub(super) struct Fast {
    pub(super) thread: JoinHandle<()>,
    pub(super) ended: oneshot::Receiver<anyhow::Result<()>>,
}

/// Starts the fast thread with the source of the configuration.
pub(super) fn start(parts: Parts) -> anyhow::Result<Fast> {
    let counters = Arc::clone(&parts.counters);
    match parts.config.acquisition.source {
        SourceKind::Twin => {
            let twin = Twin::new(&parts.config).map_err(|e| Failure::new(exit::CONFIG, e.to_string()))?;
            let silence = parts.config.acquisition.silence_times();
            let source = move |moves| {
                Ok(TwinSource::new(twin, SystemClock, counters, silence)?.with_moves(Moves::new(moves)))
            };
            start_fast(parts.config.realtime.clone(), || fast(parts, source))
        }
        SourceKind::Replay => start_fast(parts.config.realtime.clone(), || replayed(parts)),
        SourceKind::Labjack => {
            let source = LabjackSource::new(&parts.config, SystemClock, counters);
            start_fast(parts.config.realtime.clone(), || fast(parts, |_| Ok(source)))
        }
        SourceKind::Board | SourceKind::Serial => {
            let source = BoardSource::open(&parts.config, SystemClock, counters)?;
            start_fast(parts.config.realtime.clone(), || fast(parts, |_| Ok(source)))
        }
    }
}

fn start_fast<F: Future<Output = anyhow::Result<()>>>(
    realtime: RealtimeConfig,
    tasks: impl FnOnce() -> F + Send + 'static,
) -> anyhow::Result<Fast> {
    let (end, ended) = oneshot::channel();
    let thread = std::thread::Builder::new().name("fast".into()).spawn(move || {
        realtime::apply(&realtime);
        let result = Builder::new_current_thread()
            .enable_all()
            .build()
            .context("cannot start the fast runtime")
            .and_then(|runtime| {
                let result = LocalSet::new().block_on(&runtime, tasks());
                runtime.shutdown_background(); // do not wait for the attempt to connect to a board
                result
            });
        // The receiver is gone if the main thread has given up waiting.
        let _ = end.send(result);
    });
    Ok(Fast { thread: thread.context("cannot start the fast thread")?, ended })
}

/// Runs the three tasks. Returns when `stop` is cancelled, or with an error when a task ends by itself.
async fn fast<S: Source + 'static>(
    parts: Parts,
    source: impl FnOnce(mpsc::Receiver<MoveRequest>) -> io::Result<S>,
) -> anyhow::Result<()> {
    let Parts { config, pipeline, stage: (driver, outputs), mut publisher, source_down, .. } = parts;
    let Parts {
        counters,
        heartbeats,
        glance,
        lock,
        control,
        stop,
        context,
        records,
        commands: gauge,
        doubter,
        ..
    } = parts;
    let FastLink { changes, questions, orders, moves } = control;
    let source = source(moves).context("cannot start the source")?;
    let (mapping, centering, estimation) = pipeline.into_parts();
    let (samples_in, samples) = mpsc::channel(QUEUE);
    let (newest_in, newest) = watch::channel(None);
    let (state_in, steering) = watch::channel(centering.state());
    let steering = estimation::loop_liveness::LoopLiveness::new(steering, Arc::clone(&heartbeats));
    let (poses_in, poses) = watch::channel(None);
    let stop_acquisition = CancellationToken::new();

    let acquisition = spawn(
        acquisition::task::run(
            source,
            mapping,
            SystemClock,
            Arc::clone(&counters),
            acquisition::task::AcquisitionLinks {
                samples: samples_in,
                newest: newest_in,
                outputs,
                down: source_down,
                changes,
            },
            stop_acquisition.clone(),
        ),
        &heartbeats,
        Task::Acquisition,
    );
    let centering = spawn(
        centering::run(
            centering,
            driver,
            SystemClock,
            counters,
            centering::CenteringLinks {
                newest,
                poses,
                state: state_in,
                lock,
                orders,
                records: records.clone(),
                commands: gauge,
                doubter: doubter.clone(),
                silence: config.acquisition.silence_times().first,
            },
            stop.clone(),
        ),
        &heartbeats,
        Task::Centering,
    );
    let warnings = Warnings::new(&context, doubter);
    let recorder = EstimationRecorder::new(records.clone(), context);
    let publish = move |report: &PoseReport| {
        let frame = publisher.publish(report);
        let (time, covariance) = (report.time, report.covariance);
        records.put(|| Entry::Frame { frame, time, covariance });
        glance.at(report);
    };
    let estimation = spawn(
        estimation::run(
            estimation,
            config.acquisition.rate_hz,
            config.acquisition.silence(),
            SystemClock,
            estimation::EstimationLinks {
                samples,
                questions,
                steering,
                newest: poses_in,
                publish,
                recorder,
                warnings,
            },
        ),
        &heartbeats,
        Task::Estimation,
    );

    until_stopped([acquisition, centering, estimation], &stop, &stop_acquisition).await
}

/// Waits for `stop`, then for the tasks: acquisition, centering, estimation. Fails when one of them ends by itself.
async fn until_stopped(
    [mut acquisition, mut centering, mut estimation]: [task::JoinHandle<()>; 3],
    stop: &CancellationToken,
    stop_acquisition: &CancellationToken,
) -> anyhow::Result<()> {
    let ended = tokio::select! {
        biased;
        () = stop.cancelled() => None,
        end = &mut centering => Some(("centering", end)),
        end = &mut acquisition => Some(("acquisition", end)),
        end = &mut estimation => Some(("estimation", end)),
    };
    if let Some((task, end)) = ended {
        return Err(ended_by_itself(task, end));
    }
    // In order: centering sends the last command to the stage while acquisition can still transmit it. Then
    // acquisition ends, which closes the channel of samples; this ends estimation.
    centering.await.context("task centering failed while stopping")?;
    stop_acquisition.cancel();
    acquisition.await.context("task acquisition failed while stopping")?;
    estimation.await.context("task estimation failed while stopping")
}

fn ended_by_itself(task: &str, end: Result<(), task::JoinError>) -> anyhow::Error {
    let why = end.err().map_or_else(|| "it returned".into(), |e| e.to_string());
    Failure::new(exit::SOFTWARE, format!("task {task} ended by itself: {why}")).into()
}

/// Runs one task in place of the three: it replays a recording.
async fn replayed(parts: Parts) -> anyhow::Result<()> {
    let Parts { config, pipeline, mut publisher, counters, glance, heartbeats, .. } = parts;
    let Parts { control, stop, descriptor, header, .. } = parts;
    let header = header.context("there is no recording")?;
    let publish = move |republished: &replay::republisher::Republished| {
        publisher.publish_of(&republished.report, republished.time_ns, republished.synced);
        glance.at(&republished.report);
    };
    let means = move |context: &CalibrationContext| {
        descriptor.send_modify(|now| {
            (now.config, now.calibrated) = (context.id(), context.calibrated());
            now.uncalibrated = context.calibration.objection();
            let expires_days = context.config.calibration.expires_days;
            now.calibration = calibration_entry(&context.calibration, expires_days);
        });
    };
    let links = replay::task::ReplayLinks { control, publish, means };
    let (_, _, estimation) = pipeline.into_parts();
    let silence = config.acquisition.silence();
    let recording = replay::Recording { config: config.replay, silence, header, estimation, counters };
    let task = replay::task::run(recording, SystemClock, links, stop);
    // This task counts heartbeats for all three.
    let [acquisition, centering, estimation] = Task::ALL.map(|task| heartbeats.of(task));
    Box::pin(counted(counted(counted(task, acquisition), centering), estimation)).await;
    Ok(())
}

/// Spawns a task with its heartbeats counted.
fn spawn(
    task: impl Future<Output = ()> + 'static,
    heartbeats: &Arc<Heartbeats>,
    name: Task,
) -> task::JoinHandle<()> {
    let heartbeats = Arc::clone(heartbeats);
    task::spawn_local(async move { counted(task, heartbeats.of(name)).await })
}

pub(super) fn fast_end(end: Result<anyhow::Result<()>, oneshot::error::RecvError>) -> anyhow::Result<()> {
    end.unwrap_or_else(|_| Err(Failure::new(exit::SOFTWARE, "the fast thread ended without a result").into()))
}
