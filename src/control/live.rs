//! The configuration of a running daemon, and its changes.

use std::sync::Arc;
use std::time::Duration;

use serde_json::{Value, json};
use tokio::sync::{Mutex, mpsc, oneshot, watch};
use tokio::time::timeout;
use trifacet_core::centering::{LoopMode, LoopRefusal};
use trifacet_core::channels::Channels;
use trifacet_core::steering::StagePosition;
use trifacet_core::telemetry::heartbeat::{Drill, Task};
use trifacet_core::time::{Clock, Mono};
use trifacet_optics::Pose;
use trifacet_wire::stream::{Descriptor, Replayed};

use super::calibration::{drift, log_calibration};
use super::config_file::{Access, ConfigFile};
use super::reload::take_over_file;
use super::{Command, FastRequests};
use crate::acquisition::task::SettingsChange;
use crate::centering::CenteringRequest;
use crate::clock::SystemClock;
use crate::condition::Condition;
use crate::config::CalibrationState;
use crate::config::reload::changes;
use crate::config::{
    CalibrationContext, Config, SourceKind, SteeringConfig, SteeringKind, Tables, TransformConfig,
};
use crate::doubts::Doubter;
use crate::estimation::EstimationRequest;
use crate::exit::{self, Failure};
use crate::logging::Logging;
use crate::publishing::descriptor::StreamFacts;
use crate::publishing::lock_event::lock_event;
use crate::recording::{Handle, RecorderCommand};
use crate::twin::{MirrorMove, MoveRequest};

/// Time limit for an answer of the fast side.
pub(super) const FAST_SIDE_TIMEOUT: Duration = Duration::from_secs(5);

/// A channel map, and the correction tables in it.
pub(super) type ChannelMap = (Channels, Tables);

/// State of a running daemon, and the channels for changing it.
#[derive(Debug)]
pub struct RunningConfig {
    /// Configuration file, if the daemon was started with one.
    pub file: Option<ConfigFile>,
    /// Configuration in force.
    pub running: Config,
    /// The file as last taken over.
    pub taken: Config,
    /// The correction tables in force.
    pub tables: Tables,
    /// Facts for the descriptor.
    pub facts: StreamFacts,
    /// The descriptor for TCP clients.
    pub descriptor: watch::Sender<Descriptor>,
    /// The configuration in force, for the monitor.
    pub config_in_force: watch::Sender<Config>,
    /// Channels to the fast side.
    pub fast: FastRequests,
    /// Limits for a stage with its own task.
    pub steering: watch::Sender<SteeringConfig>,
    /// The log.
    pub log: Arc<Logging>,
    /// The recorder.
    pub recording: Handle,
    /// The condition of the daemon.
    pub condition: Condition,
    /// Result of the last self-check.
    pub last_self_check: Option<Value>,
    /// For the doubt that a self-check raises.
    pub doubter: Doubter,
    /// Time of the daemon's start.
    pub started: Mono,
}

/// Executes a command. Returns the answer, a JSON object; it contains `error` if the command failed, also in
/// part.
pub async fn obey(live: &Mutex<RunningConfig>, command: Command) -> Value {
    Box::pin(execute(live, command)).await.unwrap_or_else(|failure| error(&failure))
}

pub(super) async fn execute(live: &Mutex<RunningConfig>, command: Command) -> Result<Value, Failure> {
    live.lock().await.permit(command)?;
    match command {
        Command::Reload => {
            let access = access(live, "configuration unchanged").await?;
            Box::pin(take_over_file(live, access)).await // it holds several configurations
        }
        Command::Tare { poses, save } => {
            let file = save_to(live, save).await?;
            live.lock().await.tare(poses, file).await
        }
        Command::ClearTare { save } => {
            let file = save_to(live, save).await?;
            live.lock().await.set_tare(TransformConfig::default(), file).await
        }
        Command::Status => live.lock().await.status().await,
        Command::Loop(mode) => live.lock().await.tune(|config| config.centering.mode = mode).await,
        Command::Setpoint(um) => live.lock().await.tune(|config| config.centering.setpoint_um = um).await,
        Command::Gains { kp, ki_per_s } => {
            let gains = (Some(kp), Some(ki_per_s));
            let change = |config: &mut Config| (config.centering.kp, config.centering.ki_per_s) = gains;
            live.lock().await.tune(change).await
        }
        Command::Move(um) => live.lock().await.move_to(um).await,
        Command::Park => live.lock().await.park().await,
        Command::Search => live.lock().await.search().await,
        Command::SelfCheck => live.lock().await.self_check().await,
        Command::TwinPose(to) => twin_pose(live, to).await,
        Command::Drill(drill, task) => live.lock().await.drill(drill, task),
        Command::Recording => Ok(live.lock().await.recording.state.tell()),
        Command::Record(request) => live.lock().await.record(request).await,
    }
}

