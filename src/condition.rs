//! The condition of the daemon, as all outputs show it: `ctl status`, `/readyz`, `/metrics` and the live page.

use std::sync::Arc;

use tokio::sync::watch;
use trifacet_core::telemetry::Counters;
use trifacet_core::telemetry::heartbeat::Heartbeats;

use crate::acquisition::SourceError;
use crate::doubts::Doubts;
use crate::publishing::udp::ReceiverState;
use trifacet_core::centering::lock::LockCondition;

/// What the tasks of the daemon state about themselves.
#[derive(Clone, Debug)]
pub struct Condition {
    /// All counters.
    pub counters: Arc<Counters>,
    /// Heartbeats of the tasks of the fast side.
    pub heartbeats: Arc<Heartbeats>,
    /// The receivers of datagrams.
    pub receivers: watch::Receiver<Arc<[ReceiverState]>>,
    /// The lock state and its cause; `None` in a replay.
    pub lock: watch::Receiver<Option<LockCondition>>,
    /// Why the source is down; `None` while samples arrive.
    pub source_down: watch::Receiver<Option<SourceError>>,
    /// The doubts that stand, and the mean steering residual.
    pub doubts: Doubts,
}
