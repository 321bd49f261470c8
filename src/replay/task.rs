//! The task of a daemon that replays: in place of acquisition, centering and estimation. Nothing steers here: what the
//! loop did then comes with the samples.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::sleep;
use tokio_util::sync::CancellationToken;

use super::pace::Pace;
use super::tape::{Next, Tape};
use super::{Beginning, Engine, Verdict};
use crate::centering::task::Order;
use crate::centering::{LoopState, LoopView};
use crate::clock::{Clock, Mono, NS_PER_S};
use crate::config::{LoopMode, Meaning, ReplayConfig};
use crate::control::AtFast;
use crate::estimation::task::Question;
use crate::estimation::{Estimation, PoseReport, Status};
use crate::monitor::Counters;
use crate::publishing::{PoseFrame, descriptor::Replayed};
use crate::recording::reader::Read;
use crate::recording::{Entry, Keyframe};

/// How often is looked whether something is due: a timer of the runtime is not finer.
const TICK: Duration = Duration::from_millis(1);
/// Most entries that are taken at a time: a pace that this machine cannot keep must not keep it from all else.
const MOST: usize = 1024;
/// How often it is said that nothing is due.
const SILENCE_NS: i64 = 10_000_000;
/// A file that is slow to read is not silence before that.
const SLOW_NS: i64 = NS_PER_S / 2;
/// How often it is logged, at most, that the recording begins again.
const LAPS_NS: i64 = 60 * NS_PER_S;

/// A report with the time at which its signals were taken, nanoseconds of UTC since 1970.
#[derive(Clone, Copy, Debug)]
pub struct Told {
    /// `time` is the present moment in which it was due.
    pub report: PoseReport,
    /// As it was recorded.
    pub time_ns: i64,
    /// Whether that was UTC.
    pub synced: bool,
}

/// Where things go.
#[derive(Debug)]
pub struct Edges<Publish, Means> {
    /// Questions and orders from outside of the fast side.
    pub control: AtFast,
    /// Every report, in the user's frame.
    pub publish: Publish,
    /// What poses mean from the next report on.
    pub means: Means,
}

/// What is replayed, and how.
#[derive(Debug)]
pub struct Recording {
    /// Where it is, and its pace.
    pub config: ReplayConfig,
    /// What it says at its beginning.
    pub beginning: Beginning,
    /// That of the beginning: it says what there is to say while nothing is due.
    pub estimation: Estimation,
    /// Counts what is replayed, as if it came from a source.
    pub counters: Arc<Counters>,
}

/// Runs until `stop`.
pub async fn run<C: Clock>(
    recording: Recording,
    clock: C,
    edges: Edges<impl FnMut(&Told), impl FnMut(&Meaning)>,
    stop: CancellationToken,
) {
    let Edges { control, publish, means } = edges;
    let AtFast { changes: _changes, mut questions, mut orders } = control;
    let mut player = Player::new(recording, clock, publish, means);
    loop {
        tokio::select! {
            biased;
            () = stop.cancelled() => break,
            Some(question) = questions.recv() => match question {
                // Who does not wait for the answer any more does not need it.
                Question::Last(reply) => drop(reply.send(player.last)),
                Question::Mean(_, reply) => drop(reply),
            },
            Some(order) = orders.recv() => player.obey(order),
            () = sleep(TICK) => player.play(),
        }
    }
}

struct Player<C, Publish, Means> {
    config: ReplayConfig,
    counters: Arc<Counters>,
    clock: C,
    publish: Publish,
    means: Means,
    tape: Tape,
    pace: Pace,
    waits: Option<Entry>,
    engine: Engine,
    verdict: Verdict,
    /// What is said while nothing is due.
    quiet: Estimation,
    patience_ns: i64,
    steering: LoopState,
    last: Option<PoseReport>,
    /// The session in which the last report was recorded; something is missing since then.
    session: Option<u32>,
    hole: bool,
    meaning: Option<u32>,
    /// A recorded moment and its UTC.
    utc: (Mono, i64),
    /// When something was due last; none before the first. When something was told last. When the log was told that
    /// it begins again.
    heard: Option<Mono>,
    told: Mono,
    logged: Option<Mono>,
}

impl<C: Clock, Publish: FnMut(&Told), Means: FnMut(&Meaning)> Player<C, Publish, Means> {
    fn new(recording: Recording, clock: C, publish: Publish, means: Means) -> Self {
        let Recording { config, beginning, estimation: mut quiet, counters } = recording;
        let (now, utc) = (clock.now(), beginning.first);
        let pace = Pace::new(config.speed, utc.0, now);
        quiet.source(beginning.source.as_ref().is_some_and(|source| source.simulated));
        let Replayed { file, recorded, speed, repeat } = beginning.told(&config);
        tracing::info!(file, recorded, speed, repeat, "a recording is replayed");
        Self {
            tape: Tape::new(config.file.clone()),
            config,
            counters,
            clock,
            publish,
            means,
            pace,
            waits: None,
            engine: Engine::new(),
            verdict: Verdict::default(),
            quiet,
            patience_ns: pace.patience_ns(beginning.rate_hz()),
            steering: LoopState::default(),
            last: None,
            session: None,
            hole: false,
            meaning: Some(beginning.meaning.id()),
            utc,
            heard: None,
            told: now,
            logged: None,
        }
    }

