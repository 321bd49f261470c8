//! A receiver of datagrams: the fast side sends to it and counts, the main thread judges by the counts.

use std::fmt;
use std::net::SocketAddr;
use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};

use serde::Serialize;
use trifacet_core::telemetry::Counter;
use trifacet_wire::stream::Delivery;

/// What kind of receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Listed in the configuration.
    Target,
    /// Subscribed for a limited time.
    Subscriber,
}

/// A receiver. Replaced as a whole when its socket or its options change.
#[derive(Clone, Debug)]
pub struct Receiver {
    /// The host and port as configured, or the address of a subscriber.
    pub name: Arc<str>,
    /// Target or subscriber.
    pub kind: Kind,
    /// Divider, byte order and held pose.
    pub delivery: Delivery,
    /// Where to send; `None` while this is not known.
    pub way: Option<Way>,
    /// What has been sent and lost.
    pub tally: Arc<Tally>,
}

/// A socket, used for one receiver only, and the address of the receiver.
#[derive(Clone)]
pub struct Way {
    /// A socket that does not block. That of a subscriber is also read, by the runtime of the main thread.
    pub socket: Arc<dyn AsFd + Send + Sync>,
    /// The address.
    pub to: SocketAddr,
}

impl fmt::Debug for Way {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Way").field("to", &self.to).finish_non_exhaustive()
    }
}

/// Counts of one receiver.
#[derive(Debug, Default)]
pub struct Tally {
    /// Datagrams that the system accepted while the receiver could be reached, as far as known.
    pub sent: Counter,
    /// Datagrams lost for this receiver.
    pub dropped: Counter,
    /// Those among them that the system refused; `errno` is the last error.
    pub refused: Counter,
    /// Error number of the last refusal.
    errno: AtomicI32,
    /// The system accepts datagrams, but cannot transmit them.
    unreachable: AtomicBool,
}

impl Tally {
    /// Counts an accepted datagram. Returns whether it will be transmitted, as far as known.
    pub fn accepted(&self) -> bool {
        let transmitted = !self.unreachable.load(Ordering::Relaxed);
        if transmitted { &self.sent } else { &self.dropped }.inc();
        transmitted
    }

    /// Counts a datagram that the system refused, or for which there is no socket (`errno` is `None`).
    pub fn lost(&self, errno: Option<i32>) {
        if let Some(errno) = errno {
            self.errno.store(errno, Ordering::Relaxed);
            self.refused.inc();
        }
        self.dropped.inc();
    }

    /// Error number of the last refusal.
    pub fn errno(&self) -> i32 {
        self.errno.load(Ordering::Relaxed)
    }

    /// From now on, accepted datagrams are lost, or are transmitted.
    pub fn set_unreachable(&self, unreachable: bool) {
        self.unreachable.store(unreachable, Ordering::Relaxed);
    }
}
