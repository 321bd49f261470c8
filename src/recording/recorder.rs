//! The recorder: a thread that takes what the senders give, and writes it as the configuration and people want.
//!
//! ```text
//!  records ─> drain ─┬─(recording)─> file ─> disk thread: fdatasync each second
//!                └─(on-fault)──> ring ──(fault)──> file
//! ```
//!
//! A file begins at a keyframe, and ends at the next one's: where it ends, the next file or the ring goes on with
//! that very keyframe, and nothing is lost in between. Where that is to be soon, a keyframe is asked for.
//!
//! Nothing that happens to it reaches the measurement: what cannot be written is lost, counted, told in
//! the log, in every frame (RECORDING_FAULT), and in the next file.

mod commands;
mod faults;
mod files;
#[cfg(test)]
mod tests;
mod thread;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use commands::Stopping;
use faults::Fault;
pub use thread::{Thread, start};
use tokio::sync::mpsc::error::TryRecvError;
use tokio::sync::mpsc::{self};
use trifacet_core::telemetry::Counters;
use trifacet_core::time::{Clock, Mono, NS_PER_S};

use super::Entry;
use super::codec::Encoder;
use super::disk::Disk;
use super::entry::RecordReceiver;
use super::folder::Folder;
use super::handle::{Asked, State};
use super::output::Output;
use super::ring::Ring;
use super::trigger::Trigger;
use crate::clock::{SystemClock, utc};
use crate::config::{Compression, RecordingConfig, RecordingMode};

/// How often the queue is looked at.
const LOOK: Duration = Duration::from_millis(20);
/// Most entries that are taken at a time: then comes everything else.
const BATCH: usize = 8 * 1024;
/// How often what there is is handed over to the system: what a killed daemon loses.
const FLUSH_NS: i64 = NS_PER_S / 2;
/// How often the disk is asked for it, and a recording that failed is tried again.
const SECOND_NS: i64 = NS_PER_S;
/// Room that there must be to begin a recording, bytes.
const ROOM: u64 = 4 << 20;

struct Recorder {
    config: RecordingConfig,
    compression: Option<mcap::Compression>,
    folder: Folder,
    receiver: RecordReceiver,
    asked: mpsc::Receiver<Asked>,
    disk: Disk,
    state: Arc<State>,
    counters: Arc<Counters>,
    encoder: Encoder,
    output: Option<Output>,
    /// While it is on fault and no file is written, or while the file is still being filled from it.
    ring: Option<Ring>,
    trigger: Option<Trigger>,
    /// A recording is wanted.
    wanted: bool,
    /// Until then, if it began with a fault or somebody has ended it.
    until: Option<Mono>,
    /// The last moment that was told.
    latest: Mono,
    /// Somebody waits for the end of the file.
    stopping: Option<Stopping>,
    fault: Option<Fault>,
    /// What went wrong with something that is over, and until when the frames tell of it.
    mishap: Option<(Mono, String)>,
    /// Entries that did not fit into the queue, so far.
    overflows: u64,
    /// Entries that no file has been told of, and why they are missing.
    untold: Option<(u64, String)>,
    /// Nothing makes sense before the next keyframe.
    fresh: bool,
    stop: Arc<AtomicBool>,
    flushed: Mono,
    synced: Mono,
}

impl Recorder {
    fn new(
        config: RecordingConfig,
        receiver: RecordReceiver,
        asked: mpsc::Receiver<Asked>,
        disk: Disk,
        state: Arc<State>,
        counters: Arc<Counters>,
    ) -> Self {
        let compression = match config.compression {
            Compression::None => None,
            Compression::Lz4 => Some(mcap::Compression::Lz4),
            Compression::Zstd => Some(mcap::Compression::Zstd),
        };
        let on_fault = config.mode == RecordingMode::OnFault;
        let now = SystemClock.now();
        Self {
            compression,
            folder: Folder(config.folder.clone()),
            receiver,
            asked,
            disk,
            state,
            counters,
            encoder: Encoder::new(utc::read_clocks()),
            output: None,
            ring: on_fault.then(|| Ring::new(config.before_s, compression)),
            trigger: on_fault.then(|| Trigger::new(config.after_s)),
            wanted: config.mode == RecordingMode::Always,
            until: None,
            latest: now,
            stopping: None,
            fault: None,
            mishap: None,
            overflows: 0,
            untold: None,
            fresh: true,
            stop: Arc::default(),
            flushed: now,
            synced: now,
            config,
        }
    }

