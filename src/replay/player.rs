//! Processes the entries of a recording when they are due, and reports silence in between.

use std::sync::Arc;
use std::time::Duration;

use trifacet_core::centering::{LoopRefusal, LoopState};
use trifacet_core::estimation::{Estimation, PoseReport};
use trifacet_core::telemetry::Counters;
use trifacet_core::time::{Clock, Mono, NS_PER_S};
use trifacet_wire::stream::Replayed;

use super::pace::Pace;
use super::playback::{Next, Playback};
use super::republisher::{Republished, Republisher};
use super::{Comparison, Engine, RecordingHeader};
use crate::centering::CenteringRequest;
use crate::config::{CalibrationContext, ReplayConfig};
use crate::recording::reader::Read;
use crate::recording::{Entry, Keyframe};

/// Most entries per call: a speed that this machine cannot reach must not block the other tasks.
const MOST: usize = 1024;
/// Interval of reports of silence.
const SILENCE_NS: i64 = 10_000_000;
/// A file that is read slowly counts as silence only after this time.
const SLOW_NS: i64 = NS_PER_S / 2;
/// Shortest interval of log lines about the restart of the recording.
const LAPS_NS: i64 = 60 * NS_PER_S;

/// The recording to replay.
#[derive(Debug)]
pub struct Recording {
    /// File, speed and repetition.
    pub config: ReplayConfig,
    /// The shortest silence that is reported.
    pub silence: Duration,
    /// Beginning of the recording.
    pub header: RecordingHeader,
    /// Estimation with the first configuration. It makes the reports of silence.
    pub estimation: Estimation,
    /// Counters; replayed entries count as if they came from a source.
    pub counters: Arc<Counters>,
}

pub(super) struct Player<C, Publish, Means> {
    config: ReplayConfig,
    counters: Arc<Counters>,
    clock: C,
    means: Means,
    republisher: Republisher<C, Publish>,
    playback: Playback,
    pace: Pace,
    waits: Option<Entry>,
    engine: Engine,
    comparison: Comparison,
    /// Makes the reports of silence.
    silence_estimation: Estimation,
    /// The shortest silence that is reported.
    silence: Duration,
    patience_ns: i64,
    steering: LoopState,
    context: Option<u32>,
    /// A recorded time and its UTC.
    utc: (Mono, i64),
    /// Time of the last entry that was due; `None` before the first one.
    last_arrival: Option<Mono>,
    /// Time of the last log line about a restart.
    logged: Option<Mono>,
}

impl<C: Clock, Publish: FnMut(&Republished), Means: FnMut(&CalibrationContext)> Player<C, Publish, Means> {
    pub(super) fn new(recording: Recording, clock: C, publish: Publish, means: Means) -> Self {
        let Recording { config, silence, header, estimation: mut silence_estimation, counters } = recording;
        let (now, utc) = (clock.now(), header.first);
        let pace = Pace::new(config.speed, utc.0, now);
        if let Some(source) = &header.source {
            silence_estimation.source(Arc::clone(source));
        }
        let Replayed { file, recorded, speed, repeat } = header.replayed(&config);
        tracing::info!(file, recorded, speed, repeat, "replaying a recording");
        Self {
            playback: Playback::new(config.file.clone()),
            config,
            republisher: Republisher::new(clock.clone(), publish, Arc::clone(&counters)),
            counters,
            clock,
            means,
            pace,
            waits: None,
            engine: Engine::new(),
            comparison: Comparison::default(),
            silence_estimation,
            silence,
            patience_ns: pace.patience_ns(header.rate_hz(), silence),
            steering: LoopState::default(),
            context: Some(header.context.id()),
            utc,
            last_arrival: None,
            logged: None,
        }
    }

    pub(super) fn obey(&self, order: CenteringRequest) {
        match order {
            CenteringRequest::Retune(_, done) => drop(done.send(())),
            CenteringRequest::Move(_, reply) => drop(reply.send(Err(LoopRefusal::NoStage))),
            CenteringRequest::Search(reply) => drop(reply.send(Err(LoopRefusal::NoStage))),
            CenteringRequest::View(reply) => drop(reply.send(self.republisher.view(&self.steering))),
        }
    }

    /// The last report published.
    pub(super) fn last(&self) -> Option<PoseReport> {
        self.republisher.last
    }

    /// Processes all entries that are due. Reports silence if no entry is due.
    pub(super) fn play(&mut self) {
        let now = self.clock.now();
        for _ in 0..MOST {
            let Some(entry) = self.waits.take().or_else(|| self.next()) else { break };
            if self.due(&entry, now) > now {
                self.waits = Some(entry);
                break;
            }
            self.take(&entry, now);
        }
        self.silence(now);
    }

    /// The time at which an entry is due. Entries that belong to the previous one are due now.
    fn due(&mut self, entry: &Entry, now: Mono) -> Mono {
        let time = match entry {
            Entry::Sample { scan, .. } => scan.time,
            Entry::Silence { time, .. } => *time,
            _ => return now,
        };
        self.last_arrival.get_or_insert(now);
        self.pace.due(time, now)
    }