/// The access to the configuration file. It comes before the lock of the daemon's state: other commands are
/// executed while the file is read.
async fn access(live: &Mutex<RunningConfig>, without: &str) -> Result<Access, Failure> {
    let file = live.lock().await.file.clone();
    let none = || format!("{without}: the daemon was started without a configuration file");
    file.ok_or_else(|| Failure::new(exit::CONFIG, none()))?.access().await
}

/// Moves the mirror of the twin and waits until it is there. Other commands are executed meanwhile.
async fn twin_pose(live: &Mutex<RunningConfig>, to: MirrorMove) -> Result<Value, Failure> {
    let to = to.checked().map_err(|why| Failure::new(exit::USAGE, why))?;
    let moves = live.lock().await.twin_moves()?;
    let patience = FAST_SIDE_TIMEOUT + Duration::from_secs_f64(to.over_s);
    let (done, arrived) = oneshot::channel();
    moves.try_send((to, done)).map_err(|_| unavailable("the daemon is stopping, or too busy to answer"))?;
    match timeout(patience, arrived).await {
        Ok(Ok(())) => {
            let pose = to.to().to_array();
            Ok(json!({ "twin_pose": { "tx_ty_tz_m": pose[..3], "roll_pitch_yaw_rad": pose[3..] } }))
        }
        Ok(Err(_)) => Err(Failure::new(exit::DATA, "another twin-pose moved the mirror before it was there")),
        Err(_) => Err(unavailable("the fast side of the daemon does not answer")),
    }
}

async fn save_to(live: &Mutex<RunningConfig>, save: bool) -> Result<Option<Access>, Failure> {
    if save { access(live, "cannot save").await.map(Some) } else { Ok(None) }
}

impl RunningConfig {
    /// Refuses a command that cannot be executed at all.
    fn permit(&self, command: Command) -> Result<(), Failure> {
        if self.running.acquisition.source == SourceKind::Replay && command != Command::Status {
            let why = "a recording is replayed: its settings and its steering cannot be changed";
            return Err(Failure::new(exit::DATA, why));
        }
        Ok(())
    }

    async fn tune(&mut self, change: impl FnOnce(&mut Config)) -> Result<Value, Failure> {
        let mut next = self.running.clone();
        change(&mut next);
        next.verify().map_err(|wrong| Failure::new(exit::USAGE, wrong.to_string()))?;
        self.go_on_with(next, None, None).await?;
        Ok(json!({ "loop": self.loop_now().await? }))
    }

    async fn move_to(&mut self, um: [f64; 2]) -> Result<Value, Failure> {
        let limit = self.running.steering.limit_um;
        if let Some((axis, beyond)) = ["x_um", "y_um"].iter().zip(um).find(|(_, p)| p.abs() > limit) {
            let why = format!("{axis} = {beyond}: allowed is -{limit} to {limit}, steering.limit_um");
            return Err(Failure::new(exit::USAGE, why));
        }
        self.order(|reply| CenteringRequest::Move(StagePosition(um.map(|um| um * 1e-6)), reply)).await?;
        Ok(json!({ "loop": self.loop_now().await? }))
    }

    async fn park(&mut self) -> Result<Value, Failure> {
        self.tune(|config| config.centering.mode = LoopMode::Manual).await?;
        self.move_to(self.running.steering.park_um).await
    }

    async fn search(&mut self) -> Result<Value, Failure> {
        let starts = self.order(CenteringRequest::Search).await?;
        let search =
            if starts { "started" } else { "not started: the loop regulates, so there is nothing to search" };
        Ok(json!({ "search": search, "loop": self.loop_now().await? }))
    }

    /// The way to the mirror of the twin. Refused with another source.
    fn twin_moves(&self) -> Result<mpsc::Sender<MoveRequest>, Failure> {
        if self.running.acquisition.source != SourceKind::Twin {
            let why = "the mirror moves by command only with the twin as source: acquisition.source";
            return Err(Failure::new(exit::DATA, why));
        }
        Ok(self.fast.moves.clone())
    }

    /// Starts a drill. Refused unless both source and stage are simulated.
    fn drill(&self, drill: Drill, task: Task) -> Result<Value, Failure> {
        let Config { acquisition, steering, .. } = &self.running;
        if acquisition.source != SourceKind::Twin || steering.kind != SteeringKind::Outputs {
            let why = "a drill is for the twin with its own stage only: acquisition.source, steering.kind";
            return Err(Failure::new(exit::DATA, why));
        }
        self.condition.heartbeats.of(task).drill(drill);
        Ok(json!({ "drill": drill.name(), "task": task.name() }))
    }

