//! The loop: a sample and the last pose in, a steering command out. Pure.

use super::controller::{Controller, Memory};
use super::guide::Guide;
use super::lock::{Doing, Lock, LockState, Seen, Transition};
use super::sight::Sight;
use super::tracking::Tracking;
use super::trail::Trail;
use super::tuning::Tuning;
use crate::acquisition::Sample;
use crate::clock::Mono;
use crate::config::{Config, LoopMode, OnExit, Target};
use crate::optics::{HeadError, Optics, Pose};
use crate::steering::{Command, Expiry, Xy};

/// The time between samples counts as at most so many periods.
const MOST_PERIODS: f64 = 5.0;

pub(super) const TOO_LATE: &str = "samples come later than centering.loop_delay_ms";
pub(super) const STUCK: &str = "the stage does not follow its commands";
pub(super) const NO_STAGE: &str = "the stage takes no commands";

/// What the rest of the house is told of the loop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LoopState {
    /// The lock state.
    pub lock: LockState,
    /// Where the stage was last commanded to, metres; none unless the loop has it.
    pub position: Option<Xy>,
}

/// What a person may want to know of the loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopView {
    /// What it does.
    pub mode: LoopMode,
    /// The lock state.
    pub lock: LockState,
    /// The offset of the beam in the last sample, metres; not looked at while the loop is off.
    pub offset: Option<Xy>,
    /// Velocity of the apex by the tracking filter, metres per second.
    pub velocity: Xy,
    /// Where the stage was last commanded to, metres; none unless the loop has it.
    pub commanded: Option<Xy>,
    /// In the shadow: where the stage stands, and where the loop would send it next, metres.
    pub shadow: Option<(Xy, Xy)>,
    /// Searches in vain since it was last locked.
    pub attempts: u32,
}

/// What follows from a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// The command for the stage, unless it is not the loop's.
    pub command: Option<Command>,
    /// The sample came too late to act on it: the command holds.
    pub late: bool,
    /// The lock state has changed.
    pub transition: Option<Transition>,
}

/// A pose with the time of its sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedPose {
    /// The pose, in the sensor's world.
    pub pose: Pose,
    /// When its signals were taken.
    pub time: Mono,
}

/// The loop.
#[derive(Clone, Debug)]
pub struct Centering {
    optics: Optics,
    tuning: Tuning,
    period_s: f64,
    lock: Lock,
    /// Where the stage was sent last.
    memory: Option<Memory>,
    /// The stage is to be taken over, where it stands, before it is moved.
    apart: bool,
    /// Nothing but this loop has moved the stage since then.
    ours: bool,
    /// The stage takes no commands.
    gone: bool,
    /// Where the stage itself says that it stands, if not in the samples.
    reported: Option<Xy>,
    trail: Trail,
    guide: Guide,
    /// Where the stage was when the loop was last locked.
    good_place: Option<Xy>,
    tracking: Tracking,
    /// Where the apex is, as far as was seen, in the plane of the beam's movement; and whether it was ever seen
    /// by all three PSDs.
    apex: Option<Xy>,
    apex_known: bool,
    /// The last pose that was told.
    pose: Pose,
    /// For how long samples have come too late, and for how long the stage has not followed.
    late_s: f64,
    stuck_s: f64,
    last: Option<(u64, Mono)>,
    offset: Option<Xy>,
    shadow: Option<(Xy, Xy)>,
    commands: u32,
}

impl Centering {
    /// From a checked configuration.
    pub fn new(config: &Config) -> Result<Self, HeadError> {
        let optics = Optics::new(&config.head.build()?);
        let tuning = Tuning::new(config);
        Ok(Self {
            optics,
            tuning,
            period_s: 1.0 / config.acquisition.rate_hz,
            lock: Lock::new(tuning.limits, tuning.mode),
            memory: None,
            apart: true,
            ours: false,
            gone: false,
            reported: None,
            trail: Trail::default(),
            guide: Guide::Still,
            good_place: None,
            tracking: Tracking::default(),
            apex: None,
            apex_known: false,
            pose: Pose::default(),
            late_s: 0.0,
            stuck_s: 0.0,
            last: None,
            offset: None,
            shadow: None,
            commands: 0,
        })
    }

