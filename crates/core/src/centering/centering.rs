//! The centering loop: a sample and the last pose in, a steering command out. Pure.

use trifacet_optics::Optics;
use trifacet_wire::LockState;
use trifacet_wire::actuator::{Ack, LeaseAction};

use super::LoopRefusal;
use super::lock::{Action, Lock, LockCause, LockInput, Transition};
use super::stage::{CommandStatus, StageModel};
use crate::centering::apex_tracker::ApexTracker;
use crate::centering::observation::BeamObservation;
use crate::centering::open_loop::OpenLoopMove;
use crate::centering::{
    CommandBacklog, DelayDoubt, LoopMode, LoopParams, LoopState, LoopView, OnExit, Outcome, TimedPose,
};
use crate::signals::Sample;
use crate::steering::{BeamOffset, BeamPoint, Command, StageMove, StagePosition};
use crate::time::Mono;

/// The time between two samples counts as at most this many periods.
const MOST_PERIODS: f64 = 5.0;
/// A jump begins if it is longer than this fraction of the beam radius.
const WORTH_A_JUMP: f64 = 0.25;

/// The centering loop.
#[derive(Clone, Debug)]
pub struct Centering {
    params: LoopParams,
    stage: StageModel,
    tracker: ApexTracker,
    lock: Lock,
    open_loop: OpenLoopMove,
    /// Position of the stage at the last lock, or where the loop first took over.
    good_place: Option<StagePosition>,
    /// Position of the stage for the apex that was computed when the loop gave up its searches.
    gave_up: Option<StagePosition>,
    /// Since when samples have arrived too late.
    late_since: Option<Mono>,
    last: Option<(u64, Mono)>,
    offset: Option<BeamOffset>,
    shadow: Option<(StagePosition, StagePosition)>,
    commands: u32,
    /// Time of the last sample's arrival.
    now: Mono,
}

impl Centering {
    /// A loop at rest, for a head with these optics.
    pub fn new(params: LoopParams, optics: Optics) -> Self {
        Self {
            params,
            stage: StageModel::default(),
            tracker: ApexTracker::new(optics, MOST_PERIODS * params.period_s),
            lock: Lock::new(params.limits, params.mode),
            open_loop: OpenLoopMove::Still,
            good_place: None,
            gave_up: None,
            late_since: None,
            last: None,
            offset: None,
            shadow: None,
            commands: 0,
            now: Mono(0),
        }
    }

    /// The current state of the loop.
    pub fn state(&self) -> LoopState {
        LoopState { lock: self.lock.state(), position: self.stage.commanded() }
    }

    /// The cause of the current lock state.
    pub fn cause(&self) -> LockCause {
        self.lock.cause()
    }

    /// The current state in detail, for the operator.
    pub fn view(&self) -> LoopView {
        LoopView {
            mode: self.params.mode,
            lock: self.lock.state(),
            offset: self.offset,
            velocity: self.offset.map(|_| self.tracker.velocity()),
            commanded: self.stage.commanded(),
            shadow: self.shadow,
            attempts: self.lock.attempts(),
            backlog: self.stage.backlog(),
            delay_s: self.stage.delay_s(),
        }
    }

    /// Continues with other parameters, without a jump of the stage. When the loop releases the stage, its
    /// last command holds the stage, whatever the lease is configured to do.
    pub fn retune(&mut self, params: LoopParams) -> Outcome {
        let old = std::mem::replace(&mut self.params, params);
        let step = BeamOffset([0, 1].map(|axis| params.setpoint[axis] - old.setpoint[axis]));
        self.stage.shift_setpoint(params.map.stage_step(step));
        if params.map != old.map {
            self.tracker.forget();
        }
        if params.map != old.map || params.controller != old.controller {
            self.open_loop = self.open_loop.anew(&params, 2.0 * self.tracker.beam_sigma());
        }
        self.lock.retune(params.limits);
        let mut outcome = Outcome::default();
        if let (Some(offset), true) = (self.offset, params.setpoint != old.setpoint) {
            // The loop may have been locked at the old setpoint, and is not yet at the new one.
            let error = self.error(offset);
            let seen = LockInput::Error { size: error[0].hypot(error[1]), railed: false };
            outcome.transition = self.lock.update(seen, false, 0.0).transition;
        }
        if params.mode != old.mode {
            outcome.transition = self.lock.switch(params.mode).or(outcome.transition);
            (self.offset, self.shadow, self.open_loop) = (None, None, OpenLoopMove::Still);
            if matches!(params.mode, LoopMode::Off | LoopMode::Shadow) {
                let stay = self.stage.commanded().map(|position| self.command(position));
                outcome.command = stay.map(|command| Command { on_expiry: LeaseAction::Hold, ..command });
                self.stage.let_go();
            }
        }
        outcome
    }