    fn run(mut self) {
        self.look_around();
        loop {
            self.obey();
            let ended = self.drain();
            let now = SystemClock.now();
            self.mind(now);
            if ended {
                break;
            }
            if !self.fill(now) && self.receiver.entries.len() < BATCH {
                std::thread::sleep(LOOK);
            }
        }
        self.empty_ring();
        self.end();
        self.disk.wait();
        self.hear_disk();
    }

    /// Takes what is there; true at the end.
    fn drain(&mut self) -> bool {
        let open = self.wanted || self.ring.is_some();
        self.receiver.open.store(open, Ordering::Relaxed);
        let now = SystemClock.now();
        for _ in 0..BATCH {
            match self.receiver.entries.try_recv() {
                Ok(entry) if open => self.take(&entry, now),
                Ok(_) => {}
                Err(TryRecvError::Empty) => return self.stop.load(Ordering::Relaxed),
                Err(TryRecvError::Disconnected) => return true,
            }
        }
        false
    }

    fn take(&mut self, entry: &Entry, now: Mono) {
        self.latest = entry.time().unwrap_or(self.latest);
        if let Some(why) = self.trigger.as_mut().and_then(|trigger| trigger.see(entry)) {
            // What goes wrong with it is told there.
            let _ = self.triggered(why);
        }
        if matches!(entry, Entry::Keyframe(_)) {
            self.wake();
            self.fresh = false;
            self.cut(now);
        }
        let filling = self.filling();
        if let Some(ring) = &mut self.ring {
            if let Err(e) = ring.put(&mut self.encoder, entry, now, !filling) {
                tracing::warn!("the ring of the recorder begins anew: {e}");
                ring.clear();
            }
            return;
        }
        if self.output.is_none() {
            self.fresh = true;
            self.lose(1);
            return;
        }
        if self.fresh {
            return; // nothing that could be understood
        }
        let Self { encoder, output: Some(output), counters, .. } = self else { return };
        let done = encoder.encode(entry, |message| {
            counters.recording_messages.add(output.put(message)?.into());
            Ok(())
        });
        if let Err(e) = done {
            self.fail(&e);
        }
    }

    /// If nothing has told the encoder the time lately, it reads the clocks.
    fn wake(&mut self) {
        if self.fresh {
            self.encoder = Encoder::new(utc::read_clocks());
        }
    }

    /// The file is still being filled from the ring.
    fn filling(&self) -> bool {
        self.ring.is_some() && self.output.is_some()
    }

    /// What is to be done now and then.
    fn mind(&mut self, now: Mono) {
        self.watch_overflows(now);
        if now - self.flushed >= FLUSH_NS {
            self.flushed = now;
            if let Some(Err(e)) = self.output.as_mut().map(Output::flush) {
                self.fail(&e);
            }
        }
        if now - self.synced >= SECOND_NS {
            self.synced = now;
            if let Some(output) = &self.output {
                output.sync(&mut self.disk);
            }
            self.state.free.store(self.folder.free().unwrap_or(u64::MAX), Ordering::Relaxed);
        }
        self.hear_disk();
        if self.waits_for_keyframe(now) {
            self.receiver.keyframe.store(true, Ordering::Relaxed);
        }
        self.answer(now);
        self.mishap.take_if(|(until, _)| now >= *until);
        self.show();
        let ring = self.ring.as_ref().map_or(0, Ring::bytes);
        self.state.ring.store(ring as u64, Ordering::Relaxed);
        self.count_bytes();
    }
}
