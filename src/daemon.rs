//! The wiring: makes every channel, starts every task, owns start and shutdown.
//!
//! ```text
//!  fast thread                                                     main thread
//!  source ─> acquisition ─(samples, in order)─> estimation ─> UDP
//!              ^   └─(newest)─> centering <─(pose)─┘   └─(frames)─> TCP clients, monitor
//!              └──────(command)─────┘   └─(lock)──^           ^ subscriptions
//!                              └─(command)─> PI stage, on the main thread
//!       (changes, orders, questions) <── control ── socket, SIGHUP
//! ```
//!
//! The fast thread never waits for the main thread: frames that do not fit into the channel are counted.

use std::cell::Cell;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::thread::JoinHandle;

use anyhow::Context;
use tokio::runtime::{Builder, Runtime};
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::{Mutex, mpsc, oneshot, watch};
use tokio::task::{self, LocalSet};
use tokio_util::sync::CancellationToken;

use crate::acquisition::{self, Channels, SerialSource, Source};
use crate::centering::{self, Centering};
use crate::clock::{Clock, SystemClock, utc::Utc};
use crate::config::{Config, Meaning, RealtimeConfig, SourceKind};
use crate::control::{self, AtFast, Command, Live, server::Socket};
use crate::estimation::{self, Estimation, PoseReport};
use crate::exit::{self, Failure};
use crate::logging::Logging;
use crate::monitor::glance::Glance;
use crate::monitor::turns::{Task, Turns, counted};
use crate::monitor::{
    self, Counters,
    guard::Hosts,
    page::control::Controls,
    view::{self, View},
};
use crate::publishing::descriptor::StreamFacts;
use crate::publishing::{
    Descriptor, Outlets, PoseFrame, Publisher, PublisherSettings, StreamId, subscribe, subscription, tcp,
};
use crate::realtime;
use crate::recording::{self, Entry, Tap, Witness};
use crate::replay::{self, Beginning};
use crate::service::{Notify, Service};
use crate::steering::{self, Gcs, Outputs, Stage, gcs};
use crate::twin::{Twin, TwinSource};

/// Samples that may wait for estimation.
const QUEUE: usize = 1024;
/// Frames that may wait for TCP or for the monitor, each on an ordinary thread: the system may stop it for
/// long (1.6 s of frames at 10 kHz). Takes memory only while they wait.
const TO_MAIN: usize = 16 * 1024;