    /// Sends the stage to a position, clipped to the limits, metres.
    ///
    /// # Errors
    /// The loop is not in manual mode.
    pub fn move_to(&mut self, position: StagePosition) -> Result<(), LoopRefusal> {
        if self.params.mode != LoopMode::Manual {
            return Err(LoopRefusal::NotManual);
        }
        self.open_loop = OpenLoopMove::jump(self.params.controller.within(position), 0.0);
        Ok(())
    }

    /// Starts a search for the apex, on request of the operator. Returns false if the loop regulates, so that
    /// there is nothing to search.
    ///
    /// # Errors
    /// The loop is not on, or searches are disabled.
    pub fn search(&mut self) -> Result<bool, LoopRefusal> {
        if self.params.mode != LoopMode::On {
            return Err(LoopRefusal::NotOn);
        }
        if !self.params.limits.search {
            return Err(LoopRefusal::SearchDisabled);
        }
        Ok(self.lock.search())
    }

    /// Number of samples missed between the last one and `sample`, without those that the source reports as
    /// lost; `None` if `sample` is not newer than the last one.
    pub fn skipped(&self, sample: &Sample) -> Option<u64> {
        let Some((last, _)) = self.last else { return Some(0) };
        (sample.index > last).then(|| (sample.index - last - 1).saturating_sub(sample.lost.into()))
    }

    /// Records that the stage is back, or was replaced: its position may differ, and so may the sample
    /// counter.
    pub fn stage_up(&mut self) {
        self.last = None;
        self.stage.back();
        self.released();
    }

    /// Records that the stage takes no commands.
    pub fn stage_down(&mut self) {
        self.stage.gone();
    }

    /// Records that the stage has accepted or rejected a command.
    pub fn stage_answers(&mut self, answer: Ack) {
        self.stage.answers(answer.id, answer.accepted);
    }

    /// The commands that the stage has not acknowledged.
    pub fn backlog(&self) -> CommandBacklog {
        self.stage.backlog()
    }

    /// Measured delay from a sample to the first one that has its command applied, seconds, if it is known.
    pub fn delay_s(&self) -> Option<f64> {
        self.stage.delay_s()
    }

    /// The doubt about the configured loop delay, if the measured one contradicts it.
    pub fn delay_doubt(&self) -> Option<DelayDoubt> {
        let LoopParams { loop_delay_s, period_s, .. } = self.params;
        DelayDoubt::of(self.stage.delay_s()?, loop_delay_s, period_s)
    }

    /// Records the position that the stage reports, metres.
    pub fn stage_at(&mut self, position: StagePosition) {
        self.stage.set_reported(position);
    }

    /// The stage has acted on its own.
    fn released(&mut self) {
        let parks = self.params.on_lease == LeaseAction::Park;
        self.stage.released(parks.then_some(self.params.park));
        self.open_loop = OpenLoopMove::Still;
    }

    /// Takes a sample, which must be newer than all before, at time `now`. `pose` is the last valid pose, if
    /// it is recent.
    pub fn sample(&mut self, sample: &Sample, pose: Option<&TimedPose>, now: Mono) -> Outcome {
        let dt = self.seconds_since_last(sample);
        self.now = now;
        if self.last.is_some_and(|(_, time)| sample.time.seconds_since(time) >= self.params.lease_s()) {
            self.released(); // the lease has expired, and the board has acted on its own
        }
        self.stage.shows(sample);
        self.note_lateness(sample, now);
        self.last = Some((sample.index, sample.time));
        self.stage.check_answers(&self.params, now, dt);
        match self.params.mode {
            LoopMode::Off => Outcome::default(),
            LoopMode::Shadow => {
                self.watch(sample, pose, dt);
                Outcome::default()
            }
            LoopMode::Manual => {
                self.take_over(sample, dt);
                self.look(sample, pose);
                Outcome {
                    command: self.steer(Action::Jumping, BeamOffset::default(), None, sample, dt),
                    ..Outcome::default()
                }
            }
            LoopMode::On => self.act(sample, pose, now, dt),
        }
    }

    /// Records whether samples arrive too late to act on them: this one, or, if samples arrive in bursts, those
    /// since the last one. The controller accepts a few periods between two samples.
    fn note_lateness(&mut self, sample: &Sample, now: Mono) {
        let LoopParams { loop_delay_s, period_s, .. } = self.params;
        let sparse = |last| now.seconds_since(last) > loop_delay_s + MOST_PERIODS * period_s;
        let late = self.is_late(sample, now) || self.last.is_some_and(|(_, last)| sparse(last));
        self.late_since = self.late_since.or(Some(now)).filter(|_| late);
    }

