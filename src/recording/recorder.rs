//! The recorder: a thread that takes what the tap gives, and writes it as the configuration and people want.
//!
//! ```text
//!  tap ─> drain ─┬─(recording)─> file ─> disk thread: fdatasync each second
//!                └─(on-fault)──> ring ──(fault)──> file
//! ```
//!
//! Nothing that happens to it reaches the measurement: what cannot be written is lost, counted, told in
//! the log, in every frame (RECORDING_FAULT), and in the next file.

mod files;
mod thread;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tokio::sync::mpsc::{self, error::TryRecvError};

use super::Entry;
use super::codec::Encoder;
use super::disk::{Disk, Output};
use super::entry::Outflow;
use super::folder::Folder;
use super::handle::{Asked, State, Wish};
use super::ring::Ring;
use super::trigger::Trigger;
use crate::clock::{Clock, Mono, NS_PER_S, SystemClock, utc};
use crate::config::{Compression, RecordingConfig, RecordingMode};
use crate::monitor::Counters;

pub use thread::{Thread, start};

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

/// What went wrong, and what it costs.
struct Fault {
    reason: String,
    lost: u64,
    /// When it is tried again.
    retry: Mono,
}

struct Recorder {
    config: RecordingConfig,
    compression: Option<mcap::Compression>,
    folder: Folder,
    outflow: Outflow,
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
    /// Until then, if it began with a fault.
    until: Option<Mono>,
    fault: Option<Fault>,
    /// Entries that did not fit into the queue, so far; and those that no file has been told of.
    overflows: u64,
    untold: u64,
    /// Until when the frames tell of them.
    overflowing: Option<Mono>,
    /// Nothing is written before the next keyframe.
    fresh: bool,
    stop: Arc<AtomicBool>,
    flushed: Mono,
    synced: Mono,
}