/// Runs until SIGTERM or SIGINT; then ends in order, the steering first.
///
/// `file` is where the configuration comes from, to be read again on SIGHUP.
pub fn run(config: &Config, file: Option<&Path>, log: &Arc<Logging>) -> anyhow::Result<()> {
    let started = SystemClock.now();
    let counters = Arc::new(Counters::default());
    let (turns, glance) = <(Arc<Turns>, Arc<Glance>)>::default();
    let service = Service::new(&config.realtime, Arc::clone(&turns), Arc::clone(&glance));
    let (config, meaning, beginning) = &holding(config)?;
    let channels = Channels::new(config, &meaning.tables)?;
    let id = StreamId::new(meaning.id());
    let facts = StreamFacts {
        id,
        sample_rate_hz: config.acquisition.rate_hz,
        average: config.estimation.average,
        model: config.estimation.model,
        calibrated: channels.calibrated(),
    };
    let main = Builder::new_current_thread().enable_all().build().context("cannot start a runtime")?;
    // Before anything else: without a handler SIGHUP would end the process.
    let hangup = main.block_on(async { signal(SignalKind::hangup()) }).context("cannot listen for SIGHUP")?;
    let socket = main.block_on(async { Socket::open(&config.control) })?;
    let (to_fast, at_fast) = control::ways();
    let (descriptor, descriptor_now) = watch::channel(described(facts, config, beginning.as_ref()));
    let (steering, steering_now) = watch::channel(config.steering.clone());
    let (gcs, gcs_task) = gcs::pair(config, steering_now).unzip();
    let (to_tcp, frames) = mpsc::channel(TO_MAIN);
    let (to_monitor, monitored) = mpsc::channel(TO_MAIN);
    let [server, monitor] = main.block_on(listeners(config))?;
    let (told, config_now) = watch::channel(config.clone());
    let (tap, recording, recorder) =
        recording::recorder::start(&config.recording, &counters).context("cannot start the recorder")?;
    let udp = config.publishing.udp.clone();
    let (desk, subscribers) = config.publishing.subscribe.map(subscribe::open).transpose()?.unzip();
    let publisher = Publisher::new(
        PublisherSettings { id, udp },
        SystemClock,
        Utc::system(),
        Arc::clone(&counters),
        Outlets {
            subscribers,
            tcp: server.is_some().then_some(to_tcp),
            monitor: monitor.is_some().then_some(to_monitor),
            recording_fault: Arc::clone(&recording.state.fault),
        },
    )?;
    let parts = Parts {
        estimation: Estimation::new(estimation::Settings::new(config, channels.calibrated(), id.config)?),
        centering: Centering::new(config)?,
        gcs,
        channels,
        publisher,
        counters: Arc::clone(&counters),
        turns: Arc::clone(&turns),
        glance,
        stop: CancellationToken::new(),
        tap,
        meaning: Arc::clone(meaning),
        beginning: beginning.clone(),
        descriptor: descriptor.clone(),
        control: at_fast,
        config: config.clone(),
    };
    let stop = parts.stop.clone();
    let fast = start(parts)?;
    let live = Arc::new(Mutex::new(Live {
        file: file.map(Path::to_owned),
        running: config.clone(),
        taken: config.clone(),
        tables: meaning.tables.clone(),
        facts,
        descriptor,
        told,
        fast: to_fast,
        steering,
        log: Arc::clone(log),
        counters: Arc::clone(&counters),
        turns: Arc::clone(&turns),
        recording: recording.clone(),
        started,
    }));
    let view = View::new(view::Sources {
        counters: Arc::clone(&counters),
        descriptor: descriptor_now.clone(),
        config: config_now,
        subscribers: desk.as_ref().map(subscribe::Desk::subscribers),
        turns,
        control: Controls::of(&config.monitor, &live),
        recording: recording.state,
    });
    let slow = Slow {
        service: &service,
        server: server.map(|listener| Server { listener, frames, descriptor: descriptor_now }),
        monitor: monitor.map(|listener| Monitor { listener, frames: monitored, view }),
        desk,
        stage: gcs_task,
        session: id.session,
    };
    let control = control(live, socket, hangup, &service.notify);
    let result = serve(&main, config, slow, control, fast, &counters, &stop);
    recorder.join();
    let counts = counters.list().into_iter().filter(|(_, n)| *n > 0);
    tracing::info!(counters = ?counts.collect::<Vec<_>>(), "stopped");
    main.shutdown_background(); // a port that is being opened, or a name that is looked up, is not waited for
    result
}

/// Where TCP clients and browsers connect, if they may.
async fn listeners(config: &Config) -> anyhow::Result<[Option<tokio::net::TcpListener>; 2]> {
    let server = match config.publishing.tcp {
        Some(address) => Some(tcp::bind(address).await?),
        None => None,
    };
    let monitor = match config.monitor.listen {
        Some(address) => Some(monitor::http::bind(address).await?),
        None => None,
    };
    Ok([server, monitor])
}

/// The configuration that holds and what poses mean by it; of a recording, what they mean at its beginning.
fn holding(config: &Config) -> anyhow::Result<(Config, Arc<Meaning>, Option<Beginning>)> {
    Ok(match Beginning::of_source(config)? {
        None => (config.clone(), Arc::new(Meaning::read(config.clone())?), None),
        Some(then) => (then.holding(config), Arc::clone(&then.meaning), Some(then)),
    })
}

