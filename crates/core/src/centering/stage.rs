//! The stage as the loop knows it: where it was sent, where it stands, whether it follows.

use std::collections::VecDeque;

use super::controller::ControllerState;
use crate::centering::LoopParams;
use crate::centering::command_history::CommandHistory;
use crate::signals::Sample;
use crate::steering::Xy;

/// Commands whose answers are waited for.
const MOST_UNANSWERED: usize = 1024;

/// What becomes of commands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CommandStatus {
    /// They are taken, as far as is known.
    #[default]
    Obeys,
    /// The last one was refused.
    Refuses,
    /// There is nothing to take them.
    Gone,
}

/// The stage.
#[derive(Clone, Debug)]
pub struct StageModel {
    /// Where it was sent last.
    memory: Option<ControllerState>,
    /// It is to be taken over, where it stands, before it is moved.
    apart: bool,
    /// Nothing but the loop has moved it since it was taken over.
    ours: bool,
    command_status: CommandStatus,
    /// Ids and positions of the commands that it has not answered, and the last position that it has taken.
    unanswered: VecDeque<(u32, Xy)>,
    accepted: Option<Xy>,
    /// Where it says itself that it stands, if not in the samples.
    reported: Option<Xy>,
    history: CommandHistory,
    /// For how long it has not followed.
    stuck_s: f64,
}

impl Default for StageModel {
    fn default() -> Self {
        Self {
            memory: None,
            apart: true,
            ours: false,
            command_status: CommandStatus::default(),
            unanswered: VecDeque::new(),
            accepted: None,
            reported: None,
            history: CommandHistory::default(),
            stuck_s: 0.0,
        }
    }
}

impl StageModel {
    /// What the controller goes on from; none unless the stage is the loop's, and takes commands.
    pub fn memory(&self) -> Option<ControllerState> {
        self.memory.filter(|_| !self.apart && self.command_status != CommandStatus::Gone)
    }

    /// Where it was last commanded to, metres; none unless it is the loop's.
    pub fn commanded(&self) -> Option<Xy> {
        self.memory.filter(|_| !self.apart).map(|memory| memory.position)
    }

    /// It takes no commands until it comes back.
    pub fn gone(&mut self) {
        self.command_status = CommandStatus::Gone;
    }

    /// It is there again, or another one is.
    pub fn back(&mut self) {
        self.command_status = CommandStatus::Obeys;
    }

    /// What becomes of its commands.
    pub fn command_status(&self) -> CommandStatus {
        self.command_status
    }

    /// A command with this id goes out.
    pub fn commands(&mut self, id: u32, position: Xy) {
        if self.unanswered.len() >= MOST_UNANSWERED {
            self.unanswered.pop_front(); // a stage that answers nothing, or only the newest
        }
        self.unanswered.push_back((id, position));
    }

    /// It has taken the command with this id, or refused it: then the last one that it has taken counts.
    pub fn answers(&mut self, id: u32, accepted: bool) {
        let Some(place) = self.unanswered.iter().position(|(sent, _)| *sent == id) else { return };
        let position = self.unanswered[place].1;
        self.unanswered.drain(..=place);
        if self.command_status != CommandStatus::Gone {
            self.command_status = if accepted { CommandStatus::Obeys } else { CommandStatus::Refuses };
        }
        if accepted {
            self.accepted = Some(position);
        } else if let (Some(accepted), false) = (self.accepted, self.apart) {
            self.memory = Some(ControllerState::at(accepted));
        }
    }

    /// Where it says itself that it stands, metres.
    pub fn set_reported(&mut self, position: Xy) {
        self.reported = Some(position).filter(|at| at.iter().all(|p| p.is_finite()));
    }

    /// For how long it has not followed its commands, seconds.
    pub fn stuck_s(&self) -> f64 {
        self.stuck_s
    }

    /// The setpoint has moved by this, in lengths of the stage.
    pub fn shift_setpoint(&mut self, step: Xy) {
        self.memory = self.memory.map(|memory| memory.shifted(step));
    }

    /// The loop lets go of it.
    pub fn let_go(&mut self) {
        self.apart = true;
    }

    /// It has acted by itself, and gone to `park` if that is what it does. Until a readback says better, it
    /// stands there.
    pub fn released(&mut self, park: Option<Xy>) {
        let park = park.filter(|_| !self.apart);
        self.memory = self.memory.map(|m| ControllerState::at(park.unwrap_or(m.position)));
        (self.apart, self.ours, self.accepted) = (true, false, None);
        if self.command_status == CommandStatus::Refuses {
            self.command_status = CommandStatus::Obeys;
        }
        self.unanswered.clear();
    }

    /// Takes it over where it stands, if it is not the loop's yet; says whether it was not.
    pub fn take_over(&mut self, sample: &Sample, params: &LoopParams, dt: f64) -> bool {
        if !self.apart || self.command_status == CommandStatus::Gone {
            return false;
        }
        let memory = self.found(sample, params, dt);
        self.history.clear();
        self.sent(memory, sample, params);
        (self.apart, self.ours, self.stuck_s) = (false, true, 0.0);
        true
    }

    /// The stage as it stands: as it says itself, or where it was sent last. If nothing but this loop has
    /// moved it (`ours`), and it stands there to within a step, the last command is the better number.
    pub fn found(&self, sample: &Sample, params: &LoopParams, dt: f64) -> ControllerState {
        let reach = params.controller.slew * dt;
        let sent = self.memory.map(|memory| memory.position);
        let read = read_back(sample).or(self.reported);
        if let (Some(read), Some(sent), true) = (read, sent, self.ours)
            && (0..2).all(|axis| (read[axis] - sent[axis]).abs() <= reach)
        {
            return ControllerState::at(sent);
        }
        // A readback beyond the limits is not believed, unless the stage was sent there before they came closer:
        // then it goes back at its speed.
        let farthest = |axis: usize| sent.map_or(0.0, |sent| sent[axis].abs()).max(params.controller.limit);
        let at = read.or(sent).unwrap_or_default();
        ControllerState::at([0, 1].map(|axis| at[axis].clamp(-farthest(axis), farthest(axis))))
    }

    /// It was sent there after this sample.
    pub fn sent(&mut self, memory: ControllerState, sample: &Sample, params: &LoopParams) {
        self.memory = Some(memory);
        self.history.push(memory.position, sample.time, params.span_s());
    }

    /// Where it stood when the sample was taken, as well as it is known.
    pub fn stands_at(&self, sample: &Sample, params: &LoopParams) -> Xy {
        let sent = || self.history.before(sample.time, params.loop_delay_s).or(self.commanded());
        read_back(sample).or_else(sent).or(self.reported).unwrap_or_default()
    }

    /// Where it stands if it does not follow its commands, as far as its readback in the sample, `dt` seconds
    /// after the last one, shows.
    pub fn behind(&mut self, sample: &Sample, params: &LoopParams, dt: f64) -> Option<Xy> {
        let behind = read_back(sample).filter(|at| !self.history.leads_to(*at, params.following()));
        // At its own limit it cannot follow, and says so.
        self.stuck_s = if behind.is_none() || sample.output_railed { 0.0 } else { self.stuck_s + dt };
        behind
    }
}

/// The position of the stage in the sample.
pub(super) fn read_back(sample: &Sample) -> Option<Xy> {
    sample.steering.filter(|at| at.iter().all(|p| p.is_finite()))
}
