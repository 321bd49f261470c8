//! Files that begin, end, and cannot go on.

use std::sync::atomic::Ordering;

use super::{Fault, ROOM, Recorder, SECOND_NS};
use crate::clock::{Clock, Mono, SystemClock};
use crate::config::RecordingMode;
use crate::recording::codec::Encoded;
use crate::recording::disk::Output;
use crate::recording::folder::{Recording, UNFINISHED};
use crate::recording::ring::Ring;
use crate::recording::writer::RecordError;

impl Recorder {
    /// What is left of another time.
    pub(super) fn look_around(&mut self) {
        if self.config.mode == RecordingMode::Off {
            return;
        }
        if let Err(e) = self.folder.make() {
            tracing::warn!(folder = %self.folder.0.display(), "recording.folder cannot be made: {e}");
        }
        let unfinished = |r: &Recording| r.path.extension().is_some_and(|e| e == UNFINISHED);
        for left in self.folder.list().unwrap_or_default().iter().filter(|r| unfinished(r)) {
            tracing::warn!(
                file = %left.path.display(),
                "a recording was not finished: trifacet recover FILE makes a whole one of it"
            );
        }
    }

    /// Opens a file, after there is room for it.
    pub(super) fn open(&mut self) -> Result<(), String> {
        let folder = self.folder.0.display();
        let within =
            |what: &str, e: &dyn std::fmt::Display| format!("{what} in recording.folder, {folder}: {e}");
        self.folder.make().map_err(|e| within("cannot record", &e))?;
        let [budget, next] =
            [self.config.budget_gb * 1e9, self.config.rotate_mb * 1e6].map(|bytes| bytes as u64);
        let deleted = self.folder.make_room(budget, next).map_err(|e| within("cannot look", &e))?;
        for old in deleted {
            self.counters.recording_deletions.one();
            tracing::info!(file = %old.path.display(), bytes = old.bytes, "deleted, to keep recording.budget_gb");
        }
        let free = self.folder.free().map_err(|e| within("cannot record", &e))?;
        self.state.free.store(free, Ordering::Relaxed);
        if free < ROOM {
            return Err(format!(
                "no room: {free} bytes are free in recording.folder, {folder}; make room there"
            ));
        }
        let begin_ns = self.ring.as_ref().and_then(Ring::begin_ns).unwrap_or_else(|| self.encoder.now_ns());
        let output = Output::begin(&self.folder, begin_ns, SystemClock.now(), self.compression)
            .map_err(|e| within("cannot make a file", &e))?;
        tracing::info!(file = %output.path.display(), "recording");
        self.counters.recording_files.one();
        self.state.file(Some(output.path.clone()));
        self.encoder.restart();
        (self.output, self.fresh) = (Some(output), true);
        Ok(())
    }

    /// Says in the file what is missing before this.
    pub(super) fn tell_gap(&mut self) {
        let Self { encoder, output: Some(output), untold, .. } = self else { return };
        if *untold > 0 {
            let reason = "not recorded: the disk was full, failed, or too slow";
            let told = encoder.gap(*untold, reason, |message| output.put(message).map(|_| ()));
            *untold = 0;
            if let Err(e) = told {
                self.fail(&e);
            }
        }
    }

    /// Moves a stretch of the ring into the file; false if there is nothing to move.
    pub(super) fn fill(&mut self, now: Mono) -> bool {
        let Self { output: Some(output), ring: Some(ring), counters, .. } = self else { return false };
        let mut put = |message: Encoded<'_>| {
            counters.recording_messages.add(output.put(message)?.into());
            Ok(())
        };
        let moved = match ring.drain(&mut put) {
            // The one in the making is the last.
            Ok(false) => match ring.close(now).and_then(|()| ring.drain(&mut put)) {
                Ok(any) => {
                    (self.ring, self.fresh) = (None, !any);
                    Ok(true)
                }
                Err(e) => Err(e),
            },
            moved => moved,
        };
        moved.unwrap_or_else(|e| {
            self.fail(&e);
            false
        })
    }

    pub(super) fn empty_ring(&mut self) {
        while self.output.is_some() && self.ring.is_some() && self.fill(SystemClock.now()) {}
    }

    pub(super) fn count_bytes(&self) {
        if let Some(output) = &self.output {
            self.counters.recording_bytes.add(output.news());
        }
    }

    /// Finishes the file.
    pub(super) fn end(&mut self) {
        if let Some(Err(e)) = self.output.as_mut().map(Output::flush) {
            return self.fail(&e);
        }
        let Some(output) = self.output.take() else { return };
        tracing::info!(file = %output.path.display(), bytes = output.bytes(), "recorded");
        self.counters.recording_bytes.add(output.news());
        self.state.file(None);
        if let Err(e) = output.finish(&self.disk) {
            self.suffer(e.to_string());
        }
        if self.config.mode == RecordingMode::OnFault && !self.wanted {
            self.ring = Some(Ring::new(self.config.before_s, self.compression));
        }
    }

    /// Nothing is wanted, so nothing is wrong.
    pub(super) fn well(&mut self) {
        self.fault = None;
        self.untold = 0;
        self.state.fault(None);
        if self.config.mode == RecordingMode::OnFault && self.ring.is_none() {
            self.ring = Some(Ring::new(self.config.before_s, self.compression));
        }
    }

    pub(super) fn fail(&mut self, error: &RecordError) {
        self.broken(format!("cannot write in recording.folder, {}: {error}", self.folder.0.display()));
    }

    /// The file cannot go on.
    pub(super) fn broken(&mut self, reason: String) {
        if let Some(output) = self.output.take() {
            self.counters.recording_bytes.add(output.news());
            self.state.file(None);
            if let Some(path) = output.abandon() {
                tracing::warn!(
                    file = %path.display(),
                    "the recording ends here: trifacet recover FILE makes a whole one of it"
                );
            }
        }
        if self.wanted {
            self.ring = None;
        }
        self.suffer(reason);
    }

    /// Says what is wrong, once, and when it is tried again.
    pub(super) fn suffer(&mut self, reason: String) {
        let retry = SystemClock.now() + SECOND_NS;
        if let Some(fault) = &mut self.fault {
            fault.retry = retry;
            return;
        }
        self.counters.recording_faults.one();
        tracing::error!("nothing is recorded, the stream goes on; tried again each second: {reason}");
        self.state.fault(Some(reason.clone()));
        self.fault = Some(Fault { reason, lost: 0, retry });
    }

    pub(super) fn lose(&mut self, entries: u64) {
        if let Some(fault) = &mut self.fault {
            fault.lost += entries;
            self.counters.recording_lost.add(entries);
        }
    }
}
