//! Publishes the reports of a replay, and adds the samples that are missing in a gap of the recording.

use std::sync::Arc;

use trifacet_core::centering::{CommandBacklog, LoopMode, LoopState, LoopView};
use trifacet_core::estimation::PoseReport;
use trifacet_core::steering::BeamOffset;
use trifacet_core::telemetry::Counters;
use trifacet_core::time::{Clock, Mono};
use trifacet_wire::{PoseFrame, Status};

/// A report with the recorded time of its signals, nanoseconds of UTC since 1970.
#[derive(Clone, Copy, Debug)]
pub struct Republished {
    /// Its `time` is the present time at which it was due.
    pub report: PoseReport,
    /// The recorded time.
    pub time_ns: i64,
    /// Whether the recorded time was synchronized to UTC.
    pub synced: bool,
}

/// Publishes reports and keeps the last one.
#[derive(Debug)]
pub struct Republisher<C, Publish> {
    clock: C,
    publish: Publish,
    counters: Arc<Counters>,
    /// The last report.
    pub last: Option<PoseReport>,
    /// Time of publishing it; initially the start.
    pub published_at: Mono,
    /// Session in which the last report of a sample was recorded.
    session: Option<u32>,
    /// There has been a gap since then.
    hole: bool,
}

impl<C: Clock, Publish: FnMut(&Republished)> Republisher<C, Publish> {
    /// A republisher that has published nothing yet.
    pub fn new(clock: C, publish: Publish, counters: Arc<Counters>) -> Self {
        let published_at = clock.now();
        Self { clock, publish, counters, last: None, published_at, session: None, hole: false }
    }

    /// Notes a gap up to the next report of a sample. Several calls for the same gap count once.
    pub fn hole(&mut self) {
        let known = std::mem::replace(&mut self.hole, true);
        self.counters.replay_holes.add(u64::from(!known));
    }

    /// Notes that the next report does not continue the previous ones.
    pub fn anew(&mut self) {
        (self.session, self.hole) = (None, false);
    }

    /// Publishes a report of a recorded frame. The time of `report` is the present time.
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

    /// Publishes a report that there are no samples.
    pub fn silence(&mut self, report: &PoseReport, time_ns: i64) {
        let index = self.last.map_or(0, |last| last.index);
        self.tell(&PoseReport { index, ..*report }, time_ns, true);
    }

    /// The state of the loop; `steering` is its recorded state.
    pub fn view(&self, steering: &LoopState) -> LoopView {
        let sampled = self.last.filter(|report| !report.status.has(Status::SOURCE_DOWN));
        LoopView {
            backlog: CommandBacklog::default(),
            delay_s: None,
            mode: LoopMode::Off,
            lock: self.last.map_or(steering.lock, |report| report.lock),
            offset: sampled.and_then(|report| report.offset).map(BeamOffset),
            velocity: None,
            commanded: sampled.and(steering.position),
            shadow: None,
            attempts: 0,
        }
    }

    /// Samples missing before the first report after a gap, from their index.
    fn missing(&self, report: &PoseReport, session: u32) -> u32 {
        let before = self.last.filter(|_| self.hole && self.session == Some(session));
        let Some(before) = before.filter(|_| report.averaged > 0) else { return 0 };
        let missing = report.index.saturating_sub(before.index).saturating_sub(report.averaged.into());
        missing.try_into().unwrap_or(u32::MAX)
    }

    fn tell(&mut self, report: &PoseReport, time_ns: i64, synced: bool) {
        let now = self.clock.now();
        let report = PoseReport { solved: now, status: report.status | Status::REPLAYED, ..*report };
        (self.last, self.published_at) = (Some(report), now);
        (self.publish)(&Republished { report, time_ns, synced });
    }
}
