//! Data for the pages. Updated on the main thread, read by every request.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use axum::extract::ws::Utf8Bytes;
use tokio::sync::mpsc::error::TryRecvError;
use tokio::sync::{Semaphore, broadcast, mpsc, watch};
use tokio::time::{MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;
use trifacet_core::centering::LoopMode;
use trifacet_core::centering::lock::{LockCause, LockCondition};
use trifacet_core::telemetry::heartbeat::Task;
use trifacet_core::telemetry::{CommandGauge, Counter};
use trifacet_core::time::{Clock, Mono};
use trifacet_wire::stream::Descriptor;
use trifacet_wire::{LockState, PoseFrame, Status};

use super::health::{Causes, Checks, Readiness, Standstill, utc};
use super::page::bins::History;
use super::page::events::{Event, Snapshot};
use super::page::state::PageState;
use super::recent::{RecentStatus, UncertaintyTrend};
use super::tally::Tally;
use crate::clock::SystemClock;
use crate::condition::Condition;
use crate::config::Config;
use crate::control::PageControls;
use crate::doubts::ShownDoubt;
use crate::grade::{Assessment, Evidence, Grade, Limitation};
use crate::publishing::lock_event::lock_event;
use crate::recording::handle::State;

/// Interval of polling for new frames. Frames do not wake the task, so their rate costs little here.
const LOOK: Duration = Duration::from_millis(20);
/// A side of the daemon without progress for longer than this counts as stalled; seconds.
const STANDSTILL_S: f64 = 1.0;
/// While a task stalls, frames of other tasks up to this age count as current; seconds.
const YOUNG_S: f64 = 0.25;
/// Most frames processed at a time.
const BATCH: usize = 16 * 1024;
/// Polls between two updates of the page: ten updates per second.
const UPDATE: u64 = 5;
/// Updates that a viewer may fall behind before it loses the oldest: 1.6 s.
const BEHIND: usize = 16;
/// Most viewers at a time.
const VIEWERS: usize = 64;

/// Sources of the data from the rest of the daemon.
#[derive(Debug)]
pub struct Sources {
    /// The condition of the daemon.
    pub condition: Condition,
    /// The current descriptor of the stream.
    pub descriptor: watch::Receiver<Descriptor>,
    /// The configuration in force.
    pub config: watch::Receiver<Config>,
    /// State of the recorder.
    pub recording: Arc<State>,
    /// The commands without an acknowledgement.
    pub commands: Arc<CommandGauge>,
    /// Control from the page, if enabled.
    pub control: Option<PageControls>,
}

/// Data for the pages.
#[derive(Debug)]
pub struct View {
    /// Sources from the rest of the daemon.
    pub sources: Sources,
    /// Cancelled when the daemon stops. Open connections then end.
    pub ending: CancellationToken,
    newest: watch::Sender<Option<Newest>>,
    aggregates: Mutex<Aggregates>,
    /// Updates of the page, shared by all viewers.
    updates: broadcast::Sender<Utf8Bytes>,
    pub(super) seats: Arc<Semaphore>,
}

/// Aggregates over all frames.
#[derive(Debug)]
pub(super) struct Aggregates {
    /// Time of the last poll for frames.
    looked: Mono,
    /// Time at which the newest frame was seen; initially the start.
    last_arrival: Mono,
    /// Time of the first frame with a stalled task, nanoseconds of UTC since 1970.
    stalled_ns: Option<i64>,
    pub(super) checks: Checks,
    pub(super) tally: Tally,
    recent: RecentStatus,
    uncertainty: UncertaintyTrend,
    page: PageState,
}

/// The newest frame.
#[derive(Clone, Copy, Debug)]
pub struct Newest {
    /// The frame.
    pub frame: PoseFrame,
    /// Time at which the monitor saw it: at most one poll after its transmission, unless the main thread was
    /// delayed.
    pub seen: Mono,
}

impl View {
    /// A view without frames.
    pub fn new(sources: Sources) -> Self {
        let now = SystemClock.now();
        let aggregates = Aggregates {
            looked: now,
            last_arrival: now,
            stalled_ns: None,
            checks: Checks::default(),
            tally: Tally::new(now),
            recent: RecentStatus::default(),
            uncertainty: UncertaintyTrend::default(),
            page: PageState::default(),
        };
        Self {
            sources,
            ending: CancellationToken::new(),
            newest: watch::channel(None).0,
            aggregates: aggregates.into(),
            updates: broadcast::channel(BEHIND).0,
            seats: Arc::new(Semaphore::new(VIEWERS)),
        }
    }

    /// The newest frame, if there is one. The receiver can wait for changes.
    pub fn newest(&self) -> watch::Receiver<Option<Newest>> {
        self.newest.subscribe()
    }

    /// Updates of the page from now on. A viewer that does not keep up loses the oldest (`Lagged`); other
    /// viewers are not affected.
    pub(super) fn updates(&self) -> broadcast::Receiver<Utf8Bytes> {
        self.updates.subscribe()
    }

    /// The history of the axes, up to the newest update.
    pub(super) fn history(&self, span_s: u32) -> History {
        self.aggregates().page.history(span_s)
    }

    /// Number of viewers of the page.
    pub fn viewers(&self) -> usize {
        VIEWERS - self.seats.available_permits()
    }

    /// The parts of the daemon that stall, if any.
    pub fn dead(&self) -> Option<Standstill> {
        let newest_ns = self.newest.borrow().map(|newest| newest.frame.time_ns);
        let period_s = {
            let descriptor = self.sources.descriptor.borrow();
            1.0 / (descriptor.rate_hz * descriptor.replay.as_ref().map_or(1.0, |replay| replay.speed))
        };
        let aggregates = self.aggregates();
        let held_up_s = SystemClock.now().seconds_since(aggregates.looked);
        let silent_s = aggregates.looked.seconds_since(aggregates.last_arrival);
        if held_up_s > STANDSTILL_S {
            let why = format!("the main thread was delayed for {held_up_s:.1} s");
            return Some(Standstill { why, since_ns: newest_ns, silent: true });
        }
        let silent = (silent_s > STANDSTILL_S.max(3.0 * period_s))
            .then(|| format!("the fast side has made no frame for {silent_s:.1} s"));
        let names: Vec<_> = self.sources.condition.heartbeats.stalled().into_iter().map(Task::name).collect();
        let stalled = (!names.is_empty()).then(|| format!("task {} stalled", names.join(", ")));
        let parts: Vec<_> = stalled.into_iter().chain(silent).collect();
        let silent = newest_ns.is_none() || silent_s > YOUNG_S.max(3.0 * period_s);
        let since_ns = aggregates.stalled_ns.filter(|_| !silent).or(newest_ns);
        (!parts.is_empty()).then(|| Standstill { why: parts.join(", "), since_ns, silent })
    }

    /// Readiness and grade of the poses.
    pub fn readiness(&self) -> Readiness {
        let dead = self.dead();
        let newest = self.newest.borrow().map(|newest| newest.frame);
        let source = self.sources.condition.source_down.borrow().as_ref().map(ToString::to_string);
        let causes = Causes { lock: self.lock().map(|now| now.cause), source };
        let doubts = self.sources.condition.doubts.shown();
        let further = doubts.iter().map(ShownDoubt::limitation).chain(self.large_uncertainty()).collect();
        let assessment = self.assess(newest.as_ref(), dead.as_ref(), &causes, further);
        let checks = self.aggregates().checks.findings(newest.as_ref(), dead.as_ref(), &causes);
        Readiness { ready: checks.iter().all(|check| check.ok), checks, doubts, assessment }
    }

    fn assess(
        &self,
        newest: Option<&PoseFrame>,
        dead: Option<&Standstill>,
        causes: &Causes,
        further: Vec<Limitation>,
    ) -> Assessment {
        let shadow = self.sources.config.borrow().centering.mode == LoopMode::Shadow;
        let aggregates = self.aggregates();
        let now = aggregates.looked;
        let evidence = Evidence {
            status: newest.map(|frame| frame.status),
            lately: Status(aggregates.recent.bits(now).0 & !Status::POSE_VALID.0),
            lock: newest.map_or(LockState::Off, |frame| frame.lock),
            lock_cause: causes.lock.map(LockCause::text),
            source_down: causes.source.as_deref(),
            loop_mode: shadow.then_some("loop in shadow mode"),
            stalled: dead.map(|still| still.why.as_str()),
            silent: dead.is_some_and(|still| still.silent),
        };
        let mut assessment =
            evidence.assess(further, |set| aggregates.recent.since_ns(set, now).and_then(utc));
        if let Some(still) = dead {
            assessment.since = still.since_ns.and_then(utc);
        }
        assessment
    }

    fn large_uncertainty(&self) -> Option<Limitation> {
        let text = self.aggregates().uncertainty.finding()?;
        Some(Limitation {
            grade: Grade::Limited,
            name: "uncertainty".into(),
            text,
            remedy: "check the power of the laser and the offset of the beam from the apex".into(),
            since: None,
            consequence: false,
        })
    }

    /// The lock state with its cause, if it explains the newest frame.
    pub(super) fn lock(&self) -> Option<LockCondition> {
        let lock = self.newest.borrow().map(|newest| newest.frame.lock)?;
        (*self.sources.condition.lock.borrow())?.explaining(lock)
    }

    /// Access to the aggregates. No code panics while it holds the lock, so a poisoned lock is safe to use.
    pub(super) fn aggregates(&self) -> MutexGuard<'_, Aggregates> {
        self.aggregates.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Processes frames until the channel closes.
    pub(super) async fn feed(&self, frames: &mut mpsc::Receiver<PoseFrame>) {
        let mut looks = interval(LOOK);
        looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut batch = Vec::new();
        for look in 1_u64.. {
            looks.tick().await;
            let gone = drain(frames, &mut batch);
            self.enter(&batch);
            if let Some(frame) = batch.last() {
                self.newest.send_replace(Some(Newest { frame: *frame, seen: SystemClock.now() }));
                batch.clear();
            }
            if look.is_multiple_of(UPDATE) {
                let ready = self.readiness();
                self.note_events(&ready);
                if self.updates.receiver_count() > 0 {
                    self.update(ready);
                }
            }
            if gone {
                return;
            }
        }
    }

    /// Sends an update to all viewers.
    fn update(&self, ready: Readiness) {
        let dead = self.dead();
        let lock = self.lock().as_ref().map(lock_event);
        let newest = self.newest.borrow().map(|newest| newest.frame);
        let update = self.aggregates().page.update(
            newest.as_ref(),
            dead,
            ready,
            lock,
            &self.sources.condition.counters,
            &self.sources.recording,
        );
        self.sources.condition.counters.page_updates.inc();
        // Fails if the last viewer has just left, which is not a loss.
        let _ = self.updates.send(serde_json::json!({ "update": update }).to_string().into());
    }

    /// Adds what has changed to the list of events.
    fn note_events(&self, ready: &Readiness) {
        let Some(frame) = self.newest.borrow().map(|newest| newest.frame) else { return };
        let condition = &self.sources.condition;
        let tare = self.sources.config.borrow().frames.tare;
        let snapshot = Snapshot {
            time_ms: frame.time_ns as f64 * 1e-6,
            grade: (ready.assessment.grade.name(), ready.assessment.headline.clone()),
            lock: (frame.lock, self.lock().map(|now| now.cause.text())),
            config: frame.config,
            tare: tare.translation_mm.into_iter().chain(tare.rotation_deg).collect(),
            recording: self.sources.recording.file_name(),
            clients: [&condition.counters.tcp_connected, &condition.counters.tcp_disconnected]
                .map(Counter::get),
        };
        self.aggregates().page.events.look(snapshot);
    }

    /// All events so far.
    pub(super) fn events(&self) -> Vec<Event> {
        self.aggregates().page.events.list().iter().cloned().collect()
    }

    /// Adds frames to the aggregates.
    fn enter(&self, batch: &[PoseFrame]) {
        let half_m = self.sources.config.borrow().head.psd_size_mm * 0.5e-3;
        let rate_hz = self.sources.descriptor.borrow().rate_hz;
        let stalled = !self.sources.condition.heartbeats.stalled().is_empty();
        let mut aggregates = self.aggregates();
        aggregates.looked = SystemClock.now();
        aggregates.page.frames(batch, rate_hz, self.updates.receiver_count() > 0);
        let now = aggregates.looked;
        for frame in batch {
            aggregates.recent.frame(frame, now);
            aggregates.checks.frame(frame);
            aggregates.uncertainty.frame(frame);
            aggregates.tally.frame(frame, half_m);
        }
        if !batch.is_empty() {
            aggregates.last_arrival = aggregates.looked;
        }
        aggregates.stalled_ns =
            aggregates.stalled_ns.or(batch.last().map(|frame| frame.time_ns)).filter(|_| stalled);
        aggregates.tally.tick(now);
    }
}

/// Takes all waiting frames. Returns whether the channel has closed.
fn drain(frames: &mut mpsc::Receiver<PoseFrame>, batch: &mut Vec<PoseFrame>) -> bool {
    while batch.len() < BATCH {
        match frames.try_recv() {
            Ok(frame) => batch.push(frame),
            Err(e) => return e == TryRecvError::Disconnected,
        }
    }
    false
}
