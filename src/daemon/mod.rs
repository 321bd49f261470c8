//! The daemon: creates the channels, starts the tasks, and controls start and shutdown.
//!
//! ```text
//!  fast thread                                                     main thread
//!  source ─> acquisition ─(samples, in order)─> estimation ─> UDP
//!              ^   └─(newest)─> centering <─(pose)─┘   └─(frames)─> TCP clients, monitor
//!              └──────(command)─────┘   └─(lock)──^           ^ subscriptions
//!                              └─(command)─> PI stage, on the main thread
//!       (changes, requests) <── control ── socket, SIGHUP
//! ```
//!
//! - `fast`: the three tasks, in a thread of their own.
//! - `slow`: everything else, on the main thread. `terminal`: whether SIGHUP reports a closed terminal.
//!
//! The fast thread never waits for the main thread: frames that do not fit into a channel are counted.

mod fast;
mod slow;
mod terminal;

use std::path::{self, Path};
use std::sync::Arc;

use anyhow::Context;
use fast::{Parts, start};
use slow::{Hangups, Monitor, Server, Slow, control, listeners, serve};
use terminal::Terminal;
use tokio::runtime::{Builder, Runtime};
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::{Mutex, mpsc, watch};
use tokio_util::sync::CancellationToken;
use trifacet_core::telemetry::heartbeat::Heartbeats;
use trifacet_core::telemetry::{CommandGauge, Counters, LatestStatus};
use trifacet_core::time::{Clock, Mono};
use trifacet_wire::stream::Descriptor;

use crate::clock::SystemClock;
use crate::clock::utc::Utc;
use crate::condition::Condition;
use crate::config::{CalibrationContext, Config, PublishingConfig};
use crate::control::server::Socket;
use crate::control::{self, ConfigFile, PageControls, RunningConfig};
use crate::doubts;
use crate::exit::Failure;
use crate::logging::Logging;
use crate::monitor::view::{self, View};
use crate::publishing::descriptor::StreamFacts;
use crate::publishing::subscription_server::SubscriptionServer;
use crate::publishing::{Outlets, Publisher, StreamId, subscription_server, tcp, udp};
use crate::recording;
use crate::replay::RecordingHeader;
use crate::service::Service;
use crate::steering::{self, Stage};

/// Frames that can wait for TCP or for the monitor: 1.6 s at 10 kHz. The system may stop an ordinary thread
/// for that long. Memory is used only for frames that are waiting.
const TO_MAIN: usize = 16 * 1024;

/// Runs the daemon until SIGTERM, SIGINT or the loss of its terminal; then ends in order, the steering first.
///
/// `file` is the source of the configuration. SIGHUP makes the daemon read it again.
///
/// # Errors
/// The daemon cannot start (configuration, port, device or file), or a task ended by itself or stalled.
pub fn run(config: &Config, file: Option<&Path>, log: &Arc<Logging>) -> anyhow::Result<()> {
    let started = SystemClock.now();
    let (counters, commands) = <(Arc<Counters>, Arc<CommandGauge>)>::default();
    let (doubter, doubts) = doubts::pair();
    let (heartbeats, glance) = <(Arc<Heartbeats>, Arc<LatestStatus>)>::default();
    let service = Service::new(&config.realtime, Arc::clone(&heartbeats), Arc::clone(&glance));
    let (config, context, header) = &holding(config, file)?;
    let pipeline = config.pipeline(context)?;
    let facts = StreamFacts::new(StreamId::new(context.id()), config, context.calibration.clone());
    let main = Builder::new_current_thread().enable_all().build().context("cannot start a runtime")?;
    let hangups = hangups(&main, started)?; // first of all: without a handler SIGHUP would end the process
    let socket = main.block_on(async { Socket::open(&config.control) })?;
    let (to_fast, at_fast) = control::ways();
    let (descriptor, descriptor_now) = watch::channel(described(&facts, config, header.as_ref()));
    let (steering, steering_now) = watch::channel(config.steering.clone());
    let Stage { driver, task: stage, outputs } = steering::configured(config, steering_now)?;
    let [(to_tcp, frames), (to_monitor, monitored)] = [(); 2].map(|()| mpsc::channel(TO_MAIN));
    let [server, monitor] = main.block_on(async { listeners(config) })?;
    let (lock, lock_now) = watch::channel(None);
    let (source_down, source_down_now) = watch::channel(None);
    let (config_in_force, config_now) = watch::channel(config.clone());
    let (records, recording, recorder) =
        recording::recorder::start(&config.recording, &counters).context("cannot start the recorder")?;
    let (subscription_server, supervisor, datagrams) = main.block_on(datagrams(&config.publishing))?;
    let outlets = Outlets {
        datagrams,
        tcp: server.is_some().then_some(to_tcp),
        monitor: monitor.is_some().then_some(to_monitor),
        recording_fault: Arc::clone(&recording.state.fault),
        descriptor: descriptor.clone(),
    };
    let publisher = Publisher::new(facts.id, SystemClock, Utc::system(), Arc::clone(&counters), outlets);
    let stop = CancellationToken::new();
    let fast = start(Parts {
        commands: Arc::clone(&commands),
        doubter: doubter.clone(),
        pipeline,
        stage: (driver, outputs),
        publisher,
        counters: Arc::clone(&counters),
        heartbeats: Arc::clone(&heartbeats),
        glance,
        lock,
        source_down,
        stop: stop.clone(),
        records,
        context: Arc::clone(context),
        header: header.clone(),
        descriptor: descriptor.clone(),
        control: at_fast,
        config: config.clone(),
    })?;
    let condition = Condition {
        counters: Arc::clone(&counters),
        heartbeats,
        receivers: supervisor.states(),
        lock: lock_now.clone(),
        source_down: source_down_now,
        doubts,
    };
    let live = Arc::new(Mutex::new(RunningConfig {
        file: file.map(ConfigFile::new),
        running: config.clone(),
        taken: config.clone(),
        tables: context.tables.clone(),
        facts,
        descriptor,
        config_in_force,
        fast: to_fast,
        steering,
        log: Arc::clone(log),
        recording: recording.clone(),
        condition: condition.clone(),
        last_self_check: None,
        doubter,
        started,
    }));
    let view = View::new(view::Sources {
        condition,
        descriptor: descriptor_now.clone(),
        config: config_now,
        control: PageControls::of(&config.monitor, &live),
        recording: recording.state,
        commands,
    });
    let sources = tcp::Sources { descriptor: descriptor_now.clone(), lock: lock_now };
    let slow = Slow {
        service: &service,
        server: server.map(|listener| Server { listener, frames, sources }),
        monitor: monitor.map(|listener| Monitor { listener, frames: monitored, view }),
        subscription_server,
        supervisor,
        stage,
        descriptor: descriptor_now,
    };
    let control = control(live, socket, hangups, &service.notify);
    let result = serve(&main, config, slow, control, fast, &counters, &stop);
    end(main, recorder, &counters);
    result
}

