//! What comes out of a recording, told at present: with what is missing behind a hole.

use std::sync::Arc;

use trifacet_core::centering::{LoopMode, LoopState, LoopView};
use trifacet_core::estimation::PoseReport;
use trifacet_core::telemetry::Counters;
use trifacet_core::time::{Clock, Mono};
use trifacet_wire::{PoseFrame, Status};

/// A report with the time at which its signals were taken, nanoseconds of UTC since 1970.
#[derive(Clone, Copy, Debug)]
pub struct Republished {
    /// `time` is the present moment in which it was due.
    pub report: PoseReport,
    /// As it was recorded.
    pub time_ns: i64,
    /// Whether that was UTC.
    pub synced: bool,
}

/// Tells reports, and remembers the last.
#[derive(Debug)]
pub struct Republisher<C, Publish> {
    clock: C,
    publish: Publish,
    counters: Arc<Counters>,
    /// The last report.
    pub last: Option<PoseReport>,
    /// When it was told; at the start, when that was.
    pub told: Mono,
    /// The session in which the last report of a sample was recorded.
    session: Option<u32>,
    /// Something is missing since then.
    hole: bool,
}

impl<C: Clock, Publish: FnMut(&Republished)> Republisher<C, Publish> {
    /// Nothing was told yet.
    pub fn new(clock: C, publish: Publish, counters: Arc<Counters>) -> Self {
        let told = clock.now();
        Self { clock, publish, counters, last: None, told, session: None, hole: false }
    }

    /// Something is missing from here to the next report of a sample: one hole, however often that is found.
    pub fn hole(&mut self) {
        let known = std::mem::replace(&mut self.hole, true);
        self.counters.replay_holes.add(u64::from(!known));
    }

    /// What comes next does not follow on what was before.
    pub fn anew(&mut self) {
        (self.session, self.hole) = (None, false);
    }

    /// Tells a report, whose time is that of the present, as the frame was told.
    pub fn recorded(&mut self, report: &PoseReport, frame: &PoseFrame) {
        let mut report = *report;
        let missing = self.missing(&report, frame.session);
        if missing > report.lost {
            self.counters.scans_lost.add(u64::from(missing - report.lost));
            report.lost = missing;
            report.status |= Status::SAMPLE_GAP;
        }
        if report.averaged > 0 {
            (self.session, self.hole) = (Some(frame.session), false);
        }
        self.tell(&report, frame.time_ns, !frame.status.has(Status::CLOCK_UNSYNCED));
    }

    /// Tells that no samples come.
    pub fn silence(&mut self, report: &PoseReport, time_ns: i64) {
        let index = self.last.map_or(0, |last| last.index);
        self.tell(&PoseReport { index, ..*report }, time_ns, true);
    }

    /// What is known of the loop, whose state then was `steering`.
    pub fn view(&self, steering: &LoopState) -> LoopView {
        let sampled = self.last.filter(|report| !report.status.has(Status::SOURCE_DOWN));
        LoopView {
            mode: LoopMode::Off,
            lock: self.last.map_or(steering.lock, |report| report.lock),
            offset: sampled.and_then(|report| report.offset),
            velocity: None,
            commanded: sampled.and(steering.position),
            shadow: None,
            attempts: 0,
        }
    }

    /// Samples that are missing before the first report behind a hole, by their index.
    fn missing(&self, report: &PoseReport, session: u32) -> u32 {
        let before = self.last.filter(|_| self.hole && self.session == Some(session));
        let Some(before) = before.filter(|_| report.averaged > 0) else { return 0 };
        let missing = report.index.saturating_sub(before.index).saturating_sub(report.averaged.into());
        missing.try_into().unwrap_or(u32::MAX)
    }

    fn tell(&mut self, report: &PoseReport, time_ns: i64, synced: bool) {
        let now = self.clock.now();
        let report = PoseReport { solved: now, status: report.status | Status::REPLAYED, ..*report };
        (self.last, self.told) = (Some(report), now);
        (self.publish)(&Republished { report, time_ns, synced });
    }
}
