//! What the server and its clients share: limits, the newest frame, and how a connection is closed.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::sync::watch;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;
use trifacet_core::centering::lock::LockCondition;
use trifacet_core::telemetry::Counters;

use super::Sources;
use crate::config::{Deviations, Network};
use crate::publishing::encoding::EncodedFrame;

/// Longest time for a refused client to read the reason.
const PARTING: Duration = Duration::from_secs(1);

/// Limits of the server.
#[derive(Clone, Debug)]
pub struct Limits {
    /// Most clients at a time; further ones are refused.
    pub clients: usize,
    /// Frames that a client may fall behind without loss; rounded up to a power of two.
    pub queue: usize,
    /// Networks from which clients may connect.
    pub allow: Vec<Network>,
    /// A client without a stream is disconnected after this time without a complete line.
    pub idle: Duration,
    /// A client that accepts no data for this time is disconnected: the connection is half-open or hangs.
    pub stall: Duration,
    /// Which standard uncertainties binary frames carry.
    pub deviations: Deviations,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            clients: 64,
            queue: 1024,
            allow: Network::loopback(),
            idle: Duration::from_mins(1),
            stall: Duration::from_secs(10),
            deviations: Deviations::Total,
        }
    }
}

/// Data shared by all clients.
pub(super) struct ServerContext {
    pub(super) sources: Sources,
    pub(super) limits: Limits,
    pub(super) counters: Arc<Counters>,
    pub(super) newest: watch::Receiver<Option<Arc<EncodedFrame>>>,
    pub(super) ending: CancellationToken,
}

impl ServerContext {
    /// The lock state with its cause, if it explains the newest frame.
    pub(super) fn lock(&self) -> Option<LockCondition> {
        let frame = self.newest.borrow().as_ref().map(|encoded| encoded.frame().lock)?;
        (*self.sources.lock.borrow())?.explaining(frame)
    }
}

/// Sends `last_word` and closes once the client has read it. Closing a socket with unread input would reset
/// the connection, and `last_word` would be lost.
pub(super) async fn part(mut stream: TcpStream, last_word: Vec<u8>) {
    let talk = async {
        stream.write_all(&last_word).await?;
        stream.shutdown().await?;
        let mut ignored = [0; 1024];
        while stream.read(&mut ignored).await? > 0 {}
        io::Result::Ok(())
    };
    // An error means that the client has closed the connection.
    let _ = timeout(PARTING, talk).await;
}
