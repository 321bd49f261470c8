//! The TCP server, on the slow side. It sends nothing until a client sends a request (`docs/stream.md`).
//!
//! All clients read from one ring of frames at their own pace. A client that falls behind by more than the
//! ring loses the oldest frames. They are counted for this client; other clients are not affected.
//!
//! This file accepts clients and closes the server; `client` serves one connection.

mod client;
mod context;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{broadcast, mpsc, watch};
use tokio::task::JoinSet;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;
use trifacet_core::centering::lock::LockCondition;
use trifacet_core::telemetry::Counters;
use trifacet_wire::PoseFrame;
use trifacet_wire::held::Hold;
use trifacet_wire::stream::Descriptor;

use self::client::Client;
pub use self::context::Limits;
use self::context::{ServerContext, part};
use super::encoding::{EncodedFrame, farewell};
use crate::config::Deviations;
use crate::exit::Failure;
use crate::listening::{Accepting, open_tcp};

/// Longest time at shutdown to receive the last frames, and again to send them.
const DRAIN: Duration = Duration::from_millis(500);
/// Most refused connections kept open at a time; further ones are closed without a reason.
const PARTINGS: usize = 64;

/// Opens the port and logs its address. Must be called within a runtime.
///
/// # Errors
/// The port cannot be opened; with [`crate::exit::IN_USE`] if another process uses it.
pub fn bind(address: SocketAddr) -> Result<TcpListener, Failure> {
    let listener = open_tcp(address)
        .map_err(|e| Failure::port(format_args!("listen on {address} for TCP clients"), &e))?;
    let address = listener.local_addr().unwrap_or(address);
    tracing::info!(%address, "listening");
    Ok(listener)
}

/// What the server reports beside the frames.
#[derive(Clone, Debug)]
pub struct Sources {
    /// The current descriptor.
    pub descriptor: watch::Receiver<Descriptor>,
    /// The lock state and its cause; `None` without a loop.
    pub lock: watch::Receiver<Option<LockCondition>>,
}

/// Serves the incoming frames until `shutdown` or until the channel closes. Then sends the remaining frames,
/// within a second at most.
pub async fn serve(
    listener: TcpListener,
    mut frames: mpsc::Receiver<PoseFrame>,
    sources: Sources,
    limits: Limits,
    counters: Arc<Counters>,
    shutdown: CancellationToken,
) {
    let (ring, idle_ring) = broadcast::channel(limits.queue.clamp(1, 1 << 20));
    let (newest_in, newest) = watch::channel(None);
    let mut broadcaster =
        Broadcaster { ring, newest: newest_in, hold: Hold::default(), deviations: limits.deviations };
    let ending = CancellationToken::new();
    let context = ServerContext { sources, limits, counters, newest, ending: ending.clone() };
    let mut server = Server { context: context.into(), clients: JoinSet::new(), partings: JoinSet::new() };
    tokio::select! {
        () = broadcaster.run(&mut frames) => {}
        () = server.accept_all(&listener, &idle_ring) => {}
        () = shutdown.cancelled() => {}
    }
    drop(listener);
    let _ = timeout(DRAIN, broadcaster.run(&mut frames)).await;
    // The ring closes: streams end after their last frame. Connections without a stream end at once.
    drop(broadcaster);
    ending.cancel();
    server.finish().await;
}

/// Encodes frames and puts them on the ring.
struct Broadcaster {
    ring: broadcast::Sender<Arc<EncodedFrame>>,
    newest: watch::Sender<Option<Arc<EncodedFrame>>>,
    hold: Hold,
    deviations: Deviations,
}

impl Broadcaster {
    /// Runs until the channel closes.
    async fn run(&mut self, frames: &mut mpsc::Receiver<PoseFrame>) {
        while let Some(frame) = frames.recv().await {
            let encoded = Arc::new(EncodedFrame::new(frame, &mut self.hold, self.deviations));
            self.newest.send_replace(Some(Arc::clone(&encoded)));
            // Fails if there is no client, which is not a loss.
            let _ = self.ring.send(encoded);
        }
    }
}

struct Server {
    context: Arc<ServerContext>,
    clients: JoinSet<()>,
    partings: JoinSet<()>,
}

impl Server {
    async fn accept_all(&mut self, listener: &TcpListener, ring: &broadcast::Receiver<Arc<EncodedFrame>>) {
        let mut accepting = Accepting::new("a TCP client");
        loop {
            if let Some((stream, address)) = accepting.taken(listener.accept().await).await {
                self.admit(stream, address, ring);
            }
        }
    }

    fn admit(
        &mut self,
        stream: TcpStream,
        address: SocketAddr,
        ring: &broadcast::Receiver<Arc<EncodedFrame>>,
    ) {
        while self.clients.try_join_next().is_some() {}
        let limits = &self.context.limits;
        if !limits.allow.iter().any(|network| network.contains(address.ip())) {
            let why = format!("{} is in none of the networks of [publishing] allow", address.ip());
            self.refuse(stream, address, &why);
        } else if self.clients.len() >= limits.clients {
            let most = limits.clients;
            let why = format!("the daemon already serves {most} TCP clients, the configured maximum");
            self.refuse(stream, address, &why);
        } else {
            let client = Client::new(stream, ring.resubscribe(), Arc::clone(&self.context));
            let context = Arc::clone(&self.context);
            context.counters.tcp_connected.inc();
            self.clients.spawn(async move {
                tracing::info!(client = %address, "connected");
                client.run(address).await;
                context.counters.tcp_disconnected.inc();
            });
        }
    }

    fn refuse(&mut self, stream: TcpStream, address: SocketAddr, why: &str) {
        tracing::warn!(client = %address, "refused: {why}");
        self.context.counters.tcp_refused.inc();
        while self.partings.try_join_next().is_some() {}
        if self.partings.len() < PARTINGS
            && let Ok(line) = farewell(None, why)
        {
            self.partings.spawn(part(stream, line));
        }
    }

    /// Waits until the clients have read the rest of the ring, for [`DRAIN`] at most.
    async fn finish(&mut self) {
        let all_done = async { while self.clients.join_next().await.is_some() {} };
        if timeout(DRAIN, all_done).await.is_err() {
            tracing::warn!(
                clients = self.clients.len(),
                "closed TCP clients that did not read the last frames in time"
            );
        }
    }
}
