//! The centering task: newest sample in, command out; holds on silence; holds or parks at the end.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{mpsc, oneshot, watch};
use tokio::task::yield_now;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep_until, timeout};
use tokio_util::sync::CancellationToken;
use trifacet_core::centering::centering::Centering;
use trifacet_core::centering::lock::{LockCause, LockCondition, Transition};
use trifacet_core::centering::{LoopParams, LoopRefusal, LoopState, LoopView, TimedPose};
use trifacet_core::estimation::PoseReport;
use trifacet_core::signals::Sample;
use trifacet_core::steering::{Command, StagePosition};
use trifacet_core::telemetry::heartbeat::HEARTBEAT;
use trifacet_core::telemetry::{CommandGauge, Counters};
use trifacet_core::time::{Clock, Mono};
use trifacet_wire::actuator::Ack;

use crate::doubts::{Doubter, Subject};
use crate::recording::{Entry, RecordSender};
use crate::steering::{Driver, StageEvent};

/// A pose older than this, and than five periods, is not used for the wedges of the facets. Seconds.
const FRESH_S: f64 = 0.1;
/// Longest wait for the acknowledgement of the last command.
const LAST_ACK: Duration = Duration::from_secs(1);
/// Shortest time between two reports of a cause while the lock state remains. Causes can alternate with every
/// sample. Seconds.
const CAUSE_S: f64 = 0.1;

/// Channels of the task.
#[derive(Debug)]
pub struct CenteringLinks {
    /// The newest sample, from acquisition.
    pub newest: watch::Receiver<Option<Sample>>,
    /// The newest report, from estimation.
    pub poses: watch::Receiver<Option<PoseReport>>,
    /// State of the loop, to estimation.
    pub state: watch::Sender<LoopState>,
    /// The lock state and its cause, to all outputs.
    pub lock: watch::Sender<Option<LockCondition>>,
    /// Requests from outside the fast side.
    pub orders: mpsc::Receiver<CenteringRequest>,
    /// Changes of the lock state, for the recorder.
    pub records: RecordSender,
    /// The commands without an acknowledgement, for the monitor.
    pub commands: Arc<CommandGauge>,
    /// The doubt about the loop delay, to all outputs.
    pub doubter: Doubter,
    /// Time without samples until silence is reported to the loop.
    pub silence: Duration,
}

/// Requests to the loop.
#[derive(Debug)]
pub enum CenteringRequest {
    /// Changes the parameters; the reply confirms that they are in effect.
    Retune(Box<LoopParams>, oneshot::Sender<()>),
    /// Sends the stage to a position, metres; the reply may be a refusal.
    Move(StagePosition, oneshot::Sender<Result<(), LoopRefusal>>),
    /// Starts a search for the apex; the reply is false if the loop regulates and has nothing to search.
    Search(oneshot::Sender<Result<bool, LoopRefusal>>),
    /// Asks for the state of the loop.
    View(oneshot::Sender<LoopView>),
}

/// Runs until `stop`; then sends the last command and waits for its acknowledgement.
pub async fn run<C: Clock>(
    centering: Centering,
    driver: impl Driver,
    clock: C,
    counters: Arc<Counters>,
    links: CenteringLinks,
    stop: CancellationToken,
) {
    let CenteringLinks { mut newest, poses, state, lock, mut orders, records, commands, doubter, silence } =
        links;
    let (mut last_arrival, mut silent_from) = (clock.now(), Instant::now());
    let lock = LockReporter::new(lock, &centering, last_arrival);
    let mut heartbeat = interval(HEARTBEAT);
    heartbeat.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let fresh_s = silence.as_secs_f64().max(FRESH_S);
    let mut side = Side {
        fresh_s,
        centering,
        driver,
        clock,
        counters,
        poses,
        records,
        lock,
        commands,
        overdue: false,
        doubter,
        doubted: false,
    };
    loop {
        tokio::select! {
            biased;
            () = stop.cancelled() => break,
            Some(order) = orders.recv() => side.obey(order),
            event = side.driver.next() => side.hear(&event),
            changed = newest.changed() => {
                if changed.is_err() {
                    break; // acquisition has ended; the daemon detects that
                }
                let Some(sample) = *newest.borrow_and_update() else { continue };
                silent_from = Instant::now();
                if let Some(skipped) = side.centering.skipped(&sample) {
                    side.counters.centering_skips.add(skipped);
                    last_arrival = side.clock.now();
                    side.act(&sample, last_arrival);
                }
            }
            () = sleep_until(silent_from + silence) => {
                // The whole thread may have been suspended: events that have arrived since then are handled
                // first.
                yield_now().await;
                if newest.has_changed().unwrap_or(true) {
                    continue;
                }
                let now = side.clock.now();
                let transition = side.centering.silence(now.seconds_since(last_arrival));
                side.say(transition);
                (last_arrival, silent_from) = (now, Instant::now());
            }
            _ = heartbeat.tick() => {}
        }
        side.watch_commands();
        side.watch_delay();
        side.lock.cause(side.centering.cause(), side.clock.now());
        state.send_if_modified(|state| std::mem::replace(state, side.centering.state()) != *state);
    }
    side.finish().await;
}

/// The loop with its stage.
struct Side<D, C> {
    centering: Centering,
    /// Largest age of a pose that is used, seconds.
    fresh_s: f64,
    driver: D,
    clock: C,
    counters: Arc<Counters>,
    poses: watch::Receiver<Option<PoseReport>>,
    records: RecordSender,
    lock: LockReporter,
    commands: Arc<CommandGauge>,
    /// It was logged that answers to commands are overdue.
    overdue: bool,
    doubter: Doubter,
    /// The loop delay is doubted.
    doubted: bool,
}

