//! The main thread: clients, monitor, subscriptions, a slow stage, commands and signals.

use std::cell::Cell;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use tokio::runtime::Runtime;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::{Mutex, mpsc, watch};
use tokio::time::{MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;
use trifacet_core::telemetry::Counters;
use trifacet_core::time::Clock;
use trifacet_wire::PoseFrame;
use trifacet_wire::stream::Descriptor;

use super::fast::{Fast, fast_end};
use super::terminal::Terminal;
use crate::clock::SystemClock;
use crate::config::Config;
use crate::control::live::obey;
use crate::control::server::{Sender, Socket};
use crate::control::{self, Command, RunningConfig};
use crate::exit::{self, Failure};
use crate::monitor;
use crate::monitor::host_filter::Hosts;
use crate::monitor::view::View;
use crate::publishing::{subscription, subscription_server, tcp, udp};
use crate::service::{Notify, Service};
use crate::steering::StageTask;

/// Interval of the checks whether the terminal is still there.
const TERMINAL_LOOK: Duration = Duration::from_millis(250);

/// Everything that the main thread serves.
pub(super) struct Slow<'a> {
    pub(super) service: &'a Service,
    pub(super) server: Option<Server>,
    pub(super) monitor: Option<Monitor>,
    pub(super) subscription_server: Option<subscription_server::SubscriptionServer>,
    pub(super) supervisor: udp::Supervisor,
    pub(super) stage: Option<StageTask>,
    pub(super) descriptor: watch::Receiver<Descriptor>,
}

/// The TCP server.
pub(super) struct Server {
    pub(super) listener: tokio::net::TcpListener,
    pub(super) frames: mpsc::Receiver<PoseFrame>,
    pub(super) sources: tcp::Sources,
}

/// The HTTP server.
pub(super) struct Monitor {
    pub(super) listener: tokio::net::TcpListener,
    pub(super) frames: mpsc::Receiver<PoseFrame>,
    pub(super) view: View,
}

/// Opens the configured ports for TCP clients and for the monitor.
pub(super) fn listeners(config: &Config) -> anyhow::Result<[Option<tokio::net::TcpListener>; 2]> {
    let server = config.publishing.tcp.map(tcp::bind).transpose()?;
    let monitor = config.monitor.listen.map(monitor::http::bind).transpose()?;
    Ok([server, monitor])
}

/// SIGHUP, and the terminal whose loss it can report.
pub(super) struct Hangups {
    pub(super) signal: Signal,
    pub(super) terminal: Terminal,
}

/// Serves commands and reloads, and runs the periodic self-check, until the terminal of the daemon is closed.
pub(super) async fn control(
    live: Arc<Mutex<RunningConfig>>,
    socket: Option<Socket>,
    hangups: Hangups,
    notify: &Notify,
) {
    let commands = async {
        match socket {
            Some(socket) => socket.serve(Arc::clone(&live)).await,
            None => std::future::pending().await,
        }
    };
    tokio::select! {
        () = commands => {}
        () = control::watch_expiry(&live) => {}
        () = reloads(&live, hangups, notify) => {}
        () = control::self_check::run_periodically(&live) => {}
    }
}

/// Reloads on every SIGHUP that does not report the loss of the terminal. Returns after such a loss.
async fn reloads(live: &Mutex<RunningConfig>, hangups: Hangups, notify: &Notify) {
    let Hangups { mut signal, mut terminal } = hangups;
    let mut looks = interval(TERMINAL_LOOK);
    looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            Some(()) = signal.recv() => {
                if terminal.hangup(SystemClock.now()) {
                    return;
                }
                notify.reloading();
                let answer = obey(live, Command::Reload).await;
                notify.reloaded();
                control::server::note(&Command::Reload, Sender::Signal, &answer);
            }
            _ = looks.tick() => {
                if terminal.attended() && terminal.is_closed(SystemClock.now()) {
                    return;
                }
            }
        }
    }
}

/// Runs the main thread until the daemon ends.
pub(super) fn serve(
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
        deviations: config.publishing.deviations,
        ..tcp::Limits::default()
    };
    let publishing = &config.publishing;
    let subscriptions =
        subscription::Subscriptions::new(slow.descriptor, publishing.subscribers, publishing.allow.clone());
    let Slow { service, server, monitor, subscription_server, supervisor, stage, .. } = slow;
    let Fast { thread, mut ended } = fast;
    // A stalled fast thread is not joined: it ends with the process.
    let left_behind = Cell::new(false);
    let result = main.block_on(async {
        let (mut terminate, mut interrupt) =
            (signal(SignalKind::terminate())?, signal(SignalKind::interrupt())?);
        let mut cpu_limit = signal(SignalKind::from_raw(rustix::process::Signal::XCPU.as_raw()))?;
        let serving = async {
            let Some(Server { listener, frames, sources }) = server else {
                stop.cancelled().await;
                return;
            };
            // Without a stop signal: the server sends all frames of the fast side and ends after them.
            let never = CancellationToken::new();
            tcp::serve(listener, frames, sources, limits, Arc::clone(counters), never).await;
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
            tokio::join!(serving, monitoring, supervisor.run(stop.clone()));
        };
        let subscribing = async {
            match subscription_server {
                Some(subscription_server) => {
                    subscription_server.run(subscriptions, SystemClock, counters, stop.clone()).await
                }
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
                // The servers end by themselves only after the fast side has ended.
                return fast_end(ended.await);
            }
            () = &mut steering => return fast_end(ended.await), // as above
            end = subscribing => end.context("cannot serve UDP subscriptions").map(|()| "subscriptions ended"),
            () = control => Ok("SIGHUP, the terminal is closed"),
            stalled = &mut watching => {
                left_behind.set(true);
                return Err(stalled.into());
            }
            _ = cpu_limit.recv() => {
                let why = "SIGXCPU: the limit of CPU time for this process is reached (RLIMIT_CPU, LimitCPU=)";
                Err(Failure::new(exit::SOFTWARE, why).into())
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
    // The thread has reported its end. Only a panic after that is an error.
    if thread.join().is_err() {
        return Err(Failure::new(exit::SOFTWARE, "the fast thread panicked").into());
    }
    result
}