    /// The next entry, if it has been read.
    fn next(&mut self) -> Option<Entry> {
        loop {
            match self.playback.take() {
                Next::Read(Read::Entry(entry)) => return Some(entry),
                Next::Read(Read::Gap { entries, reason }) => {
                    tracing::warn!(entries, reason, "the recording has a gap");
                    self.lose();
                }
                Next::Read(Read::Damage(damage)) => {
                    tracing::warn!(%damage, "the recording is damaged");
                    self.lose();
                }
                Next::Read(Read::Foreign { context, source, why }) => {
                    if let Err(failure) = self.engine.cold(&context, source.as_ref()) {
                        tracing::error!(%failure, "cannot replay the recording");
                    } else {
                        tracing::warn!(why, "poses are not identical bit by bit to those of the recording");
                    }
                    self.go_on_with(&context);
                }
                Next::End => self.lap(),
                Next::Later | Next::Nothing => return None,
            }
        }
    }

    /// Handles the end of the recording: ends or starts again.
    fn lap(&mut self) {
        let Comparison { same: identical, other: different, .. } = self.comparison;
        (self.engine, self.comparison) = (Engine::new(), Comparison::default());
        self.counters.replay_ends.inc();
        // A recording without a single sample would start again without end.
        if !(self.config.repeat && self.last_arrival.is_some()) {
            tracing::info!(identical, different, "the recording is at its end");
            return;
        }
        self.playback.again();
        self.pace.anew();
        self.republisher.anew();
        self.last_arrival = None;
        let now = self.clock.now();
        if self.logged.is_none_or(|logged| now - logged >= LAPS_NS) {
            let times = self.counters.replay_ends.get();
            tracing::info!(identical, different, times, "the recording begins again");
            self.logged = Some(now);
        }
    }

    /// Handles a gap: nothing can be computed before the next keyframe.
    fn lose(&mut self) {
        self.engine.hole();
        self.comparison.hole();
        self.republisher.hole();
    }

    fn take(&mut self, entry: &Entry, now: Mono) {
        let passed_over = self.engine.passed_over;
        if let Err(failure) = self.engine.take(entry) {
            tracing::error!(%failure, "cannot replay the recording");
            return self.lose();
        }
        if self.engine.passed_over == passed_over {
            self.count(entry);
        }
        match entry {
            Entry::Sample { steering, .. } | Entry::Silence { steering, .. } => {
                self.steering = *steering;
                if self.engine.passed_over == passed_over {
                    self.last_arrival = Some(now);
                }
            }
            Entry::Keyframe(keyframe) => self.go_on_with(&keyframe.context),
            Entry::Frame { frame, time, .. } => self.utc = (*time, frame.time_ns),
            Entry::Lock { .. } => {}
        }
        let different = self.comparison.other;
        let pair = self.comparison.take(entry, self.engine.report()).is_some();
        if different == 0 && self.comparison.other == 1 {
            tracing::warn!(first = ?self.comparison.first, "poses differ from those of the recording");
        }
        if let Entry::Frame { frame, .. } = entry
            && let Some(report) = self.engine.report().copied().filter(|_| pair)
        {
            let time = self.pace.present(report.time);
            self.republisher.recorded(&PoseReport { time, ..report }, frame);
        }
    }

    /// Counts an entry as the tasks that a replay replaces would.
    fn count(&self, entry: &Entry) {
        let counters = &self.counters;
        match entry {
            Entry::Sample { sample, .. } => {
                counters.scans.inc();
                counters.scans_lost.add(sample.lost.into());
            }
            Entry::Silence { why: Some(_), .. } => counters.source_downs.inc(),
            Entry::Lock { after, .. } => counters.lock(*after).inc(),
            _ => {}
        }
    }

    /// Takes over configuration and source of a keyframe.
    fn go_on_with(&mut self, context: &CalibrationContext) {
        let id = context.id();
        if self.context.replace(id) != Some(id) {
            (self.means)(context);
        }
        let Some(Keyframe { source, .. }) = self.engine.now() else { return };
        let rate_hz = source.map_or(context.config.acquisition.rate_hz, |source| source.rate_hz);
        self.patience_ns = self.pace.patience_ns(rate_hz, self.silence);
        if let Some(estimation) = self.engine.estimation() {
            self.silence_estimation = estimation.clone();
        }
    }

    /// Reports silence in a gap and after the end.
    fn silence(&mut self, now: Mono) {
        let last_arrival = match self.last_arrival {
            Some(last_arrival) => last_arrival,
            None if self.playback.over() => *self.last_arrival.insert(now),
            None => return,
        };
        let known = self.waits.is_some() || self.playback.over();
        let patience_ns = if known { self.patience_ns } else { self.patience_ns.max(SLOW_NS) };
        if now - last_arrival < patience_ns || now - self.republisher.published_at < SILENCE_NS {
            return;
        }
        let (then, utc_ns) = self.utc;
        let since_ns = self.pace.recorded(now).0.saturating_sub(then.0);
        let report = self.silence_estimation.silence(now, &self.steering);
        self.republisher.silence(&report, utc_ns.saturating_add(since_ns));
    }
}