/// What the stream says of itself; also what is replayed, if that is the source.
fn described(facts: StreamFacts, config: &Config, beginning: Option<&Beginning>) -> Descriptor {
    let replay = beginning.map(|then| then.told(&config.replay));
    Descriptor { replay, ..Descriptor::new(facts) }
}

/// What the fast thread is made of.
struct Parts {
    config: Config,
    channels: Channels,
    estimation: Estimation,
    centering: Centering,
    /// The stage, if it is not the source's own.
    gcs: Option<Gcs>,
    publisher: Publisher<SystemClock>,
    counters: Arc<Counters>,
    turns: Arc<Turns>,
    glance: Arc<Glance>,
    control: AtFast,
    meaning: Arc<Meaning>,
    /// Of the recording, if that is the source.
    beginning: Option<Beginning>,
    descriptor: watch::Sender<Descriptor>,
    tap: Tap,
    stop: CancellationToken,
}

/// What the main thread serves.
struct Slow<'a> {
    service: &'a Service,
    server: Option<Server>,
    monitor: Option<Monitor>,
    desk: Option<subscribe::Desk>,
    stage: Option<gcs::task::Task>,
    session: u32,
}

/// The TCP side.
struct Server {
    listener: tokio::net::TcpListener,
    frames: mpsc::Receiver<PoseFrame>,
    descriptor: watch::Receiver<Descriptor>,
}

/// The HTTP side.
struct Monitor {
    listener: tokio::net::TcpListener,
    frames: mpsc::Receiver<PoseFrame>,
    view: View,
}

/// The fast thread, and the news of its end: the task that ended by itself, if one did.
struct Fast {
    thread: JoinHandle<()>,
    ended: oneshot::Receiver<anyhow::Result<()>>,
}

/// Starts the fast thread with the source of the configuration.
fn start(parts: Parts) -> anyhow::Result<Fast> {
    let counters = Arc::clone(&parts.counters);
    match parts.config.acquisition.source {
        SourceKind::Twin => {
            let twin = Twin::new(&parts.config)?;
            let source = || TwinSource::new(twin, SystemClock, counters);
            start_fast(parts.config.realtime.clone(), || fast(parts, source))
        }
        SourceKind::Replay => start_fast(parts.config.realtime.clone(), || replayed(parts)),
        SourceKind::Serial => {
            let source = SerialSource::open(&parts.config, SystemClock, counters)?;
            start_fast(parts.config.realtime.clone(), || fast(parts, || Ok(source)))
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
            .and_then(|runtime| LocalSet::new().block_on(&runtime, tasks()));
        // The main thread may have given up waiting; then there is nobody to tell.
        let _ = end.send(result);
    });
    Ok(Fast { thread: thread.context("cannot start the fast thread")?, ended })
}