/// Notices a terminal that is closed.
fn hangups(main: &Runtime, started: Mono) -> anyhow::Result<Hangups> {
    let terminal = Terminal::of_process(started);
    let signal = main.block_on(async { signal(SignalKind::hangup()) }).context("cannot listen for SIGHUP")?;
    Ok(Hangups { signal, terminal })
}

fn end(main: Runtime, recorder: recording::recorder::Thread, counters: &Counters) {
    recorder.join();
    log_totals(counters);
    main.shutdown_background(); // do not wait for pending opens of ports or name look-ups
}

/// Logs what runs: the version, the configuration file, and what the poses depend on.
fn log_start(file: Option<&Path>, context: &CalibrationContext) {
    let file = file.map(|file| path::absolute(file).unwrap_or_else(|_| file.to_owned()));
    let file = file.map_or_else(|| "none: default values".into(), |file| file.display().to_string());
    let config = format!("{:08x}", context.id());
    tracing::info!(version = env!("CARGO_PKG_VERSION"), file, config, "trifacet starts");
}

/// Logs all counters that have counted something.
fn log_totals(counters: &Counters) {
    let counts = counters.list().into_iter().filter(|(_, n)| *n > 0);
    tracing::info!(counters = ?counts.collect::<Vec<_>>(), "stopped");
}

/// Opens the port for subscriptions and the sockets of the targets.
async fn datagrams(
    config: &PublishingConfig,
) -> Result<(Option<SubscriptionServer>, udp::Supervisor, udp::Sender), Failure> {
    let server = config.subscribe.map(subscription_server::open).transpose()?;
    let subscribers = server.as_ref().map(SubscriptionServer::subscribers);
    let mut supervisor = udp::Supervisor::new(&config.udp, subscribers.clone());
    supervisor.resolve_names().await;
    let sender =
        udp::Sender::new([supervisor.targets()].into_iter().chain(subscribers)).stating(config.deviations);
    Ok((server, supervisor, sender))
}

/// The configuration in force with its context; for a replay, those at the beginning of the recording. Logs them,
/// with the file of the configuration.
fn holding(
    config: &Config,
    file: Option<&Path>,
) -> anyhow::Result<(Config, Arc<CalibrationContext>, Option<RecordingHeader>)> {
    let (in_force, context, header) = match RecordingHeader::of_source(config)? {
        None => (config.clone(), Arc::new(CalibrationContext::read(config.clone())?), None),
        Some(then) => (then.holding(config), Arc::clone(&then.context), Some(then)),
    };
    log_start(file, &context);
    control::warn_of_unverified_origin(&config.steering);
    control::log_calibration(&context.calibration, config.calibration.expires_days);
    Ok((in_force, context, header))
}

/// The descriptor, including the replay if that is the source.
fn described(facts: &StreamFacts, config: &Config, header: Option<&RecordingHeader>) -> Descriptor {
    let replay = header.map(|then| then.replayed(&config.replay));
    Descriptor { replay, ..facts.descriptor() }
}
