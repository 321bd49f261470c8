//! What the pages are made of. Fed on the main thread, read by every request.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{broadcast, mpsc, mpsc::error::TryRecvError, watch};
use tokio::time::{MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;

use super::Counters;
use crate::clock::{Clock, Mono, SystemClock};
use crate::config::Config;
use crate::publishing::{Descriptor, PoseFrame};

/// How often new frames are looked for. A frame wakes nobody, so its rate costs little here.
const LOOK: Duration = Duration::from_millis(20);
/// Most frames that are taken at a time.
const BATCH: usize = 16 * 1024;
/// Batches that a viewer may be behind before it loses the oldest: about 1.3 s.
const BEHIND: usize = 64;

/// What is known of the daemon, for whoever looks.
#[derive(Debug)]
pub struct View {
    /// Every counter.
    pub counters: Arc<Counters>,
    /// What the stream says of itself at present.
    pub descriptor: watch::Receiver<Descriptor>,
    /// The configuration that holds at present.
    pub config: watch::Receiver<Config>,
    /// Cancelled when the daemon ends: whoever still sends says goodbye.
    pub ending: CancellationToken,
    newest: watch::Sender<Option<Newest>>,
    batches: broadcast::Sender<Arc<[PoseFrame]>>,
}

/// The newest frame.
#[derive(Clone, Copy, Debug)]
pub struct Newest {
    /// As it was sent.
    pub frame: PoseFrame,
    /// When the monitor saw it: at most a look after it was sent, unless the main thread was held up.
    pub seen: Mono,
}

impl View {
    /// A view of a daemon that has not made a frame yet.
    pub fn new(
        counters: Arc<Counters>,
        descriptor: watch::Receiver<Descriptor>,
        config: watch::Receiver<Config>,
    ) -> Self {
        let (newest, batches) = (watch::channel(None).0, broadcast::channel(BEHIND).0);
        Self { counters, descriptor, config, ending: CancellationToken::new(), newest, batches }
    }

    /// The newest frame, if there is one; can be waited on.
    pub fn newest(&self) -> watch::Receiver<Option<Newest>> {
        self.newest.subscribe()
    }

    /// Every frame from now on, in batches. A viewer that does not keep up loses the oldest
    /// (`Lagged`), and no other notices.
    pub fn batches(&self) -> broadcast::Receiver<Arc<[PoseFrame]>> {
        self.batches.subscribe()
    }

    /// Takes frames until none can come any more.
    pub(super) async fn feed(&self, frames: &mut mpsc::Receiver<PoseFrame>) {
        let mut looks = interval(LOOK);
        looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut batch = Vec::new();
        loop {
            looks.tick().await;
            let gone = drain(frames, &mut batch);
            if let Some(frame) = batch.last() {
                self.newest.send_replace(Some(Newest { frame: *frame, seen: SystemClock.now() }));
                if self.batches.receiver_count() > 0 {
                    // Fails if the last viewer has just gone, which is no loss.
                    let _ = self.batches.send(batch.as_slice().into());
                }
                batch.clear();
            }
            if gone {
                return;
            }
        }
    }
}

/// Takes what is there; says whether the sender is gone.
fn drain(frames: &mut mpsc::Receiver<PoseFrame>, batch: &mut Vec<PoseFrame>) -> bool {
    while batch.len() < BATCH {
        match frames.try_recv() {
            Ok(frame) => batch.push(frame),
            Err(e) => return e == TryRecvError::Disconnected,
        }
    }
    false
}