/// The three tasks and their edges; ends when `stop` is cancelled, or with an error when a task ends.
async fn fast<S: Source + 'static>(
    parts: Parts,
    source: impl FnOnce() -> io::Result<S>,
) -> anyhow::Result<()> {
    let Parts { config, channels, estimation, centering, gcs, mut publisher, .. } = parts;
    let Parts { counters, turns, glance, control, stop, meaning, tap, .. } = parts;
    let AtFast { changes, questions, orders } = control;
    let source = source().context("cannot start the source")?;
    let (samples_in, samples) = mpsc::channel(QUEUE);
    let (newest_in, newest) = watch::channel(acquisition::task::Newest::default());
    let (commands_in, commands) = watch::channel(None);
    let (answers_in, answers) = watch::channel(steering::outputs::Answers::default());
    let outputs = || Outputs::new(config.steering.full_scale_um * 1e-6, commands_in, answers);
    let driver = gcs.map_or_else(|| Stage::Outputs(outputs()), Stage::Gcs);
    let (state_in, steering) = watch::channel(centering.state());
    let steering = estimation::pulse::Loop::new(steering, Arc::clone(&turns));
    let (poses_in, poses) = watch::channel(None);
    let stop_acquisition = CancellationToken::new();

    let mut acquisition = spawn(
        acquisition::task::run(
            source,
            channels,
            SystemClock,
            Arc::clone(&counters),
            acquisition::task::Edges {
                samples: samples_in,
                newest: newest_in,
                answers: answers_in,
                commands,
                changes,
            },
            stop_acquisition.clone(),
        ),
        &turns,
        Task::Acquisition,
    );
    let mut centering = spawn(
        centering::task::run(
            centering,
            driver,
            SystemClock,
            counters,
            centering::task::Edges { newest, poses, state: state_in, orders, tap: tap.clone() },
            stop.clone(),
        ),
        &turns,
        Task::Centering,
    );
    let witness = Witness::new(tap.clone(), meaning);
    let publish = move |report: &PoseReport| {
        let frame = publisher.publish(report);
        let (time, covariance) = (report.time, report.covariance);
        tap.put(|| Entry::Frame { frame, time, covariance });
        glance.at(report);
    };
    let mut estimation = spawn(
        estimation::task::run(
            estimation,
            config.acquisition.rate_hz,
            SystemClock,
            estimation::task::Edges { samples, questions, steering, newest: poses_in, publish, witness },
        ),
        &turns,
        Task::Estimation,
    );

    let ended = tokio::select! {
        biased;
        () = stop.cancelled() => None,
        end = &mut centering => Some(("centering", end)),
        end = &mut acquisition => Some(("acquisition", end)),
        end = &mut estimation => Some(("estimation", end)),
    };
    if let Some((task, end)) = ended {
        let why = end.err().map_or_else(|| "it returned".into(), |e| e.to_string());
        return Err(Failure::new(exit::SOFTWARE, format!("task {task} ended by itself: {why}")).into());
    }
    // In order: the stage gets its last command while acquisition still carries it; then acquisition
    // ends, and with it the channel that estimation lives on.
    centering.await.context("task centering failed at the end")?;
    stop_acquisition.cancel();
    acquisition.await.context("task acquisition failed at the end")?;
    estimation.await.context("task estimation failed at the end")
}

/// One task in place of the three: a recording, at the pace at which it was made.
async fn replayed(parts: Parts) -> anyhow::Result<()> {
    let Parts { config, estimation, mut publisher, counters, glance, turns, .. } = parts;
    let Parts { control, stop, descriptor, beginning, .. } = parts;
    let beginning = beginning.context("there is no recording")?;
    let publish = move |told: &replay::teller::Told| {
        publisher.publish_of(&told.report, told.time_ns, told.synced);
        glance.at(&told.report);
    };
    let means = move |meaning: &Meaning| {
        let corrected = meaning.tables.0.iter().all(Option::is_some);
        descriptor.send_modify(|now| (now.config, now.calibrated) = (meaning.id(), corrected));
    };
    let edges = replay::task::Edges { control, publish, means };
    let recording = replay::task::Recording { config: config.replay, beginning, estimation, counters };
    let task = replay::task::run(recording, SystemClock, edges, stop);
    // It does the work of all three.
    let [acquisition, centering, estimation] = Task::ALL.map(|task| turns.of(task));
    Box::pin(counted(counted(counted(task, acquisition), centering), estimation)).await;
    Ok(())
}

/// A task whose turns are counted.
fn spawn(task: impl Future<Output = ()> + 'static, turns: &Arc<Turns>, name: Task) -> task::JoinHandle<()> {
    let turns = Arc::clone(turns);
    task::spawn_local(async move { counted(task, turns.of(name)).await })
}

/// Commands and SIGHUP, for ever.
async fn control(live: Arc<Mutex<Live>>, socket: Option<Socket>, mut hangup: Signal, notify: &Notify) {
    let commands = async {
        match socket {
            Some(socket) => socket.serve(Arc::clone(&live)).await,
            None => std::future::pending().await,
        }
    };
    let reloads = async {
        while hangup.recv().await.is_some() {
            notify.reloading();
            let answer = live.lock().await.obey(Command::Reload).await;
            notify.reloaded();
            control::server::note(&Command::Reload, None, &answer);
        }
    };
    tokio::join!(commands, reloads);
}

