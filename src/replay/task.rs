//! The task of a daemon that replays: in place of acquisition, centering and estimation. Nothing steers here: what the
//! loop did then comes with the samples.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::Duration;

use tokio::time::sleep;
use tokio_util::sync::CancellationToken;

use super::feed::{self, News};
use super::{Engine, Verdict};
use crate::centering::task::Order;
use crate::centering::{LoopState, LoopView};
use crate::clock::{Clock, Mono};
use crate::config::{LoopMode, Meaning, ReplayConfig};
use crate::control::AtFast;
use crate::estimation::task::Question;
use crate::estimation::{PoseReport, Status};
use crate::exit::{self, Failure};
use crate::recording::reader::Read;
use crate::recording::{Entry, Reader};

/// How often is looked whether something is due: a timer of the runtime is not finer.
const TICK: Duration = Duration::from_millis(1);
/// How often it is said that the recording is at its end.
const SILENCE_NS: i64 = 10_000_000;

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

/// Runs until `stop`.
pub async fn run<C: Clock>(
    config: ReplayConfig,
    clock: C,
    edges: Edges<impl FnMut(&Told), impl FnMut(&Meaning)>,
    stop: CancellationToken,
) {
    let Edges { control, publish, means } = edges;
    let AtFast { changes: _changes, mut questions, mut orders } = control;
    let mut player = Player::new(config, clock, publish, means);
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
    clock: C,
    publish: Publish,
    means: Means,
    news: Option<Receiver<News>>,
    ready: std::vec::IntoIter<Read>,
    waits: Option<Entry>,
    engine: Engine,
    verdict: Verdict,
    steering: LoopState,
    last: Option<PoseReport>,
    id: Option<u32>,
    /// A recorded moment and the present one that belongs to it.
    start: Option<(Mono, Mono)>,
    /// The last recorded moment and its UTC; when it was told.
    end: Option<(Mono, i64, Mono)>,
}

impl<C: Clock, Publish: FnMut(&Told), Means: FnMut(&Meaning)> Player<C, Publish, Means> {
    fn new(config: ReplayConfig, clock: C, publish: Publish, means: Means) -> Self {
        Self {
            news: Some(feed::read(vec![config.file.clone()])),
            config,
            clock,
            publish,
            means,
            ready: Vec::new().into_iter(),
            waits: None,
            engine: Engine::new(),
            verdict: Verdict::default(),
            steering: LoopState::default(),
            last: None,
            id: None,
            start: None,
            end: None,
        }
    }

    fn obey(&self, order: Order) {
        const WHY: &str = "a recording is replayed: nothing steers";
        match order {
            Order::Retune(_, done) => drop(done.send(())),
            Order::Move(_, reply) | Order::Search(reply) => drop(reply.send(Err(WHY))),
            Order::View(reply) => drop(reply.send(LoopView {
                mode: LoopMode::Off,
                lock: self.steering.lock,
                offset: self.last.and_then(|report| report.offset),
                velocity: None,
                commanded: self.steering.position,
                shadow: None,
                attempts: 0,
            })),
        }
    }

    /// Takes all that is due.
    fn play(&mut self) {
        let now = self.clock.now();
        while let Some(entry) = self.waits.take().or_else(|| self.next()) {
            if self.due(&entry, now).is_some_and(|due| due > now) {
                self.waits = Some(entry);
                return;
            }
            self.take(&entry);
        }
        if self.news.is_none() {
            self.ended(now);
        }
    }

    /// When it is the turn of an entry; now, if it belongs to the one before.
    fn due(&mut self, entry: &Entry, now: Mono) -> Option<Mono> {
        let time = match entry {
            Entry::Sample { scan, .. } => scan.time,
            Entry::Silence { time, .. } => *time,
            _ => return None,
        };
        let (then, start) = *self.start.get_or_insert((time, now));
        Some(start + ((time - then) as f64 / self.config.speed) as i64)
    }

    /// The next entry, if it is there yet.
    fn next(&mut self) -> Option<Entry> {
        loop {
            match self.ready.next() {
                Some(Read::Entry(entry)) => return Some(entry),
                Some(Read::Gap { entries, reason }) => tracing::warn!(entries, reason, "not recorded"),
                Some(Read::Damage(damage)) => {
                    tracing::warn!(%damage, "the recording is damaged");
                    self.engine.hole();
                    self.verdict.hole();
                }
                Some(Read::Foreign { meaning, source, why }) => {
                    if let Err(failure) = self.engine.cold(&meaning, source.as_ref()) {
                        tracing::error!(%failure, "the recording cannot be replayed");
                    } else {
                        tracing::warn!(why, "poses are not those of the recording bit by bit");
                    }
                }
                None => self.ready = self.batch()?.into_iter(),
            }
        }
    }