    /// What the loop is doing.
    pub fn state(&self) -> LoopState {
        LoopState { lock: self.lock.state(), position: self.commanded() }
    }

    /// The same, and more, for people.
    pub fn view(&self) -> LoopView {
        LoopView {
            mode: self.tuning.mode,
            lock: self.lock.state(),
            offset: self.offset,
            velocity: self.tracking.velocity(),
            commanded: self.commanded(),
            shadow: self.shadow,
            attempts: self.lock.attempts(),
        }
    }

    fn commanded(&self) -> Option<Xy> {
        self.memory.filter(|_| !self.apart).map(|memory| memory.position)
    }

    /// Goes on with another tuning, without a jump of the stage. When the loop lets go of the stage, its
    /// last command is to stay there, whatever the lease would have done.
    pub fn retune(&mut self, tuning: Tuning) -> Outcome {
        let old = std::mem::replace(&mut self.tuning, tuning);
        let step = [0, 1].map(|axis| tuning.setpoint[axis] - old.setpoint[axis]);
        let step = tuning.map.stage_step(step);
        self.memory = self.memory.map(|memory| memory.shifted(step));
        if tuning.map != old.map {
            // The beam is elsewhere than was thought, and so is the apex.
            (self.apex, self.apex_known, self.guide) = (None, false, Guide::Still);
            self.tracking.reset();
        }
        self.lock.retune(tuning.limits);
        let mut outcome = Outcome::default();
        if tuning.mode != old.mode {
            outcome.transition = self.lock.switch(tuning.mode);
            (self.offset, self.shadow, self.guide) = (None, None, Guide::Still);
            let has_stage = |mode| matches!(mode, LoopMode::On | LoopMode::Manual);
            if !has_stage(tuning.mode) {
                let stay = self.commanded().map(|position| self.command(position));
                outcome.command = stay.map(|command| Command { on_expiry: Expiry::Hold, ..command });
                self.apart = true;
            }
        }
        outcome
    }