    fn obey(&self, order: Order) {
        const WHY: &str = "a recording is replayed: nothing steers";
        match order {
            Order::Retune(_, done) => drop(done.send(())),
            Order::Move(_, reply) | Order::Search(reply) => drop(reply.send(Err(WHY))),
            Order::View(reply) => drop(reply.send(self.view())),
        }
    }

    fn view(&self) -> LoopView {
        let sampled = self.last.filter(|report| !report.status.has(Status::SOURCE_DOWN));
        LoopView {
            mode: LoopMode::Off,
            lock: self.last.map_or(self.steering.lock, |report| report.lock),
            offset: sampled.and_then(|report| report.offset),
            velocity: None,
            commanded: sampled.and(self.steering.position),
            shadow: None,
            attempts: 0,
        }
    }

    /// Takes all that is due, and says so if that is nothing.
    fn play(&mut self) {
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
                    self.hole();
                }
                Next::Read(Read::Damage(damage)) => {
                    tracing::warn!(%damage, "the recording is damaged");
                    self.lose();
                }
                Next::Read(Read::Foreign { meaning, source, why }) => {
                    if let Err(failure) = self.engine.cold(&meaning, source.as_ref()) {
                        tracing::error!(%failure, "the recording cannot be replayed");
                    } else {
                        tracing::warn!(why, "poses are not those of the recording bit by bit");
                    }
                    self.go_on_with(&meaning);
                }
                Next::End => self.lap(),
                Next::Later | Next::Nothing => return None,
            }
        }
    }

    /// The recording is at its end, for good or for now.
    fn lap(&mut self) {
        let Verdict { same: identical, other: different, .. } = self.verdict;
        (self.engine, self.verdict) = (Engine::new(), Verdict::default());
        self.counters.replay_ends.one();
        // One without a single sample would begin again for ever.
        if !(self.config.repeat && self.heard.is_some()) {
            tracing::info!(identical, different, "the recording is at its end");
            return;
        }
        self.tape.again();
        self.pace.anew();
        (self.heard, self.session, self.hole) = (None, None, false);
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
        self.hole();
    }

    /// Something is missing from here to the next frame: one hole, however often that is found.
    fn hole(&mut self) {
        let known = std::mem::replace(&mut self.hole, true);
        self.counters.replay_holes.add(u64::from(!known));
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
            Entry::Keyframe(keyframe) => self.go_on_with(&keyframe.meaning),
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
            self.recorded(&report, frame);
        }
    }

    /// As the tasks count it whose work this was.
    fn count(&self, entry: &Entry) {
        let counters = &self.counters;
        match entry {
            Entry::Sample { sample, .. } => {
                counters.scans.one();
                counters.scans_lost.add(sample.lost.into());
            }
            Entry::Silence { why: Some(_), .. } => counters.source_downs.one(),
            Entry::Lock { after, .. } => counters.lock(*after).one(),
            _ => {}
        }
    }

    /// Takes over what a keyframe says of configuration and source.
    fn go_on_with(&mut self, meaning: &Meaning) {
        let id = meaning.id();
        if self.meaning.replace(id) != Some(id) {
            (self.means)(meaning);
        }
        let Some(Keyframe { source, .. }) = self.engine.now() else { return };
        let rate_hz = source.map_or(meaning.config.acquisition.rate_hz, |source| source.rate_hz);
        self.patience_ns = self.pace.patience_ns(rate_hz);
        if let Some(estimation) = self.engine.estimation() {
            self.quiet = estimation.clone();
        }
    }

    /// Tells a report of a recorded moment.
    fn recorded(&mut self, report: &PoseReport, frame: &PoseFrame) {
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
        report.time = self.pace.present(report.time);
        self.tell(&report, frame.time_ns, !frame.status.has(Status::CLOCK_UNSYNCED));
    }

    /// Samples that are missing before the first report behind a hole, by their index.
    fn missing(&self, report: &PoseReport, session: u32) -> u32 {
        let before = self.last.filter(|_| self.hole && self.session == Some(session));
        let Some(before) = before.filter(|_| report.averaged > 0) else { return 0 };
        let missing = report.index.saturating_sub(before.index).saturating_sub(report.averaged.into());
        missing.try_into().unwrap_or(u32::MAX)
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
        if now - heard < patience_ns || now - self.told < SILENCE_NS {
            return;
        }
        let (then, utc_ns) = self.utc;
        let time_ns = utc_ns.saturating_add(self.pace.recorded(now) - then);
        let report = self.quiet.silence(now, &self.steering);
        let index = self.last.map_or(0, |last| last.index);
        self.tell(&PoseReport { index, ..report }, time_ns, true);
    }

    fn tell(&mut self, report: &PoseReport, time_ns: i64, synced: bool) {
        let now = self.clock.now();
        let report = PoseReport { solved: now, status: report.status | Status::REPLAYED, ..*report };
        (self.last, self.told) = (Some(report), now);
        (self.publish)(&Told { report, time_ns, synced });
    }
}