/// Reports the lock state and its cause.
struct LockReporter {
    to: watch::Sender<Option<LockCondition>>,
    now: LockCondition,
    reported: Mono,
}

impl LockReporter {
    fn new(to: watch::Sender<Option<LockCondition>>, centering: &Centering, now: Mono) -> Self {
        let first = LockCondition::initial(centering.state().lock, centering.cause(), now);
        to.send_replace(Some(first));
        Self { to, now: first, reported: now }
    }

    fn change(&mut self, transition: Transition, now: Mono) {
        self.report(self.now.after(transition, now), now);
    }

    fn cause(&mut self, cause: LockCause, now: Mono) {
        if cause != self.now.cause && now.seconds_since(self.reported) >= CAUSE_S {
            self.report(LockCondition { cause, ..self.now }, now);
        }
    }

    fn report(&mut self, condition: LockCondition, now: Mono) {
        (self.now, self.reported) = (condition, now);
        self.to.send_replace(Some(condition));
    }
}

impl<D: Driver, C: Clock> Side<D, C> {
    fn obey(&mut self, order: CenteringRequest) {
        // A requester that no longer waits for the reply does not need it.
        match order {
            CenteringRequest::Retune(tuning, done) => {
                let outcome = self.centering.retune(*tuning);
                self.send(outcome.command);
                self.say(outcome.transition);
                let _ = done.send(());
            }
            CenteringRequest::Move(to, reply) => drop(reply.send(self.centering.move_to(to))),
            CenteringRequest::Search(reply) => drop(reply.send(self.centering.search())),
            CenteringRequest::View(reply) => drop(reply.send(self.centering.view())),
        }
    }

    fn hear(&mut self, event: &StageEvent) {
        match event {
            StageEvent::Up => self.centering.stage_up(),
            StageEvent::At(position) => self.centering.stage_at(*position),
            StageEvent::Down(reason) => {
                tracing::warn!(reason, "the stage takes no commands");
                self.centering.stage_down();
            }
            StageEvent::Ack(answer) => self.centering.stage_answers(*answer),
        }
    }

    /// Acts on a sample, unless the sample is too old.
    fn act(&mut self, sample: &Sample, now: Mono) {
        let pose = fresh_pose(&self.poses, sample, self.fresh_s);
        let outcome = self.centering.sample(sample, pose.as_ref(), now);
        self.counters.centering_skips.add(u64::from(outcome.late));
        self.send(outcome.command);
        self.say(outcome.transition);
    }

    fn say(&mut self, transition: Option<Transition>) {
        let Some(transition) = transition else { return };
        let time = self.clock.now();
        let Transition { from, to, cause } = transition;
        self.records.put(|| Entry::lock(time, transition));
        let (before, after) = (from.name(), to.name());
        // Two places in the code: lines of the one do not use up the limit of the other.
        if cause.gives_up() {
            tracing::warn!(from = before, to = after, cause = cause.text(), "lock");
        } else {
            tracing::info!(from = before, to = after, cause = cause.text(), "lock");
        }
        self.lock.change(transition, time);
        self.counters.lock_cause(cause).inc();
        self.counters.lock(to).inc();
    }

    fn send(&mut self, command: Option<Command>) {
        if let Some(command) = command {
            self.driver.steer(command);
        }
    }

    /// Publishes the commands without an acknowledgement, and logs when answers become overdue, and when they
    /// arrive in time again.
    fn watch_commands(&mut self) {
        let backlog = self.centering.backlog();
        self.commands.set(&backlog, self.centering.delay_s());
        if std::mem::replace(&mut self.overdue, backlog.overdue) == backlog.overdue {
            return;
        }
        if backlog.overdue {
            let age_ms = (backlog.age_s(self.clock.now()) * 1e3).round();
            tracing::warn!(unanswered = backlog.count, age_ms, "the stage does not answer commands");
        } else {
            tracing::info!("the stage answers commands again");
        }
    }

    /// The configured loop delay is doubted while the measured one contradicts it.
    fn watch_delay(&mut self) {
        let doubt = self.centering.delay_doubt();
        if std::mem::replace(&mut self.doubted, doubt.is_some()) == doubt.is_some() {
            return;
        }
        self.doubter.set(Subject::LoopDelay, self.clock.now(), doubt.map(|doubt| doubt.to_string()));
    }

    /// Sends the last command, and waits for its acknowledgement.
    async fn finish(mut self) {
        let Some(last) = self.centering.finish() else {
            if self.centering.state().position.is_some() {
                tracing::warn!("the stage takes no commands: the last command was not sent");
            }
            return;
        };
        self.driver.steer(last);
        let answer = async {
            loop {
                if let StageEvent::Ack(Ack { id, accepted }) = self.driver.next().await
                    && id == last.id
                {
                    return accepted;
                }
            }
        };
        let complaint = match timeout(LAST_ACK, answer).await {
            Ok(true) => {
                tracing::info!(position_um = ?last.position.map(|p| p * 1e6), "steering acknowledged its last command");
                return;
            }
            Ok(false) => "steering refused its last command: the stage now acts as if commands had stopped",
            Err(_) => {
                "steering did not acknowledge its last command: if it was lost, the stage now acts as if commands had stopped"
            }
        };
        tracing::warn!(lease_ms = last.lease_ms, "{complaint}");
    }
}

fn fresh_pose(
    poses: &watch::Receiver<Option<PoseReport>>,
    sample: &Sample,
    fresh_s: f64,
) -> Option<TimedPose> {
    let PoseReport { pose, time, .. } = (*poses.borrow())?;
    let fresh = sample.time.seconds_since(time).abs() <= fresh_s;
    pose.filter(|_| fresh).map(|pose| TimedPose { pose, time })
}
