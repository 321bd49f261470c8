//! The entries of a recording as they are due, and what is said where none are.

use std::sync::Arc;

use trifacet_core::centering::LoopState;
use trifacet_core::estimation::{Estimation, PoseReport};
use trifacet_core::telemetry::Counters;
use trifacet_core::time::{Clock, Mono, NS_PER_S};
use trifacet_wire::stream::Replayed;

use super::pace::Pace;
use super::playback::{Next, Playback};
use super::republisher::{Republished, Republisher};
use super::task::Recording;
use super::{Comparison, Engine};
use crate::centering::CenteringRequest;
use crate::config::{CalibrationContext, ReplayConfig};
use crate::recording::reader::Read;
use crate::recording::{Entry, Keyframe};

/// Most entries that are taken at a time: a pace that this machine cannot keep must not keep it from all else.
const MOST: usize = 1024;
/// How often it is said that nothing is due.
const SILENCE_NS: i64 = 10_000_000;
/// A file that is slow to read is not silence before that.
const SLOW_NS: i64 = NS_PER_S / 2;
/// How often it is logged, at most, that the recording begins again.
const LAPS_NS: i64 = 60 * NS_PER_S;

pub(super) struct Player<C, Publish, Means> {
    config: ReplayConfig,
    counters: Arc<Counters>,
    clock: C,
    means: Means,
    teller: Republisher<C, Publish>,
    tape: Playback,
    pace: Pace,
    waits: Option<Entry>,
    engine: Engine,
    verdict: Comparison,
    /// What is said while nothing is due.
    quiet: Estimation,
    patience_ns: i64,
    steering: LoopState,
    context: Option<u32>,
    /// A recorded moment and its UTC.
    utc: (Mono, i64),
    /// When something was due last; none before the first.
    heard: Option<Mono>,
    /// When the log was told that it begins again.
    logged: Option<Mono>,
}

impl<C: Clock, Publish: FnMut(&Republished), Means: FnMut(&CalibrationContext)> Player<C, Publish, Means> {
    pub(super) fn new(recording: Recording, clock: C, publish: Publish, means: Means) -> Self {
        let Recording { config, beginning, estimation: mut quiet, counters } = recording;
        let (now, utc) = (clock.now(), beginning.first);
        let pace = Pace::new(config.speed, utc.0, now);
        quiet.source(beginning.source.as_ref().is_some_and(|source| source.simulated));
        let Replayed { file, recorded, speed, repeat } = beginning.told(&config);
        tracing::info!(file, recorded, speed, repeat, "a recording is replayed");
        Self {
            tape: Playback::new(config.file.clone()),
            config,
            teller: Republisher::new(clock.clone(), publish, Arc::clone(&counters)),
            counters,
            clock,
            means,
            pace,
            waits: None,
            engine: Engine::new(),
            verdict: Comparison::default(),
            quiet,
            patience_ns: pace.patience_ns(beginning.rate_hz()),
            steering: LoopState::default(),
            context: Some(beginning.context.id()),
            utc,
            heard: None,
            logged: None,
        }
    }

    pub(super) fn obey(&self, order: CenteringRequest) {
        const WHY: &str = "a recording is replayed: nothing steers";
        match order {
            CenteringRequest::Retune(_, done) => drop(done.send(())),
            CenteringRequest::Move(_, reply) | CenteringRequest::Search(reply) => drop(reply.send(Err(WHY))),
            CenteringRequest::View(reply) => drop(reply.send(self.teller.view(&self.steering))),
        }
    }

    /// The last report that was told.
    pub(super) fn last(&self) -> Option<PoseReport> {
        self.teller.last
    }

    /// Takes all that is due, and says so if that is nothing.
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

    /// When it is the turn of an entry; now, if it belongs to the one before.
    fn due(&mut self, entry: &Entry, now: Mono) -> Mono {
        let time = match entry {
            Entry::Sample { scan, .. } => scan.time,
            Entry::Silence { time, .. } => *time,
            _ => return now,
        };
        self.heard.get_or_insert(now);
        self.pace.due(time, now)
    }