    /// Sends a request that the loop may refuse.
    async fn order<A>(
        &self,
        order: impl FnOnce(oneshot::Sender<Result<A, LoopRefusal>>) -> CenteringRequest,
    ) -> Result<A, Failure> {
        ask(&self.fast.orders, FAST_SIDE_TIMEOUT, order)
            .await?
            .map_err(|refusal| Failure::new(exit::DATA, refusal.to_string()))
    }

    async fn record(&self, request: RecorderCommand) -> Result<Value, Failure> {
        ask(&self.recording.requests, FAST_SIDE_TIMEOUT, |reply| (request, reply)).await??;
        Ok(json!({ "recording": self.recording.state.tell() }))
    }

    /// Puts another configuration in force. It may differ only in what can change at run time. `channels` is
    /// the new channel map with its tables, if either has changed; `calibration` the new calibration, if it has.
    pub(super) async fn go_on_with(
        &mut self,
        next: Config,
        channels: Option<ChannelMap>,
        calibration: Option<CalibrationState>,
    ) -> Result<(), Failure> {
        let changes =
            changes(&self.running, &next).map_err(|e| Failure::new(exit::SOFTWARE, e.to_string()))?;
        let tables = channels.as_ref().map_or_else(Vec::new, |(_, tables)| self.tables.changes(tables));
        if next.frames != self.running.frames
            || next.estimation != self.running.estimation
            || next.steering != self.running.steering
            || next.laser != self.running.laser
            || next.calibration != self.running.calibration
            || next.uncertainty != self.running.uncertainty
            || next.centering.lock_limit_um != self.running.centering.lock_limit_um
            || channels.is_some()
            || calibration.is_some()
        {
            // In a box of its own: it is large, and part of the future of every command.
            Box::pin(self.change_meaning(&next, channels, calibration)).await?;
        }
        if next.centering != self.running.centering || next.steering != self.running.steering {
            // The limits first: the loop must not act before the stage has them.
            self.steering.send_replace(next.steering.clone());
            let tuning = Box::new(next.loop_params());
            ask(&self.fast.orders, FAST_SIDE_TIMEOUT, |done| CenteringRequest::Retune(tuning, done)).await?;
        }
        for change in changes.iter().map(ToString::to_string).chain(tables) {
            tracing::info!("configuration: {change}");
        }
        // Last, so that a lower level does not hide the changes.
        if next.log.level != self.running.log.level {
            self.log.set_level(&next.log.level)?;
        }
        self.config_in_force.send_replace(next.clone());
        self.running = next;
        Ok(())
    }

    /// Changes, from one sample to the next, what poses depend on.
    async fn change_meaning(
        &mut self,
        next: &Config,
        channels: Option<ChannelMap>,
        calibration: Option<CalibrationState>,
    ) -> Result<(), Failure> {
        let mut facts = self.facts.clone();
        let (channels, tables) =
            channels.map_or_else(|| (None, self.tables.clone()), |(map, tables)| (Some(map), tables));
        facts.calibration = calibration.unwrap_or(facts.calibration);
        facts.systematic = next.systematic(facts.calibration.spread.is_some());
        facts.expires_days = next.calibration.expires_days;
        let calibration = facts.calibration.clone();
        let context = Arc::new(CalibrationContext { config: next.clone(), tables, calibration });
        facts.id.config = context.id();
        let settings = next
            .estimation_settings(&facts.calibration, facts.id.config)
            .map_err(|e| Failure::new(exit::SOFTWARE, format!("the head cannot be built: {e}")))?;
        let tables = context.tables.clone();
        ask(&self.fast.changes, FAST_SIDE_TIMEOUT, |done| SettingsChange {
            channels,
            settings,
            context,
            done,
        })
        .await?;
        if facts.id.config != self.facts.id.config {
            tracing::info!(
                config = format!("{:08x}", facts.id.config),
                "poses have another meaning from now on"
            );
        }
        if facts.calibration != self.facts.calibration {
            log_calibration(&facts.calibration, facts.expires_days);
        }
        (self.facts, self.tables) = (facts, tables);
        // The session may have changed since the start.
        self.descriptor
            .send_modify(|now| *now = Descriptor { session: now.session, ..self.facts.descriptor() });
        Ok(())
    }

    pub(super) fn id(&self) -> String {
        format!("{:08x}", self.facts.id.config)
    }

