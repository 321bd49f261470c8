//! Handles failures of the recording: state, counters and log.

use std::sync::Arc;

use trifacet_core::time::{Clock, Mono};

use super::fault_reason::FaultReason;
use super::{Recorder, SECOND_NS};
use crate::clock::SystemClock;
use crate::recording::writer::RecordError;

/// A failure that prevents recording, and its cost.
pub(super) struct Fault {
    pub reason: Arc<FaultReason>,
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
                Err(error) if current => self.broken(error.into()),
                Err(error) => self.mishap(Arc::new(error.into())),
            }
        }
    }

    /// Reports entries that did not fit into the queue as missing.
    pub(super) fn watch_overflows(&mut self, now: Mono) {
        let overflows = self.counters.recording_overflows.get();
        let more = overflows - std::mem::replace(&mut self.overflows, overflows);
        if more > 0 {
            let reason = FaultReason::Behind;
            self.miss(more, &reason.to_string());
            if self.mishap.is_none() {
                tracing::warn!(entries = more, "recording loses data: {reason}");
            }
            self.mishap = Some((now + SECOND_NS, Arc::new(reason)));
        }
    }

    pub(super) fn fail(&mut self, source: RecordError) {
        self.broken(FaultReason::Write { folder: self.folder.0.clone(), source });
    }

    /// Abandons the current file after a failure.
    pub(super) fn broken(&mut self, reason: FaultReason) {
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
    pub(super) fn suffer(&mut self, reason: impl Into<Arc<FaultReason>>) {
        let reason = reason.into();
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
    fn mishap(&mut self, reason: Arc<FaultReason>) {
        self.counters.recording_faults.inc();
        tracing::error!("cannot finish a recording: {reason}");
        if let Some(stopping) = &mut self.stopping {
            stopping.failed = Some(Arc::clone(&reason));
        }
        self.mishap = Some((SystemClock.now() + SECOND_NS, reason));
        self.show();
    }

    /// Updates the fault in the state.
    pub(super) fn show(&self) {
        let fault = self.fault.as_ref().map(|fault| &fault.reason);
        self.state.fault(fault.or(self.mishap.as_ref().map(|(_, why)| why)).map(ToString::to_string));
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
