//! Telling a running daemon what to do: over a Unix socket, and by SIGHUP.
//!
//! - [`command`]: what can be said, in one line; pure.
//! - [`live`]: the configuration as it is at present, and how it changes.
//! - [`server`]: the socket. [`client`]: the other end of it.
//!
//! All this stands on the main thread. The fast side is told through bounded channels and answers through
//! a channel of the question's own; neither waits for the other.

pub mod client;
pub mod command;
pub mod live;
pub mod server;

pub use command::Command;
pub use live::RunningConfig;
use tokio::sync::mpsc;

use crate::acquisition::task::SettingsChange;
use crate::centering::CenteringRequest;
use crate::estimation::EstimationRequest;

/// Orders that may wait on each way. They come one at a time, so there is always room.
const QUEUE: usize = 4;

/// The ways to the tasks of the fast side.
#[derive(Debug)]
pub struct FastRequests {
    changes: mpsc::Sender<SettingsChange>,
    questions: mpsc::Sender<EstimationRequest>,
    orders: mpsc::Sender<CenteringRequest>,
}

/// Their ends there.
#[derive(Debug)]
pub struct FastLink {
    /// For acquisition.
    pub changes: mpsc::Receiver<SettingsChange>,
    /// For estimation.
    pub questions: mpsc::Receiver<EstimationRequest>,
    /// For centering.
    pub orders: mpsc::Receiver<CenteringRequest>,
}

/// The ways between the main thread and the fast side.
pub fn ways() -> (FastRequests, FastLink) {
    let (changes, changes_end) = mpsc::channel(QUEUE);
    let (questions, questions_end) = mpsc::channel(QUEUE);
    let (orders, orders_end) = mpsc::channel(QUEUE);
    (
        FastRequests { changes, questions, orders },
        FastLink { changes: changes_end, questions: questions_end, orders: orders_end },
    )
}