impl Recorder {
    fn new(
        config: RecordingConfig,
        outflow: Outflow,
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
            outflow,
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
            fault: None,
            overflows: 0,
            untold: 0,
            overflowing: None,
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
            if !self.fill(now) && self.outflow.entries.len() < BATCH {
                std::thread::sleep(LOOK);
            }
        }
        self.empty_ring();
        self.end();
        // Now the disk is waited for: by its drop.
    }

    fn obey(&mut self) {
        while let Ok((wish, reply)) = self.asked.try_recv() {
            let done = match wish {
                Wish::Start => self.begin(None).map(|()| self.until = None),
                Wish::Stop => {
                    (self.wanted, self.until) = (false, None);
                    self.empty_ring();
                    self.end();
                    self.well();
                    Ok(())
                }
                Wish::Trigger if self.trigger.is_some() => self.triggered("asked for"),
                Wish::Trigger => {
                    Err("only with recording.mode = \"on-fault\"; to record from now on: start".into())
                }
            };
            // Who does not wait any more does not need it.
            let _ = reply.send(done);
        }
    }

    /// Takes what is there; true at the end.
    fn drain(&mut self) -> bool {
        let open = self.wanted || self.ring.is_some();
        self.outflow.open.store(open, Ordering::Relaxed);
        let now = SystemClock.now();
        for _ in 0..BATCH {
            match self.outflow.entries.try_recv() {
                Ok(entry) if open => self.take(&entry, now),
                Ok(_) => {}
                Err(TryRecvError::Empty) => return self.stop.load(Ordering::Relaxed),
                Err(TryRecvError::Disconnected) => return true,
            }
        }
        false
    }

    fn take(&mut self, entry: &Entry, now: Mono) {
        if let Some(why) = self.trigger.as_mut().and_then(|trigger| trigger.see(entry)) {
            // What goes wrong with it is told there.
            let _ = self.triggered(why);
        }
        if matches!(entry, Entry::Keyframe(_)) {
            self.cut(now);
        }
        let filling = self.output.is_some();
        if let Some(ring) = &mut self.ring {
            if let Err(e) = ring.put(&mut self.encoder, entry, now, !filling) {
                tracing::warn!("the ring of the recorder begins anew: {e}");
                ring.clear();
            }
            return;
        }
        if self.output.is_none() {
            self.lose(1);
            return;
        }
        if self.fresh && !matches!(entry, Entry::Keyframe(_)) {
            return; // nothing that could be understood
        }
        self.fresh = false;
        let Self { encoder, output: Some(output), counters, .. } = self else { return };
        let done = encoder.encode(entry, |message| {
            counters.recording_messages.add(output.put(message)?.into());
            Ok(())
        });
        if let Err(e) = done {
            self.fail(&e);
        }
    }

    /// At a keyframe: the place for a new file, and to say what is missing.
    fn cut(&mut self, now: Mono) {
        let old = |output: &Output| {
            output.bytes() as f64 >= self.config.rotate_mb * 1e6
                || now.seconds_since(output.since) >= self.config.rotate_min * 60.0
        };
        if self.output.as_ref().is_some_and(old) {
            self.end();
        }
        let due = self.fault.as_ref().is_none_or(|fault| now >= fault.retry);
        if self.wanted && self.output.is_none() && due {
            if let Err(reason) = self.open() {
                self.suffer(reason);
            } else if let Some(fault) = self.fault.take() {
                tracing::info!(lost = fault.lost, after = fault.reason, "recording goes on in a new file");
                self.untold += fault.lost;
                self.state.fault(None);
            }
        }
        self.tell_gap();
    }

    /// Wants a recording, until then.
    fn begin(&mut self, until: Option<Mono>) -> Result<(), String> {
        if self.output.is_none() && self.fault.is_none() {
            self.open()?;
        }
        (self.wanted, self.until) = (true, until);
        Ok(())
    }

    fn triggered(&mut self, why: &str) -> Result<(), String> {
        if self.wanted {
            return Ok(()); // it is recorded anyway
        }
        tracing::info!(why, "a recording begins, with what was before");
        let until = Some(SystemClock.now() + (self.config.after_s * NS_PER_S as f64) as i64);
        let begun = self.begin(until);
        if let Err(reason) = &begun {
            // Until then it is tried again.
            (self.wanted, self.until) = (true, until);
            self.suffer(reason.clone());
        }
        begun
    }

    /// What is to be done now and then.
    fn mind(&mut self, now: Mono) {
        self.watch_overflows(now);
        let filling = self.ring.is_some() && self.output.is_some();
        if self.until.is_some_and(|until| now >= until) && !filling {
            (self.wanted, self.until) = (false, None);
            self.end();
            self.well();
        }
        if now - self.flushed >= FLUSH_NS {
            self.flushed = now;
            if let Some(Err(e)) = self.output.as_mut().map(Output::flush) {
                self.fail(&e);
            }
        }
        if now - self.synced >= SECOND_NS {
            self.synced = now;
            if let Some(output) = &self.output {
                output.sync(&self.disk);
            }
            self.state.free.store(self.folder.free().unwrap_or(u64::MAX), Ordering::Relaxed);
        }
        if let Some(reason) = self.disk.error() {
            self.broken(reason);
        }
        let ring = self.ring.as_ref().map_or(0, Ring::bytes);
        self.state.ring.store(ring as u64, Ordering::Relaxed);
        self.count_bytes();
    }

    /// What did not fit into the queue is lost as well.
    fn watch_overflows(&mut self, now: Mono) {
        let overflows = self.counters.recording_overflows.get();
        let more = overflows - std::mem::replace(&mut self.overflows, overflows);
        if more > 0 {
            self.untold += more;
            if self.overflowing.is_none() {
                tracing::warn!(
                    entries = more,
                    "the recorder is behind, and has lost data: is the disk too slow?"
                );
            }
            self.overflowing = Some(now + SECOND_NS);
            self.state.fault(Some("the recorder is behind: is the disk too slow?".into()));
        } else if self.overflowing.is_some_and(|until| now >= until) {
            self.overflowing = None;
            if self.fault.is_none() {
                self.state.fault(None);
            }
        }
    }
}