    /// Whether a sample arrives too late to act on it.
    fn is_late(&self, sample: &Sample, now: Mono) -> bool {
        now.seconds_since(sample.time) > self.params.loop_delay_s
    }

    /// One step in mode on.
    fn act(&mut self, sample: &Sample, pose: Option<&TimedPose>, now: Mono, dt: f64) -> Outcome {
        let late = self.is_late(sample, now);
        self.take_over(sample, dt);
        let behind = self.stage.behind(sample, &self.params, dt);
        let stuck = self.stage.stuck_s() > self.params.limits.lost_s;
        let observation = match self.trouble() {
            Some(cause) => self.sees(BeamObservation::Unclear(cause)),
            None => self.look(sample, pose),
        };
        let error = self.offset.map_or(BeamOffset::default(), |offset| self.error(offset));
        let seen = if stuck {
            LockInput::Unclear(LockCause::StageStuck)
        } else {
            self.seen(&observation, error, sample)
        };
        let decision = self.lock.update(seen, self.open_loop.arrived(), dt);
        if decision.begins {
            self.open_loop = self.begin(decision.action, &observation);
        }
        if decision.action == Action::Waiting {
            self.note_giving_up(&observation);
        }
        if self.lock.state() == LockState::Locked {
            self.good_place = self.stage.commanded();
        }
        let action = match observation {
            // A late sample is evaluated, but not acted on. The stage still gets its command, which renews
            // the lease; the lease is meant for a daemon that has stopped.
            _ if late => Action::Holding,
            // The stage may be stuck because the command is at a position that it cannot reach.
            BeamObservation::Offset(_) if stuck => Action::Regulating,
            _ => decision.action,
        };
        let command = self.steer(action, error, behind, sample, dt);
        Outcome { command, late, transition: decision.transition }
    }

    /// The reason why the loop cannot act on observations, if there is one.
    fn trouble(&self) -> Option<LockCause> {
        match self.stage.command_status() {
            CommandStatus::Gone => Some(LockCause::StageGone),
            CommandStatus::Refuses => Some(LockCause::StageRefuses),
            CommandStatus::Obeys if self.stage.backlog().overdue => Some(LockCause::CommandsUnanswered),
            CommandStatus::Obeys => {
                let late_s = self.late_since.map_or(0.0, |since| self.now.seconds_since(since));
                (late_s > self.params.limits.lost_s).then_some(LockCause::SamplesTooLate)
            }
        }
    }

    fn look(&mut self, sample: &Sample, pose: Option<&TimedPose>) -> BeamObservation {
        let stage = self.stage.stands_at(sample, &self.params);
        let observation = self.tracker.look(sample, stage, pose, &self.params);
        self.sees(observation)
    }

    fn sees(&mut self, observation: BeamObservation) -> BeamObservation {
        self.offset = if let BeamObservation::Offset(offset) = observation { Some(offset) } else { None };
        observation
    }

    /// The input of the lock state machine for an observation.
    fn seen(&self, observation: &BeamObservation, error: BeamOffset, sample: &Sample) -> LockInput {
        match *observation {
            BeamObservation::Offset(_) => {
                let at_limit = |position| self.params.controller.railed(position);
                let railed = sample.output_railed || self.stage.commanded().is_some_and(at_limit);
                LockInput::Error { size: error[0].hypot(error[1]), railed }
            }
            BeamObservation::Partial { apex, covered, cause } => {
                let (to, radius) = (self.place_for(apex), self.beam_radius());
                let far = |from: StagePosition| (to[0] - from[0]).hypot(to[1] - from[1]);
                let elsewhere = self.stage.commanded().is_some_and(|at| far(at) > WORTH_A_JUMP * radius);
                let news = self.gave_up.is_none_or(|at| far(at) > radius);
                LockInput::Partial {
                    elsewhere,
                    covered: covered && !elsewhere && self.tracker.knows_apex(),
                    news,
                    cause,
                }
            }
            BeamObservation::Dark => LockInput::Dark,
            BeamObservation::Unclear(cause) => LockInput::Unclear(cause),
        }
    }

    /// Observations count as known until the stage has come to rest at the last good position.
    fn note_giving_up(&mut self, observation: &BeamObservation) {
        if !matches!(self.open_loop, OpenLoopMove::Jump { .. }) {
            let back = self.good_place.unwrap_or_default();
            self.open_loop = OpenLoopMove::jump(back, self.params.settling_s());
        }
        match *observation {
            BeamObservation::Partial { apex, .. } if !self.open_loop.arrived() => {
                self.gave_up = Some(self.place_for(apex));
            }
            BeamObservation::Partial { .. } => {}
            _ => self.gave_up = None, // any light then starts a new search
        }
    }

