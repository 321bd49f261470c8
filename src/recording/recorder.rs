//! The recorder: a thread that writes the entries to files, according to configuration, commands and faults.
//!
//! ```text
//!  entries ─> drain ─┬─(recording)─> file ─> disk thread: fdatasync each second
//!                    └─(on-fault)──> ring ──(fault)──> file
//! ```
//!
//! A file begins at a keyframe and ends at a keyframe. The next file or the ring begins with the keyframe at
//! which a file ends, so that nothing is lost in between. Before a file begins or ends, the recorder requests
//! a keyframe.
//!
//! A failure of the recorder does not affect the measurement. What cannot be written is lost and counted. The
//! loss is reported in the log, in every frame (RECORDING_FAULT), and in the next file.

mod commands;
mod fault_reason;
mod faults;
mod files;
mod leftovers;
#[cfg(test)]
mod tests;
mod thread;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use commands::Stopping;
use fault_reason::FaultReason;
use faults::Fault;
pub use thread::{Thread, start};
use tokio::sync::mpsc::error::TryRecvError;
use tokio::sync::mpsc::{self};
use trifacet_core::telemetry::Counters;
use trifacet_core::time::{Clock, Mono, NS_PER_S};

use super::Entry;
use super::budget::Budget;
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

/// Interval of polling the queue.
const LOOK: Duration = Duration::from_millis(20);
/// Most entries processed in one pass of the main loop.
const BATCH: usize = 8 * 1024;
/// Interval of writing the current chunk to the system: a killed daemon loses at most this.
const FLUSH_NS: i64 = NS_PER_S / 2;
/// Interval of synchronizing to disk, and of retrying after a failure.
const SECOND_NS: i64 = NS_PER_S;
/// Least free space for a new recording, bytes.
const ROOM: u64 = 4 << 20;

struct Recorder {
    config: RecordingConfig,
    compression: Option<mcap::Compression>,
    folder: Folder,
    budget: Budget,
    receiver: RecordReceiver,
    asked: mpsc::Receiver<Asked>,
    disk: Disk,
    state: Arc<State>,
    counters: Arc<Counters>,
    encoder: Encoder,
    output: Option<Output>,
    /// Present in mode on-fault while no file is written, and while a file is being filled from it.
    ring: Option<Ring>,
    trigger: Option<Trigger>,
    /// A recording is to be written.
    wanted: bool,
    /// End of the recording, if a fault started it or a command ended it.
    until: Option<Mono>,
    /// Time of the latest entry.
    latest: Mono,
    /// A command that waits for the end of the file.
    stopping: Option<Stopping>,
    fault: Option<Fault>,
    /// An error of a finished file or of the queue, and the time until which frames report it.
    mishap: Option<(Mono, Arc<FaultReason>)>,
    /// Entries that did not fit into the queue so far.
    overflows: u64,
    /// Missing entries that no file reports yet, and the reason.
    unwritten: Option<(u64, String)>,
    /// Entries cannot be decoded before the next keyframe.
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
            budget: Budget::new((config.budget_gb * 1e9) as u64),
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
            unwritten: None,
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

    /// Processes waiting entries. Returns true at the end.
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
            // It logs and reports its errors itself.
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
                tracing::warn!("recorder ring cleared: {e}");
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
            return; // cannot be decoded without a keyframe
        }
        let Self { encoder, output: Some(output), counters, .. } = self else { return };
        let done = encoder.encode(entry, |message| {
            counters.recording_messages.add(output.put(message)?.into());
            Ok(())
        });
        if let Err(e) = done {
            self.fail(e);
        }
    }

    /// Reads the clocks for the encoder if no entry has given it the time recently.
    fn wake(&mut self) {
        if self.fresh {
            self.encoder = Encoder::new(utc::read_clocks());
        }
    }

    /// Whether a file is being filled from the ring.
    fn filling(&self) -> bool {
        self.ring.is_some() && self.output.is_some()
    }

    /// Periodic work.
    fn mind(&mut self, now: Mono) {
        self.watch_overflows(now);
        if now - self.flushed >= FLUSH_NS {
            self.flushed = now;
            if let Some(Err(e)) = self.output.as_mut().map(Output::flush) {
                self.fail(e);
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