    /// The next entry, if it is there yet.
    fn next(&mut self) -> Option<Entry> {
        loop {
            match self.tape.take() {
                Next::Read(Read::Entry(entry)) => return Some(entry),
                Next::Read(Read::Gap { entries, reason }) => {
                    tracing::warn!(entries, reason, "not recorded");
                    self.lose();
                }
                Next::Read(Read::Damage(damage)) => {
                    tracing::warn!(%damage, "the recording is damaged");
                    self.lose();
                }
                Next::Read(Read::Foreign { context, source, why }) => {
                    if let Err(failure) = self.engine.cold(&context, source.as_ref()) {
                        tracing::error!(%failure, "the recording cannot be replayed");
                    } else {
                        tracing::warn!(why, "poses are not those of the recording bit by bit");
                    }
                    self.go_on_with(&context);
                }
                Next::End => self.lap(),
                Next::Later | Next::Nothing => return None,
            }
        }
    }

    /// The recording is at its end, for good or for now.
    fn lap(&mut self) {
        let Comparison { same: identical, other: different, .. } = self.verdict;
        (self.engine, self.verdict) = (Engine::new(), Comparison::default());
        self.counters.replay_ends.inc();
        // One without a single sample would begin again for ever.
        if !(self.config.repeat && self.heard.is_some()) {
            tracing::info!(identical, different, "the recording is at its end");
            return;
        }
        self.tape.again();
        self.pace.anew();
        self.teller.anew();
        self.heard = None;
        let now = self.clock.now();
        if self.logged.is_none_or(|logged| now - logged >= LAPS_NS) {
            let times = self.counters.replay_ends.get();
            tracing::info!(identical, different, times, "the recording begins again");
            self.logged = Some(now);
        }
    }

    /// Nothing can be said before the next keyframe.
    fn lose(&mut self) {
        self.engine.hole();
        self.verdict.hole();
        self.teller.hole();
    }

    fn take(&mut self, entry: &Entry, now: Mono) {
        let passed_over = self.engine.passed_over;
        if let Err(failure) = self.engine.take(entry) {
            tracing::error!(%failure, "the recording cannot be replayed");
            return self.lose();
        }
        if self.engine.passed_over == passed_over {
            self.count(entry);
        }
        match entry {
            Entry::Sample { steering, .. } | Entry::Silence { steering, .. } => {
                self.steering = *steering;
                if self.engine.passed_over == passed_over {
                    self.heard = Some(now);
                }
            }
            Entry::Keyframe(keyframe) => self.go_on_with(&keyframe.context),
            Entry::Frame { frame, time, .. } => self.utc = (*time, frame.time_ns),
            Entry::Lock { .. } => {}
        }
        let different = self.verdict.other;
        let pair = self.verdict.take(entry, self.engine.report()).is_some();
        if different == 0 && self.verdict.other == 1 {
            tracing::warn!(first = ?self.verdict.first, "poses are not those of the recording");
        }
        if let Entry::Frame { frame, .. } = entry
            && let Some(report) = self.engine.report().copied().filter(|_| pair)
        {
            let time = self.pace.present(report.time);
            self.teller.recorded(&PoseReport { time, ..report }, frame);
        }
    }

    /// As the tasks count it whose work this was.
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

    /// Takes over what a keyframe says of configuration and source.
    fn go_on_with(&mut self, context: &CalibrationContext) {
        let id = context.id();
        if self.context.replace(id) != Some(id) {
            (self.means)(context);
        }
        let Some(Keyframe { source, .. }) = self.engine.now() else { return };
        let rate_hz = source.map_or(context.config.acquisition.rate_hz, |source| source.rate_hz);
        self.patience_ns = self.pace.patience_ns(rate_hz);
        if let Some(estimation) = self.engine.estimation() {
            self.quiet = estimation.clone();
        }
    }

    /// In a hole, and behind the end, no samples come, and that is said.
    fn silence(&mut self, now: Mono) {
        let heard = match self.heard {
            Some(heard) => heard,
            None if self.tape.over() => *self.heard.insert(now),
            None => return,
        };
        let known = self.waits.is_some() || self.tape.over();
        let patience_ns = if known { self.patience_ns } else { self.patience_ns.max(SLOW_NS) };
        if now - heard < patience_ns || now - self.teller.told < SILENCE_NS {
            return;
        }
        let (then, utc_ns) = self.utc;
        let since_ns = self.pace.recorded(now).0.saturating_sub(then.0);
        let report = self.quiet.silence(now, &self.steering);
        self.teller.silence(&report, utc_ns.saturating_add(since_ns));
    }
}
