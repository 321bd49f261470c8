//! Begins and ends files.

use std::sync::atomic::Ordering;

use trifacet_core::time::{Clock, Mono};

use super::fault_reason::FaultReason;
use super::{ROOM, Recorder, leftovers};
use crate::clock::SystemClock;
use crate::clock::utc::read_clocks;
use crate::config::RecordingMode;
use crate::recording::budget::in_future;
use crate::recording::codec::Encoded;
use crate::recording::output::Output;
use crate::recording::ring::Ring;

impl Recorder {
    /// Creates the folder and reports unfinished recordings of earlier runs.
    pub(super) fn look_around(&mut self) {
        if self.config.mode == RecordingMode::Off {
            return;
        }
        if let Err(e) = self.folder.make() {
            tracing::warn!(folder = %self.folder.0.display(), "cannot create recording.folder: {e}");
        }
        let all = self.folder.list().unwrap_or_default();
        for left in all.iter().filter(|recording| recording.unfinished() && !recording.in_use()) {
            leftovers::report(left);
        }
        let now_ns = read_clocks().1;
        let future: Vec<_> = all.iter().filter(|recording| in_future(recording, now_ns)).collect();
        if let Some(first) = future.first() {
            tracing::warn!(
                files = future.len(),
                first = %first.path.display(),
                "recordings have names later than the present time; for recording.budget_gb they count as the \
                 oldest; the clock is wrong, or was wrong when they were recorded"
            );
        }
    }

    /// Whether a keyframe is needed before its time: a file is to begin or to end.
    pub(super) fn waits_for_keyframe(&self, now: Mono) -> bool {
        let begins = self.fresh && self.output.is_some();
        begins || self.over() || self.full(now) || self.due(now)
    }

    /// Whether the recording is past its end, with all of the ring in the file.
    fn over(&self) -> bool {
        self.until.is_some_and(|until| self.latest >= until) && !self.filling()
    }

    /// Whether the file has reached its largest size or age.
    fn full(&self, now: Mono) -> bool {
        self.output.as_ref().is_some_and(|output| {
            output.bytes() as f64 >= self.config.rotate_mb * 1e6
                || now.seconds_since(output.since) >= self.config.rotate_min * 60.0
        })
    }

    /// Whether a file is to be opened now.
    fn due(&self, now: Mono) -> bool {
        let time = self.fault.as_ref().is_none_or(|fault| now >= fault.retry);
        self.wanted && self.output.is_none() && time
    }

    /// At a keyframe: reports missing entries, ends a file that is due to end, and begins a due one.
    pub(super) fn cut(&mut self, now: Mono) {
        self.write_gap();
        if self.over() {
            (self.wanted, self.until) = (false, None);
            self.end();
            self.well();
        } else if self.full(now) {
            self.end();
        }
        if self.due(now)
            && let Err(reason) = self.resume()
        {
            self.suffer(reason);
        }
        self.write_gap();
    }

    /// Opens a new file, and clears the fault.
    pub(super) fn resume(&mut self) -> Result<(), FaultReason> {
        self.open()?;
        if let Some(fault) = self.fault.take() {
            let reason = fault.reason.to_string();
            tracing::info!(lost = fault.lost, after = reason, "recording continues in a new file");
            self.miss(fault.lost, &reason);
            self.show();
        }
        Ok(())
    }

    /// Deletes old recordings if necessary, and opens a file.
    fn open(&mut self) -> Result<(), FaultReason> {
        self.wake();
        let folder = || self.folder.0.clone();
        let unusable = |source| FaultReason::Folder { folder: folder(), source };
        self.folder.make().map_err(unusable)?;
        let next = (self.config.rotate_mb * 1e6) as u64;
        let deleted = self
            .budget
            .make_room(&self.folder, next, read_clocks().1)
            .map_err(|source| FaultReason::List { folder: folder(), source })?;
        for old in deleted {
            self.counters.recording_deletions.inc();
            tracing::info!(file = %old.path.display(), bytes = old.bytes, "deleted to stay within recording.budget_gb");
        }
        let free = self.folder.free().map_err(unusable)?;
        self.state.free.store(free, Ordering::Relaxed);
        if free < ROOM {
            return Err(FaultReason::NoSpace { folder: folder(), free });
        }
        let begin_ns = self.ring.as_ref().and_then(Ring::begin_ns).unwrap_or_else(|| self.encoder.now_ns());
        let output = Output::begin(&self.folder, begin_ns, SystemClock.now(), self.compression)
            .map_err(|source| FaultReason::Create { folder: folder(), source })?;
        tracing::info!(file = %output.path.display(), "recording");
        self.counters.recording_files.inc();
        self.budget.began(&output.path);
        self.state.file(Some(output.path.clone()));
        self.encoder.restart();
        self.output = Some(output);
        Ok(())
    }

    /// Writes to the ring or the file that entries are missing before this point.
    fn write_gap(&mut self) {
        let Self { encoder, output, ring, unwritten, .. } = self;
        let Some((entries, why)) = unwritten.take_if(|(entries, _)| *entries > 0) else { return };
        let written = match (ring, output) {
            (Some(ring), _) => ring.gap(encoder, entries, &why),
            (None, Some(output)) => encoder.gap(entries, &why, |message| output.put(message).map(|_| ())),
            (None, None) => return *unwritten = Some((entries, why)),
        };
        if let Err(e) = written {
            self.fail(e);
        }
    }

    /// Moves the oldest segment of the ring into the file. Returns false if there is nothing to move.
    pub(super) fn fill(&mut self, now: Mono) -> bool {
        let Self { output: Some(output), ring: Some(ring), counters, .. } = self else { return false };
        let mut put = |message: Encoded<'_>| {
            counters.recording_messages.add(output.put(message)?.into());
            Ok(())
        };
        let moved = match ring.drain(&mut put) {
            // The open segment is the last one.
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
            self.fail(e);
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

    /// Ends the file.
    pub(super) fn end(&mut self) {
        if let Some(Err(e)) = self.output.as_mut().map(Output::flush) {
            return self.fail(e);
        }
        let Some(output) = self.output.take() else { return };
        self.counters.recording_bytes.add(output.news());
        self.state.file(None);
        let file = output.path.clone();
        match output.finish(&mut self.disk) {
            Ok(true) => self.state.finished(file.with_extension("")), // without .part
            Ok(false) => tracing::info!("no samples received: empty recording removed"),
            Err(source) => self.suffer(FaultReason::Finish { file, source }),
        }
    }

    /// Clears the fault after the end of a recording, and starts a new ring.
    fn well(&mut self) {
        (self.fault, self.unwritten) = (None, None);
        self.show();
        if self.config.mode == RecordingMode::OnFault && self.ring.is_none() {
            self.ring = Some(Ring::new(self.config.before_s, self.compression));
        }
    }
}
