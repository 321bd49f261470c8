//! Commands to a running daemon, over a Unix socket and by SIGHUP.
//!
//! - [`command`]: the commands and their syntax; pure.
//! - [`live`]: the configuration in force, and its changes, with `reload` and `tare`.
//! - `calibration`: the end of a calibration while the daemon runs.
//! - [`config_file`]: the configuration file, whose file system may stop responding.
//! - [`self_check`]: whether the pose depends on where the beam meets the mirror.
//! - [`page`]: the permission of the live page.
//! - [`server`]: the socket. [`client`]: its client.
//!
//! All of this runs on the main thread. Requests reach the fast side through bounded channels. Each request
//! carries a channel for its answer. Neither side blocks the other.

mod calibration;
pub mod client;
pub mod command;
pub mod config_file;
pub mod live;
pub mod page;
mod reload;
pub mod self_check;
pub mod server;
mod tare;

pub use calibration::{log_calibration, watch_expiry};
pub use command::Command;
pub use config_file::ConfigFile;
pub use live::RunningConfig;
pub use page::PageControls;
pub use reload::warn_of_unverified_origin;
use tokio::sync::mpsc;

use crate::acquisition::task::SettingsChange;
use crate::centering::CenteringRequest;
use crate::estimation::EstimationRequest;
use crate::twin::MoveRequest;

/// Requests that can wait in each channel. They come one at a time, so there is always room.
const QUEUE: usize = 4;

/// The sending ends of the channels to the fast side.
#[derive(Debug)]
pub struct FastRequests {
    changes: mpsc::Sender<SettingsChange>,
    questions: mpsc::Sender<EstimationRequest>,
    orders: mpsc::Sender<CenteringRequest>,
    moves: mpsc::Sender<MoveRequest>,
}

/// The receiving ends of the channels to the fast side.
#[derive(Debug)]
pub struct FastLink {
    /// Requests to acquisition.
    pub changes: mpsc::Receiver<SettingsChange>,
    /// Requests to estimation.
    pub questions: mpsc::Receiver<EstimationRequest>,
    /// Requests to centering.
    pub orders: mpsc::Receiver<CenteringRequest>,
    /// Requests to the twin.
    pub moves: mpsc::Receiver<MoveRequest>,
}

/// The channels between the main thread and the fast side.
pub fn ways() -> (FastRequests, FastLink) {
    let (changes, changes_end) = mpsc::channel(QUEUE);
    let (questions, questions_end) = mpsc::channel(QUEUE);
    let (orders, orders_end) = mpsc::channel(QUEUE);
    let (moves, moves_end) = mpsc::channel(QUEUE);
    (
        FastRequests { changes, questions, orders, moves },
        FastLink { changes: changes_end, questions: questions_end, orders: orders_end, moves: moves_end },
    )
}