    async fn status(&self) -> Result<Value, Failure> {
        let last = ask(&self.fast.questions, FAST_SIDE_TIMEOUT, EstimationRequest::Last).await?;
        let now = SystemClock.now();
        let replay = self.replay();
        let pose = last.map(|report| {
            let numbers = report.pose.map(Pose::to_array);
            json!({
                "valid": report.pose.is_some(),
                // In a replay `time` is not the time of the measurement.
                "age_s": replay.is_none().then(|| now.seconds_since(report.time)),
                "sample_index": report.index,
                "status": report.status.names().collect::<Vec<_>>(),
                "tx_ty_tz_m": numbers.as_ref().map(|n| &n[..3]),
                "roll_pitch_yaw_rad": numbers.as_ref().map(|n| &n[3..]),
            })
        });
        let counters: serde_json::Map<_, _> =
            self.condition.counters.list().into_iter().map(|(name, n)| (name.to_owned(), n.into())).collect();
        Ok(json!({
            "version": env!("CARGO_PKG_VERSION"),
            "pid": std::process::id(),
            "uptime_s": now.seconds_since(self.started),
            "file": self.file.as_ref().map(ConfigFile::path),
            "session": format!("{:08x}", self.descriptor.borrow().session),
            "config": self.id(),
            "replay": replay,
            "source": { "down": self.condition.source_down.borrow().as_ref().map(ToString::to_string) },
            "loop": self.loop_now().await?,
            "pose": pose,
            "doubts": self.condition.doubts.shown(),
            "calibration_drift": drift(&self.condition.doubts.drift.get()),
            "self_check": self.last_self_check,
            "frames": self.running.frames,
            "recording": self.recording.state.tell(),
            "receivers": &**self.condition.receivers.borrow(),
            "counters": counters,
        }))
    }

    /// Description of the replay, with `at_end`.
    fn replay(&self) -> Option<Value> {
        let replay = self.descriptor.borrow().replay.clone()?;
        let at_end = !replay.repeat && self.condition.counters.replay_ends.get() > 0;
        let Replayed { recorded, speed, repeat, .. } = replay;
        let file = &self.running.replay.file;
        Some(json!({
            "file": file, "recorded": recorded, "speed": speed, "repeat": repeat, "at_end": at_end
        }))
    }

    async fn loop_now(&self) -> Result<Value, Failure> {
        let view = ask(&self.fast.orders, FAST_SIDE_TIMEOUT, CenteringRequest::View).await?;
        let um = |metres: &[f64; 2]| metres.map(|m| m * 1e6);
        let condition = (*self.condition.lock.borrow()).and_then(|now| now.explaining(view.lock));
        let condition = condition.as_ref().map(lock_event);
        let centering = &self.running.centering;
        let gains = centering.gains(self.running.acquisition.rate_hz);
        Ok(json!({
            "mode": view.mode.name(),
            "lock": view.lock.name(),
            "lock_since": condition.as_ref().map(|event| &event.since),
            "cause": condition.as_ref().map(|event| &event.cause),
            "cause_text": condition.as_ref().map(|event| &event.text),
            "offset_um": view.offset.as_deref().map(um),
            "setpoint_um": centering.setpoint_um,
            "commanded_um": view.commanded.as_deref().map(um),
            "apex_velocity_um_per_s": view.velocity.as_deref().map(um),
            "searches_in_vain": view.attempts,
            "commands": {
                "unanswered": view.backlog.count,
                "age_s": view.backlog.age_s(SystemClock.now()),
                "overdue": view.backlog.overdue,
                "delay_ms": view.delay_s.map(|seconds| seconds * 1e3),
                "loop_delay_ms": centering.loop_delay_s(self.running.acquisition.rate_hz) * 1e3,
            },
            "shadow": view.shadow.map(|(at, to)| json!({ "stands_at_um": um(&at), "would_go_to_um": um(&to) })),
            "kp": gains.kp,
            "ki_per_s": gains.ki_per_s,
        }))
    }
}

/// The answer for a failure.
pub fn error(failure: &Failure) -> Value {
    json!({ "error": failure.message, "code": failure.code })
}

fn unavailable(why: &str) -> Failure {
    Failure::new(exit::UNAVAILABLE, why)
}

/// Sends a request to a task of the fast side and waits for the answer.
pub(super) async fn ask<Q, A>(
    to: &mpsc::Sender<Q>,
    patience: Duration,
    question: impl FnOnce(oneshot::Sender<A>) -> Q,
) -> Result<A, Failure> {
    let (reply, answer) = oneshot::channel();
    to.try_send(question(reply)).map_err(|_| unavailable("the daemon is stopping, or too busy to answer"))?;
    match timeout(patience, answer).await {
        Ok(Ok(answer)) => Ok(answer),
        Ok(Err(_)) => Err(unavailable("the daemon is stopping")),
        Err(_) => Err(unavailable("the fast side of the daemon does not answer")),
    }
}
