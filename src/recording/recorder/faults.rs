//! Handles failures of the recording: state, counters and log.

use trifacet_core::time::{Clock, Mono};

use super::{Recorder, SECOND_NS};
use crate::clock::SystemClock;
use crate::recording::writer::RecordError;

/// A failure that prevents recording, and its cost.
pub(super) struct Fault {
    pub reason: String,
    pub lost: u64,
    /// Time of the next attempt.
    pub retry: Mono,
}

impl Recorder {
    /// Handles the results of the disk thread.
    pub(super) fn hear_disk(&mut self) {
        while let Some(done) = self.disk.done() {
            let current = self.output.as_ref().is_some_and(|output| output.path == done.path);
            match done.result {
                Ok((file, bytes)) if done.close => tracing::info!(file = %file.display(), bytes, "recorded"),
                Ok(_) => {}
                Err(reason) if current => self.broken(reason),
                Err(reason) => self.mishap(reason),
            }
        }
    }

    /// Reports entries that did not fit into the queue as missing.
    pub(super) fn watch_overflows(&mut self, now: Mono) {
        const WHY: &str = "the recorder has fallen behind: is the disk too slow?";
        let overflows = self.counters.recording_overflows.get();
        let more = overflows - std::mem::replace(&mut self.overflows, overflows);
        if more > 0 {
            self.miss(more, WHY);
            if self.mishap.is_none() {
                tracing::warn!(entries = more, "recording loses data: {WHY}");
            }
            self.mishap = Some((now + SECOND_NS, WHY.into()));
        }
    }

    pub(super) fn fail(&mut self, error: &RecordError) {
        self.broken(format!("cannot write to recording.folder, {}: {error}", self.folder.0.display()));
    }

    /// Abandons the current file after a failure.
    pub(super) fn broken(&mut self, reason: String) {
        let mut torn = 0;
        if let Some(output) = self.output.take() {
            torn = output.torn();
            self.counters.recording_bytes.add(output.news());
            self.state.file(None);
            if let Some(path) = output.abandon() {
                tracing::warn!(
                    file = %path.display(),
                    "recording ended early; restore the data with trifacet recover FILE"
                );
            }
        }
        if self.wanted {
            self.ring = None;
        }
        self.suffer(reason);
        self.lose(torn);
    }

    /// Logs a failure once, and schedules the next attempt.
    pub(super) fn suffer(&mut self, reason: String) {
        if !self.wanted {
            return self.mishap(reason);
        }
        let retry = SystemClock.now() + SECOND_NS;
        if let Some(fault) = &mut self.fault {
            fault.retry = retry;
            return;
        }
        self.counters.recording_faults.inc();
        tracing::error!("recording stopped, the stream continues; retrying every second: {reason}");
        self.fault = Some(Fault { reason, lost: 0, retry });
        self.show();
    }

    /// Reports a failure of a file that has already ended.
    fn mishap(&mut self, reason: String) {
        self.counters.recording_faults.inc();
        tracing::error!("cannot finish a recording: {reason}");
        if let Some(stopping) = &mut self.stopping {
            stopping.failed = Some(reason.clone());
        }
        self.mishap = Some((SystemClock.now() + SECOND_NS, reason));
        self.show();
    }

    /// Updates the fault in the state.
    pub(super) fn show(&self) {
        let fault = self.fault.as_ref().map(|fault| &fault.reason);
        self.state.fault(fault.or(self.mishap.as_ref().map(|(_, why)| why)).cloned());
    }

    pub(super) fn lose(&mut self, entries: u64) {
        if let Some(fault) = &mut self.fault {
            fault.lost += entries;
            self.counters.recording_lost.add(entries);
        }
    }

    /// Adds missing entries to those that the next file, or the next keyframe of this one, reports.
    pub(super) fn miss(&mut self, entries: u64, why: &str) {
        let (so_far, why) = self.unwritten.take().unwrap_or_else(|| (0, why.to_owned()));
        self.unwritten = Some((so_far + entries, why));
    }
}
