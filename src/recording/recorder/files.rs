//! Files that begin, end, and cannot go on.

use std::sync::atomic::Ordering;

use trifacet_core::time::{Clock, Mono};

use super::{ROOM, Recorder};
use crate::clock::SystemClock;
use crate::config::RecordingMode;
use crate::recording::codec::Encoded;
use crate::recording::output::Output;
use crate::recording::ring::Ring;

impl Recorder {
    /// What is left of another time.
    pub(super) fn look_around(&mut self) {
        if self.config.mode == RecordingMode::Off {
            return;
        }
        if let Err(e) = self.folder.make() {
            tracing::warn!(folder = %self.folder.0.display(), "recording.folder cannot be made: {e}");
        }
        let all = self.folder.list().unwrap_or_default();
        for left in all.iter().filter(|recording| recording.unfinished() && !recording.in_use()) {
            tracing::warn!(
                file = %left.path.display(),
                "a recording was not finished: trifacet recover FILE makes a whole one of it"
            );
        }
    }

    /// Whether a keyframe is wanted before its time: a file is to begin, or to end.
    pub(super) fn waits_for_keyframe(&self, now: Mono) -> bool {
        let begins = self.fresh && self.output.is_some();
        begins || self.over() || self.full(now) || self.due(now)
    }

    /// The recording has come to its end, with everything that was before in it.
    fn over(&self) -> bool {
        self.until.is_some_and(|until| self.latest >= until) && !self.filling()
    }

    /// The file is as large or as old as it may be.
    fn full(&self, now: Mono) -> bool {
        self.output.as_ref().is_some_and(|output| {
            output.bytes() as f64 >= self.config.rotate_mb * 1e6
                || now.seconds_since(output.since) >= self.config.rotate_min * 60.0
        })
    }

    /// A file is wanted, and it is time to try.
    fn due(&self, now: Mono) -> bool {
        let time = self.fault.as_ref().is_none_or(|fault| now >= fault.retry);
        self.wanted && self.output.is_none() && time
    }

    /// At a keyframe: the place where a file may end and the next one begin, and to say what is missing.
    pub(super) fn cut(&mut self, now: Mono) {
        self.tell_gap();
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
        self.tell_gap();
    }

    /// Goes on in a new file.
    pub(super) fn resume(&mut self) -> Result<(), String> {
        self.open()?;
        if let Some(fault) = self.fault.take() {
            tracing::info!(lost = fault.lost, after = fault.reason, "recording goes on in a new file");
            self.miss(fault.lost, &fault.reason);
            self.show();
        }
        Ok(())
    }

    /// Opens a file, after there is room for it.
    fn open(&mut self) -> Result<(), String> {
        self.wake();
        let folder = self.folder.0.display();
        let within =
            |what: &str, e: &dyn std::fmt::Display| format!("{what} in recording.folder, {folder}: {e}");
        self.folder.make().map_err(|e| within("cannot record", &e))?;
        let [budget, next] =
            [self.config.budget_gb * 1e9, self.config.rotate_mb * 1e6].map(|bytes| bytes as u64);
        let deleted = self.folder.make_room(budget, next).map_err(|e| within("cannot look", &e))?;
        for old in deleted {
            self.counters.recording_deletions.inc();
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
        self.counters.recording_files.inc();
        self.state.file(Some(output.path.clone()));
        self.encoder.restart();
        self.output = Some(output);
        Ok(())
    }

    /// Says, where the entries go, what is missing before this.
    fn tell_gap(&mut self) {
        let Self { encoder, output, ring, untold, .. } = self;
        let Some((entries, why)) = untold.take_if(|(entries, _)| *entries > 0) else { return };
        let told = match (ring, output) {
            (Some(ring), _) => ring.gap(encoder, entries, &why),
            (None, Some(output)) => encoder.gap(entries, &why, |message| output.put(message).map(|_| ())),
            (None, None) => return *untold = Some((entries, why)),
        };
        if let Err(e) = told {
            self.fail(&e);
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
        self.counters.recording_bytes.add(output.news());
        self.state.file(None);
        let path = output.path.display().to_string();
        match output.finish(&mut self.disk) {
            Ok(true) => {}
            Ok(false) => tracing::info!("nothing was recorded: no sample came. The file is not kept"),
            Err(e) => {
                self.suffer(format!("cannot finish {path}, trifacet recover makes a whole one of it: {e}"));
            }
        }
    }

    /// Nothing is wanted, so nothing is wrong.
    fn well(&mut self) {
        (self.fault, self.untold) = (None, None);
        self.show();
        if self.config.mode == RecordingMode::OnFault && self.ring.is_none() {
            self.ring = Some(Ring::new(self.config.before_s, self.compression));
        }
    }
}
