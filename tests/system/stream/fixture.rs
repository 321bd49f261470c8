//! A TCP server with frames from the test, and a daemon that publishes.

use std::net::SocketAddr;
use std::sync::Arc;

use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use trifacet::client::PoseFrame;
use trifacet::config::Model;
use trifacet::core::telemetry::Counters;
use trifacet::publishing::StreamId;
use trifacet::publishing::descriptor::StreamFacts;
use trifacet::publishing::tcp::{self, Limits};
use trifacet_wire::stream::Descriptor;
use trifacet_wire::{LockState, Status};

use crate::testkit::Daemon;

const ID: StreamId = StreamId { session: 11, config: 22 };

/// A running server with frames from the test.
pub(crate) struct Server {
    pub(crate) address: SocketAddr,
    pub(crate) frames: mpsc::Sender<PoseFrame>,
    pub(crate) counters: Arc<Counters>,
    pub(crate) shutdown: CancellationToken,
    pub(crate) task: JoinHandle<()>,
}

pub(crate) async fn start(limits: Limits) -> Server {
    let listener = tcp::bind(([127, 0, 0, 1], 0).into()).unwrap();
    let address = listener.local_addr().unwrap();
    let (frames, rx) = mpsc::channel(4096);
    let counters = Arc::<Counters>::default();
    let shutdown = CancellationToken::new();
    let task = tokio::spawn({
        let (counters, shutdown) = (counters.clone(), shutdown.clone());
        async move {
            let descriptor = tokio::sync::watch::channel(descriptor()).1;
            let lock = tokio::sync::watch::channel(None).1;
            let sources = tcp::Sources { descriptor, lock };
            tcp::serve(listener, rx, sources, limits, counters, shutdown).await;
        }
    });
    Server { address, frames, counters, shutdown, task }
}

pub(crate) fn descriptor() -> Descriptor {
    StreamFacts { model: Model::Gaussian, ..StreamFacts::example(ID) }.descriptor()
}

/// A plain, valid frame.
pub(crate) fn frame(sequence: u64) -> PoseFrame {
    PoseFrame {
        session: ID.session,
        config: ID.config,
        sequence,
        sample_index: sequence,
        time_ns: 0,
        solve_delay_ns: 0,
        send_delay_ns: 0,
        status: Status::POSE_VALID,
        clock_quality: 0,
        lock: LockState::Off,
        iterations: 1,
        pose: [0.0; 6],
        systematic: None,
        deviations: [0.0; 6],
        beam_offset: [0.0; 2],
        steering_residual: 0.0,
        averaged: 1,
        lost: 0,
        spots: [0.0; 6],
        powers: [0.0; 3],
        steering: [0.0; 2],
    }
}

/// A daemon on its twin with these keys of `[publishing]` and the tables that follow them.
pub(crate) fn publishing(keys: &str) -> Daemon {
    Daemon::start(&format!("[publishing]\n{keys}\n"))
}