    /// The jump or the search that begins now.
    fn begin(&self, action: Action, observation: &BeamObservation) -> OpenLoopMove {
        let Some(here) = self.stage.commanded() else { return OpenLoopMove::Still };
        match (action, observation) {
            (Action::Jumping, BeamObservation::Partial { apex, .. }) => {
                OpenLoopMove::jump(self.place_for(*apex), self.params.settling_s())
            }
            // From the last good position, or around the present one if there is some light.
            (Action::Searching, observation) => {
                let dark = *observation == BeamObservation::Dark;
                let centre = if dark { self.good_place.unwrap_or(here) } else { here };
                OpenLoopMove::search(centre, 2.0 * self.tracker.beam_sigma(), &self.params)
            }
            _ => OpenLoopMove::Still,
        }
    }

    /// Position of the stage that brings the beam to the setpoint, for an apex at `apex`; within the limits.
    fn place_for(&self, apex: BeamPoint) -> StagePosition {
        let beam = [0, 1].map(|i| apex[i] + self.params.setpoint[i]);
        self.params.controller.within(self.params.map.stage(BeamPoint(beam)))
    }

    /// 1/e^2 radius of the beam, in lengths of the stage.
    fn beam_radius(&self) -> f64 {
        2.0 * self.tracker.beam_sigma() / self.params.map.largest_gain()
    }

    /// The next command, unless no stage takes it. `behind` is the actual position if the stage does not
    /// follow.
    fn steer(
        &mut self,
        action: Action,
        error: BeamOffset,
        behind: Option<StagePosition>,
        sample: &Sample,
        dt: f64,
    ) -> Option<Command> {
        let memory = self.stage.memory()?;
        let LoopParams { controller, map, feed_forward, .. } = self.params;
        let next = match action {
            Action::Regulating => {
                let velocity = if feed_forward { self.tracker.velocity() } else { BeamOffset::default() };
                controller.update(&memory, map.stage_step(error), map.stage_step(velocity), dt)
            }
            Action::Holding => controller.hold(&memory, dt),
            Action::Jumping | Action::Searching | Action::Waiting => {
                match self.open_loop.next(memory.position, dt) {
                    Some(target) => controller.go(&memory, target, dt),
                    None => controller.hold(&memory, dt),
                }
            }
        };
        let next = behind.map_or(next, |at| next.hold_if_stalled(&memory, at));
        self.stage.sent(next, sample, &self.params);
        let command = self.command(next.position);
        self.stage.computed(command.id, sample);
        Some(command)
    }

    /// Shadow mode: computes what the loop would do next if it took over now.
    fn watch(&mut self, sample: &Sample, pose: Option<&TimedPose>, dt: f64) {
        let stage = self.stage.found(sample, &self.params, dt);
        self.look(sample, pose);
        self.shadow = self.offset.map(|offset| {
            let error = self.params.map.stage_step(self.error(offset));
            (stage.position, self.params.controller.update(&stage, error, StageMove::default(), dt).position)
        });
    }

    /// Error: setpoint minus offset, metres.
    fn error(&self, offset: BeamOffset) -> BeamOffset {
        BeamOffset([0, 1].map(|axis| self.params.setpoint[axis] - offset[axis]))
    }

    /// Records `dt` seconds without a sample. There is no command: the lease determines what the stage does.
    pub fn silence(&mut self, dt: f64) -> Option<Transition> {
        (self.offset, self.shadow) = (None, None);
        self.tracker.interrupt();
        self.lock.update(LockInput::Unclear(LockCause::NoSamples), false, dt).transition
    }

    /// The last command: hold or park. `None` if the loop does not control the stage, or the stage takes no
    /// commands.
    pub fn finish(&mut self) -> Option<Command> {
        let memory = self.stage.memory()?;
        let position = match self.params.on_exit {
            OnExit::Hold => memory.position,
            OnExit::Park => self.params.park,
        };
        Some(self.command(position))
    }

    fn take_over(&mut self, sample: &Sample, dt: f64) {
        if self.stage.take_over(sample, &self.params, dt) {
            self.tracker.interrupt();
            self.good_place = self.good_place.or(self.stage.commanded());
        }
    }

    fn seconds_since_last(&self, sample: &Sample) -> f64 {
        let passed = self.last.map_or(self.params.period_s, |(_, time)| sample.time.seconds_since(time));
        passed.clamp(0.0, MOST_PERIODS * self.params.period_s)
    }

    fn command(&mut self, position: StagePosition) -> Command {
        self.commands = self.commands.wrapping_add(1);
        let LoopParams { lease_ms, on_lease, .. } = self.params;
        self.stage.commands(self.commands, position, self.now);
        Command { id: self.commands, position, lease_ms, on_expiry: on_lease }
    }
}