/// The main thread: TCP clients, UDP subscriptions, a slow stage, commands and signals, until the end.
fn serve(
    main: &Runtime,
    config: &Config,
    slow: Slow<'_>,
    control: impl Future<Output = ()>,
    fast: Fast,
    counters: &Arc<Counters>,
    stop: &CancellationToken,
) -> anyhow::Result<()> {
    let limits = tcp::Limits {
        clients: config.publishing.tcp_clients,
        queue: config.publishing.tcp_queue,
        allow: config.publishing.allow.clone(),
        ..tcp::Limits::default()
    };
    let publishing = &config.publishing;
    let subscriptions =
        subscription::Subscriptions::new(slow.session, publishing.subscribers, publishing.allow.clone());
    let Slow { service, server, monitor, desk, stage, .. } = slow;
    let Fast { thread, mut ended } = fast;
    // A fast thread that does not come back is left behind: its end is that of the process.
    let left_behind = Cell::new(false);
    let result = main.block_on(async {
        let (mut terminate, mut interrupt) =
            (signal(SignalKind::terminate())?, signal(SignalKind::interrupt())?);
        let serving = async {
            let Some(Server { listener, frames, descriptor }) = server else {
                stop.cancelled().await;
                return;
            };
            // Not told to stop: it serves what the fast side still sends, and ends when that has ended.
            let never = CancellationToken::new();
            tcp::serve(listener, frames, descriptor, limits, Arc::clone(counters), never).await;
        };
        let monitoring = async {
            match monitor {
                Some(Monitor { listener, frames, view }) => {
                    let hosts = Hosts::new(&config.monitor.allowed_hosts);
                    monitor::http::serve(listener, frames, view, hosts).await;
                }
                None => stop.cancelled().await,
            }
        };
        let serving = async {
            tokio::join!(serving, monitoring);
        };
        let subscribing = async {
            match desk {
                Some(desk) => desk.run(subscriptions, SystemClock, counters, stop.clone()).await,
                None => std::future::pending().await,
            }
        };
        let steering = async {
            match stage {
                Some(stage) => stage.run(counters).await,
                None => stop.cancelled().await,
            }
        };
        let mut serving = std::pin::pin!(serving);
        let mut steering = std::pin::pin!(steering);
        let mut watching = std::pin::pin!(service.run());
        let asked = tokio::select! {
            biased;
            end = &mut ended => return fast_end(end),
            () = &mut serving => {
                // The servers end by themselves only when the fast side is gone.
                return fast_end(ended.await);
            }
            () = &mut steering => return fast_end(ended.await), // likewise
            end = subscribing => end.context("cannot take UDP subscriptions").map(|()| "subscriptions ended"),
            () = control => Err(Failure::new(exit::SOFTWARE, "the control task ended by itself").into()),
            stalled = &mut watching => {
                left_behind.set(true);
                return Err(stalled.into());
            }
            _ = terminate.recv() => Ok("SIGTERM"),
            _ = interrupt.recv() => Ok("SIGINT"),
        };
        if let Ok(signal) = asked {
            tracing::info!("{signal}: stopping");
        }
        stop.cancel();
        service.ending();
        tokio::select! {
            (end, (), ()) = async { tokio::join!(ended, serving, steering) } => fast_end(end)?,
            late = watching => {
                left_behind.set(true);
                return Err(late.into());
            }
        }
        asked.map(|_| ())
    });
    if left_behind.get() {
        return result;
    }
    // It has said that it ended; only a panic is news now.
    if thread.join().is_err() {
        return Err(Failure::new(exit::SOFTWARE, "the fast thread panicked").into());
    }
    result
}

fn fast_end(end: Result<anyhow::Result<()>, oneshot::error::RecvError>) -> anyhow::Result<()> {
    end.unwrap_or_else(|_| Err(Failure::new(exit::SOFTWARE, "the fast thread ended without a word").into()))
}