    fn batch(&mut self) -> Option<Vec<Read>> {
        match self.news.as_ref()?.try_recv() {
            Ok(News::Read(reads, _)) => Some(reads),
            Ok(News::End(..)) => Some(Vec::new()),
            Ok(News::Failed(error)) => {
                tracing::error!(%error, "the recording cannot be read");
                self.news = None;
                None
            }
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => {
                let Verdict { same, other, .. } = self.verdict;
                tracing::info!(identical = same, different = other, "the recording is at its end");
                self.news = self.config.repeat.then(|| feed::read(vec![self.config.file.clone()]));
                (self.engine, self.verdict, self.start) = (Engine::new(), Verdict::default(), None);
                None
            }
        }
    }

    fn take(&mut self, entry: &Entry) {
        if let Entry::Sample { steering, .. } | Entry::Silence { steering, .. } = entry {
            self.steering = *steering;
        }
        if let Err(failure) = self.engine.take(entry) {
            tracing::error!(%failure, "the recording cannot be replayed");
            return self.engine.hole();
        }
        if let Entry::Keyframe(keyframe) = entry
            && self.id.replace(keyframe.meaning.id()) != Some(keyframe.meaning.id())
        {
            (self.means)(&keyframe.meaning);
        }
        let different = self.verdict.other;
        let pair = self.verdict.take(entry, self.engine.report()).is_some();
        if different == 0 && self.verdict.other == 1 {
            tracing::warn!(first = ?self.verdict.first, "poses are not those of the recording");
        }
        if let Entry::Frame { frame, .. } = entry
            && let Some(report) = self.engine.report().copied().filter(|_| pair)
        {
            self.tell(&report, frame.time_ns, !frame.status.has(Status::CLOCK_UNSYNCED));
        }
    }

    /// Publishes a report of a recorded moment.
    fn tell(&mut self, report: &PoseReport, time_ns: i64, synced: bool) {
        let now = self.clock.now();
        self.end = Some((report.time, time_ns, now));
        let (then, start) = self.start.unwrap_or((report.time, now));
        let time = start + ((report.time - then) as f64 / self.config.speed) as i64;
        let status = report.status | Status::REPLAYED;
        let report = PoseReport { time, solved: now, status, ..*report };
        self.last = Some(report);
        (self.publish)(&Told { report, time_ns, synced });
    }

    /// Behind the end no samples come, and that is said for ever.
    fn ended(&mut self, now: Mono) {
        let Some((then, time_ns, told)) = self.end else { return };
        if now - told < SILENCE_NS {
            return;
        }
        let (time, steering) = (then + (now - told), self.steering);
        let Some(last) = self.last else { return };
        let of_samples = Status::FATAL | Status::POSE_VALID | Status::STEERING_MEASURED;
        let status = last.status.0 & !of_samples.0 | Status::SOURCE_DOWN.0;
        let report = PoseReport {
            status: Status(status | Status::REPLAYED.0 | Status::NOT_LOCKED.0),
            time,
            lock: steering.lock.unseen(),
            pose: None,
            covariance: None,
            offset: None,
            steering_residual: None,
            iterations: 0,
            averaged: 0,
            lost: 0,
            spots: [f64::NAN; 6],
            powers: [f64::NAN; 3],
            steering: None,
            ..last
        };
        self.tell(&report, time_ns + (now - told), true);
        // What is told at present was taken at present.
        self.start = Some((time, now));
    }
}

/// What poses mean at the beginning of a recording, and its rate, Hz.
///
/// # Errors
/// It cannot be read, or there is no configuration in it.
pub fn beginning(file: &Path) -> Result<(Arc<Meaning>, f64), Failure> {
    let cannot = |why: String| Failure::new(exit::IO, why);
    let mut reader = Reader::open(file, Reader::REPLAY).map_err(|e| cannot(e.to_string()))?;
    while let Some(read) = reader.read().map_err(|e| cannot(e.to_string()))? {
        let (meaning, source) = match read {
            Read::Entry(Entry::Keyframe(keyframe)) => (keyframe.meaning, keyframe.source),
            Read::Foreign { meaning, source, .. } => (meaning, source),
            _ => continue,
        };
        let rate_hz = source.map_or(meaning.config.acquisition.rate_hz, |source| source.rate_hz);
        return Ok((meaning, rate_hz));
    }
    Err(Failure::new(
        exit::DATA,
        format!("{}: no configuration is in it, so nothing can be replayed", file.display()),
    ))
}