    /// Sends the stage to a position within the limits, metres.
    ///
    /// # Errors
    /// The loop is not in manual mode: then the stage is not a person's.
    pub fn move_to(&mut self, position: Xy) -> Result<(), &'static str> {
        if self.tuning.mode != LoopMode::Manual {
            return Err("the stage is moved by hand only while the loop is \"manual\"");
        }
        self.guide = Guide::jump(self.tuning.controller.within(position), 0.0);
        Ok(())
    }

    /// A person wants the loop to look for the apex now.
    ///
    /// # Errors
    /// The loop is not on.
    pub fn search(&mut self) -> Result<(), &'static str> {
        if self.tuning.mode != LoopMode::On {
            return Err("the loop looks for the apex only while it is \"on\"");
        }
        if !self.tuning.limits.search {
            return Err("centering.search is false");
        }
        self.lock.search();
        Ok(())
    }

    /// Samples that came and went between `sample` and the last one seen; `None` if it is not newer.
    pub fn skipped(&self, sample: &Sample) -> Option<u64> {
        let Some((last, _)) = self.last else { return Some(0) };
        (sample.index > last).then(|| (sample.index - last - 1).saturating_sub(sample.lost.into()))
    }

    /// The stage is another one, or came back: it may stand elsewhere. So may the counter of the samples.
    pub fn stage_up(&mut self) {
        (self.last, self.gone) = (None, false);
        self.released();
    }

    /// The stage takes no commands until it comes back.
    pub fn stage_down(&mut self) {
        self.gone = true;
    }

    /// Where the stage says that it stands, metres.
    pub fn stage_at(&mut self, position: Xy) {
        self.reported = Some(position).filter(|at| at.iter().all(|p| p.is_finite()));
    }

    /// The stage has acted by itself.
    fn released(&mut self) {
        let parked = self.tuning.on_lease == Expiry::Park && !self.apart;
        (self.apart, self.ours, self.guide) = (true, false, Guide::Still);
        // Until a readback says better, where the lease has left it.
        self.memory = self.memory.map(|m| Memory::at(if parked { self.tuning.park } else { m.position }));
    }

    /// Takes a sample, which must be newer than all before, at the moment `now`. `pose` is the last valid
    /// pose, if it is fresh.
    pub fn sample(&mut self, sample: &Sample, pose: Option<&TimedPose>, now: Mono) -> Outcome {
        let dt = self.seconds_since_last(sample);
        if self.last.is_some_and(|(_, time)| sample.time.seconds_since(time) >= self.tuning.lease_s()) {
            self.released(); // the board has acted by itself in the meantime
        }
        self.last = Some((sample.index, sample.time));
        match self.tuning.mode {
            LoopMode::Off => Outcome::default(),
            LoopMode::Shadow => {
                self.watch(sample, pose, dt);
                Outcome::default()
            }
            LoopMode::Manual => {
                self.take_over_once(sample, dt);
                let sight = self.look(sample, pose);
                self.offset = offset_of(sight);
                Outcome { command: self.steer(Doing::Jumping, [0.0; 2], sample, dt), ..Outcome::default() }
            }
            LoopMode::On => self.act(sample, pose, now, dt),
        }
    }

    /// The loop is on.
    fn act(&mut self, sample: &Sample, pose: Option<&TimedPose>, now: Mono, dt: f64) -> Outcome {
        let late = now.seconds_since(sample.time) > self.tuning.loop_delay_s;
        self.late_s = if late { self.late_s + dt } else { 0.0 };
        self.take_over_once(sample, dt);
        let follows = self.follows(sample);
        self.stuck_s = if follows { 0.0 } else { self.stuck_s + dt };
        let sight = match self.trouble() {
            Some(cause) => Sight::Unclear(cause),
            None => self.look(sample, pose),
        };
        self.offset = offset_of(sight);
        let error = self.offset.map_or([0.0; 2], |offset| self.error(offset));
        let seen = self.seen(&sight, error, sample);
        let verdict = self.lock.update(seen, self.guide.arrived(), dt);
        if verdict.begins {
            self.guide = self.begin(verdict.doing, &sight);
        }
        if self.lock.state() == LockState::Locked {
            self.good_place = self.commanded();
        }
        // What is late is looked at, and not acted upon. The stage still gets its command: that renews the
        // lease, which is for a daemon that is dead. A stage that stays behind is waited for: pushing on
        // would send it far away once it comes free.
        let doing = if late || !follows { Doing::Holding } else { verdict.doing };
        let command = self.steer(doing, error, sample, dt);
        Outcome { command, late, transition: verdict.transition }
    }

    /// Why nothing can be done with what is seen.
    fn trouble(&self) -> Option<&'static str> {
        let Tuning { patience_s, .. } = self.tuning;
        match () {
            () if self.gone => Some(NO_STAGE),
            () if self.late_s > patience_s => Some(TOO_LATE),
            () if self.stuck_s > patience_s => Some(STUCK),
            () => None,
        }
    }

    /// What the sample says of the beam; notes where the apex is, and feeds the tracking filter.
    fn look(&mut self, sample: &Sample, pose: Option<&TimedPose>) -> Sight {
        if let Some(told) = pose {
            self.pose = told.pose;
        }
        let nominal = Pose::default();
        let wedges = match self.tuning.target {
            Target::Apex => pose.map_or(nominal, |told| told.pose),
            // Nominal wedges: there equal powers are zero offset.
            Target::Balance => nominal,
        };
        let beam = self.tuning.map.beam(self.stands_at(sample));
        let apex = self.apex.unwrap_or(self.optics.seen(self.pose.t));
        let all_lit = sample.psds.iter().all(|psd| *psd == Default::default());
        let mirror = if all_lit { &wedges } else { &self.pose };
        let sight = Sight::of(sample, beam, mirror, apex, &self.optics);
        match sight {
            Sight::Offset(offset) => {
                let seen = [0, 1].map(|i| beam[i] - offset[i]);
                (self.apex, self.apex_known) = (Some(seen), true);
                self.track(sample, seen, pose);
            }
            Sight::Some { apex, .. } => self.apex = Some(apex),
            Sight::Dark | Sight::Unclear(_) => {}
        }
        sight
    }

    /// Position of the apex for the tracking filter, by the quieter of two sources: readback less offset (0.1 um
    /// with good parts), or the solved pose of nine signals (1 um). The pose of eleven signals is the former, a
    /// sample later.
    fn track(&mut self, sample: &Sample, apex: Xy, pose: Option<&TimedPose>) {
        let (position, time) = match (read_back(sample), pose) {
            (Some(_), _) => (apex, sample.time),
            (None, Some(told)) => (self.optics.seen(told.pose.t), told.time),
            (None, None) => return,
        };
        if position.iter().all(|p| p.is_finite()) {
            let patience_s = MOST_PERIODS * self.period_s;
            self.tracking.update(position, time, self.tuning.tracking_hz, patience_s);
        }
    }

    fn seen(&self, sight: &Sight, error: Xy, sample: &Sample) -> Seen {
        let at_limit = |position| self.tuning.controller.railed(position);
        let railed = sample.output_railed || self.commanded().is_some_and(at_limit);
        let elsewhere = match (sight, self.commanded()) {
            (Sight::Some { apex, .. }, Some(from)) => {
                let to = self.place_for(*apex);
                let moved = [0, 1].map(|i| to[i] - from[i]);
                moved[0].hypot(moved[1]) > 0.25 * self.beam_radius()
            }
            _ => false,
        };
        sight.seen(error[0].hypot(error[1]), railed, elsewhere, self.apex_known)
    }

    /// The jump or the search that begins now.
    fn begin(&self, doing: Doing, sight: &Sight) -> Guide {
        let Some(here) = self.commanded() else { return Guide::Still };
        match (doing, sight) {
            (Doing::Jumping, Sight::Some { apex, .. }) => {
                Guide::jump(self.place_for(*apex), self.tuning.settling_s)
            }
            // Around where the light is, or from the last good place.
            (Doing::Searching, sight) => {
                let dark = *sight == Sight::Dark;
                let centre = if dark { self.good_place.unwrap_or(here) } else { here };
                Guide::search(centre, self.beam_radius(), &self.tuning)
            }
            _ => Guide::Still,
        }
    }

    /// Where the stage must stand for the beam to be where it shall be, if the apex is there; within limits.
    fn place_for(&self, apex: Xy) -> Xy {
        let beam = [0, 1].map(|i| apex[i] + self.tuning.setpoint[i]);
        self.tuning.controller.within(self.tuning.map.stage(beam))
    }

    /// 1/e^2 radius of the beam, in lengths of the stage.
    fn beam_radius(&self) -> f64 {
        2.0 * self.optics.sigma() / self.tuning.map.largest_gain()
    }

    /// The next command, unless there is no stage to take it.
    fn steer(&mut self, doing: Doing, error: Xy, sample: &Sample, dt: f64) -> Option<Command> {
        let memory = self.memory.filter(|_| !self.apart && !self.gone)?;
        let Tuning { controller, map, feed_forward, .. } = self.tuning;
        let next = match doing {
            Doing::Regulating => {
                let velocity = if feed_forward { self.tracking.velocity() } else { [0.0; 2] };
                controller.update(&memory, map.stage_step(error), map.stage_step(velocity), dt)
            }
            Doing::Holding => controller.hold(&memory, dt),
            Doing::Jumping | Doing::Searching => match self.guide.next(memory.position, dt) {
                Some(target) => controller.go(&memory, target, dt),
                None => controller.hold(&memory, dt),
            },
            Doing::Waiting => controller.go(&memory, self.good_place.unwrap_or(memory.position), dt),
        };
        self.memory = Some(next);
        self.trail.push(next.position, sample.time, self.tuning.span_s);
        Some(self.command(next.position))
    }

    /// In the shadow: what the loop would do next if it took over now.
    fn watch(&mut self, sample: &Sample, pose: Option<&TimedPose>, dt: f64) {
        let stage = self.stage(sample, dt);
        let sight = self.look(sample, pose);
        self.offset = offset_of(sight);
        self.shadow = self.offset.map(|offset| {
            let error = self.tuning.map.stage_step(self.error(offset));
            (stage.position, self.tuning.controller.update(&stage, error, [0.0; 2], dt).position)
        });
    }

    /// From where the beam is to where it shall be.
    fn error(&self, offset: Xy) -> Xy {
        [0, 1].map(|axis| self.tuning.setpoint[axis] - offset[axis])
    }

    /// `dt` seconds have passed without a sample. No command: the lease decides what the stage does.
    pub fn silence(&mut self, dt: f64) -> Option<Transition> {
        (self.offset, self.shadow) = (None, None);
        self.tracking.reset();
        self.lock.update(Seen::Unclear("no samples come"), false, dt).transition
    }

    /// The last command: hold or park. `None` if the stage is not the loop's.
    pub fn finish(&mut self) -> Option<Command> {
        let commanded = self.commanded()?;
        let position = match self.tuning.on_exit {
            OnExit::Hold => commanded,
            OnExit::Park => self.tuning.park,
        };
        Some(self.command(position))
    }

    fn take_over_once(&mut self, sample: &Sample, dt: f64) {
        if self.apart && !self.gone {
            let memory = self.stage(sample, dt);
            self.memory = Some(memory);
            self.trail.clear();
            self.trail.push(memory.position, sample.time, self.tuning.span_s);
            self.tracking.reset();
            (self.apart, self.ours, self.stuck_s) = (false, true, 0.0);
            self.good_place = self.good_place.or(Some(memory.position));
        }
    }

    /// The stage as it stands: as it says itself, or where it was sent last. If nothing but this loop has
    /// moved it (`ours`), and it stands there to within a step, the last command is the better number.
    fn stage(&self, sample: &Sample, dt: f64) -> Memory {
        let Controller { slew, .. } = self.tuning.controller;
        let sent = self.memory.map(|memory| memory.position);
        let read = read_back(sample).or(self.reported);
        if let (Some(read), Some(sent), true) = (read, sent, self.ours)
            && (0..2).all(|axis| (read[axis] - sent[axis]).abs() <= slew * dt)
        {
            return Memory::at(sent);
        }
        Memory::at(self.tuning.controller.within(read.or(sent).unwrap_or_default()))
    }

    /// Where the stage stood when the sample was taken, as well as it is known.
    fn stands_at(&self, sample: &Sample) -> Xy {
        let sent = || self.trail.before(sample.time, self.tuning.loop_delay_s).or(self.commanded());
        read_back(sample).or_else(sent).or(self.reported).unwrap_or_default()
    }

    /// Whether the stage goes where it is sent, as far as its readback shows.
    fn follows(&self, sample: &Sample) -> bool {
        read_back(sample).is_none_or(|at| self.trail.leads_to(at, self.tuning.following))
    }

    fn seconds_since_last(&self, sample: &Sample) -> f64 {
        let passed = self.last.map_or(self.period_s, |(_, time)| sample.time.seconds_since(time));
        passed.clamp(0.0, MOST_PERIODS * self.period_s)
    }

    fn command(&mut self, position: Xy) -> Command {
        self.commands = self.commands.wrapping_add(1);
        let Tuning { lease_ms, on_lease, .. } = self.tuning;
        Command { id: self.commands, position, lease_ms, on_expiry: on_lease }
    }
}

fn offset_of(sight: Sight) -> Option<Xy> {
    if let Sight::Offset(offset) = sight { Some(offset) } else { None }
}

/// The position of the stage in the sample.
fn read_back(sample: &Sample) -> Option<Xy> {
    sample.steering.filter(|at| at.iter().all(|p| p.is_finite()))
}
