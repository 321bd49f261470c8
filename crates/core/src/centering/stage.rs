//! Model of the stage in the loop: commanded position, actual position, and whether the stage follows.

use super::controller::ControllerState;
use crate::centering::LoopParams;
use crate::centering::command_delay::CommandDelay;
use crate::centering::command_history::CommandHistory;
use crate::centering::unanswered::{CommandBacklog, UnansweredCommands};
use crate::signals::Sample;
use crate::steering::{StageMove, StagePosition};
use crate::time::Mono;

/// How the stage treats commands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CommandStatus {
    /// The stage accepts commands, as far as is known.
    #[default]
    Obeys,
    /// The stage rejected the last command.
    Refuses,
    /// No stage takes commands.
    Gone,
}

/// The stage.
#[derive(Clone, Debug)]
pub struct StageModel {
    /// The last command.
    memory: Option<ControllerState>,
    /// The loop does not control the stage; it must take over at the actual position before it moves the
    /// stage.
    detached: bool,
    /// Nothing but the loop has moved the stage since the loop took over.
    ours: bool,
    command_status: CommandStatus,
    unanswered: UnansweredCommands,
    delay: CommandDelay,
    accepted: Option<StagePosition>,
    /// Position that the stage reports outside the samples.
    reported: Option<StagePosition>,
    history: CommandHistory,
    /// Time since the stage stopped following its commands, seconds.
    stuck_s: f64,
}

impl Default for StageModel {
    fn default() -> Self {
        Self {
            memory: None,
            detached: true,
            ours: false,
            command_status: CommandStatus::default(),
            unanswered: UnansweredCommands::default(),
            delay: CommandDelay::default(),
            accepted: None,
            reported: None,
            history: CommandHistory::default(),
            stuck_s: 0.0,
        }
    }
}

impl StageModel {
    /// The state from which the controller continues; `None` unless the loop controls the stage and the stage
    /// takes commands.
    pub fn memory(&self) -> Option<ControllerState> {
        self.memory.filter(|_| !self.detached && self.command_status != CommandStatus::Gone)
    }

    /// The last commanded position, metres; `None` unless the loop controls the stage.
    pub fn commanded(&self) -> Option<StagePosition> {
        self.memory.filter(|_| !self.detached).map(|memory| memory.position)
    }

    /// Records that the stage takes no commands.
    pub fn gone(&mut self) {
        self.command_status = CommandStatus::Gone;
    }

    /// Records that the stage is back, or was replaced.
    pub fn back(&mut self) {
        self.command_status = CommandStatus::Obeys;
    }

    /// How the stage treats commands.
    pub fn command_status(&self) -> CommandStatus {
        self.command_status
    }

    /// Records a command that goes out with this id at `now`.
    pub fn commands(&mut self, id: u32, position: StagePosition, now: Mono) {
        self.unanswered.sent(id, position, now);
    }

    /// Records that the command with this id was computed from a sample.
    pub fn computed(&mut self, id: u32, sample: &Sample) {
        self.delay.sent(id, sample.time);
    }

    /// Records which command was applied when a sample was taken.
    pub fn shows(&mut self, sample: &Sample) {
        self.delay.applied(sample.applied, sample.time);
    }

    /// Measured delay from a sample to the first one that has its command applied, seconds, if it is known.
    pub fn delay_s(&self) -> Option<f64> {
        self.delay.median_s()
    }

    /// Records an acknowledgement of the command with this id. After a rejected command, the control
    /// continues from the last accepted one.
    pub fn answers(&mut self, id: u32, accepted: bool) {
        let Some(position) = self.unanswered.answered(id) else { return };
        if self.command_status != CommandStatus::Gone {
            self.command_status = if accepted { CommandStatus::Obeys } else { CommandStatus::Refuses };
        }
        if accepted {
            self.accepted = Some(position);
        } else if let (Some(accepted), false) = (self.accepted, self.detached) {
            self.memory = Some(ControllerState::at(accepted));
        }
    }

    /// Checks at `now`, `dt` seconds after the previous check, whether the stage answers in time.
    pub fn check_answers(&mut self, params: &LoopParams, now: Mono, dt: f64) {
        if self.memory().is_some() {
            self.unanswered.check(now, params.answer_s(), params.limits.lost_s, dt);
        }
    }

    /// The commands without an acknowledgement; none unless the loop controls the stage and the stage takes
    /// commands.
    pub fn backlog(&self) -> CommandBacklog {
        let backlog = self.unanswered.backlog();
        let overdue = backlog.overdue;
        self.memory().map_or(CommandBacklog { overdue, ..CommandBacklog::default() }, |_| backlog)
    }

    /// Records the position that the stage reports, metres.
    pub fn set_reported(&mut self, position: StagePosition) {
        self.reported = Some(position).filter(|at| at.iter().all(|p| p.is_finite()));
    }

    /// How long the stage has not followed its commands, seconds.
    pub fn stuck_s(&self) -> f64 {
        self.stuck_s
    }

    /// Adapts the state to a setpoint that has moved by `step`, in lengths of the stage.
    pub fn shift_setpoint(&mut self, step: StageMove) {
        self.memory = self.memory.map(|memory| memory.shifted(step));
    }

    /// The loop releases the stage.
    pub fn let_go(&mut self) {
        self.detached = true;
    }

    /// Records that the stage has acted on its own, and has moved to `park` if given. The model assumes the
    /// stage there until a readback shows otherwise.
    pub fn released(&mut self, park: Option<StagePosition>) {
        let park = park.filter(|_| !self.detached);
        self.memory = self.memory.map(|m| ControllerState::at(park.unwrap_or(m.position)));
        (self.detached, self.ours, self.accepted) = (true, false, None);
        if self.command_status == CommandStatus::Refuses {
            self.command_status = CommandStatus::Obeys;
        }
        self.unanswered.forget();
        self.delay.forget();
    }

    /// Takes over the stage at its actual position, unless the loop already controls the stage. Returns true
    /// if it took over.
    pub fn take_over(&mut self, sample: &Sample, params: &LoopParams, dt: f64) -> bool {
        if !self.detached || self.command_status == CommandStatus::Gone {
            return false;
        }
        let memory = self.found(sample, params, dt);
        self.history.clear();
        self.sent(memory, sample, params);
        (self.detached, self.ours, self.stuck_s) = (false, true, 0.0);
        true
    }

    /// The stage at its actual position: readback, or else the last command. If only this loop has moved the
    /// stage (`ours`) and the readback is within one step of the last command, the command is the more
    /// accurate value.
    pub fn found(&self, sample: &Sample, params: &LoopParams, dt: f64) -> ControllerState {
        let reach = params.controller.slew * dt;
        let sent = self.memory.map(|memory| memory.position);
        let read = read_back(sample).or(self.reported);
        if let (Some(read), Some(sent), true) = (read, sent, self.ours)
            && (0..2).all(|axis| (read[axis] - sent[axis]).abs() <= reach)
        {
            return ControllerState::at(sent);
        }
        // A readback beyond the limits is clipped to them, unless the stage was sent there before the limits
        // were reduced: then it returns at the slew limit.
        let farthest = |axis: usize| sent.map_or(0.0, |sent| sent[axis].abs()).max(params.controller.limit);
        let at = read.or(sent).unwrap_or_default();
        ControllerState::at(StagePosition([0, 1].map(|axis| at[axis].clamp(-farthest(axis), farthest(axis)))))
    }

    /// Records that the stage was sent to a position after this sample.
    pub fn sent(&mut self, memory: ControllerState, sample: &Sample, params: &LoopParams) {
        self.memory = Some(memory);
        self.history.push(memory.position, sample.time, params.span_s());
    }

    /// Best known position of the stage when the sample was taken, metres.
    pub fn stands_at(&self, sample: &Sample, params: &LoopParams) -> StagePosition {
        let sent = || self.history.before(sample.time, params.loop_delay_s).or(self.commanded());
        read_back(sample).or_else(sent).or(self.reported).unwrap_or_default()
    }

    /// Actual position if the readback in the sample shows that the stage does not follow its commands. `dt`
    /// is the time since the previous sample, seconds.
    pub fn behind(&mut self, sample: &Sample, params: &LoopParams, dt: f64) -> Option<StagePosition> {
        let behind = read_back(sample).filter(|at| !self.history.leads_to(*at, params.following()));
        // A stage at its own limit reports that in the sample, and cannot follow.
        self.stuck_s = if behind.is_none() || sample.output_railed { 0.0 } else { self.stuck_s + dt };
        behind
    }
}

/// The position of the stage in the sample, if it is finite.
pub(super) fn read_back(sample: &Sample) -> Option<StagePosition> {
    sample.steering.filter(|at| at.iter().all(|p| p.is_finite())).map(StagePosition)
}
