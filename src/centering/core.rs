//! The loop: a sample and the last pose in, a steering command out. Pure.

use super::controller::{Controller, Memory};
use super::lock::{Lock, LockLimits, LockState, Sight, Transition};
use crate::acquisition::{PsdState, Sample};
use crate::clock::Mono;
use crate::config::{Config, LoopMode, OnExit, Target};
use crate::optics::{HeadError, Optics, Pose};
use crate::steering::{Command, Expiry, Xy};

/// The time between samples counts as at most so many periods.
const MOST_PERIODS: f64 = 5.0;

pub(super) const TOO_LATE: &str = "samples come later than centering.loop_delay_ms";

/// What the rest of the house is told of the loop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LoopState {
    /// The lock state.
    pub lock: LockState,
    /// Where the stage was last commanded to, metres; none unless the loop is on.
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
    /// Where the stage was last commanded to, metres; none unless the loop is on.
    pub commanded: Option<Xy>,
    /// In the shadow: where the stage stands, and where the loop would send it next, metres.
    pub shadow: Option<(Xy, Xy)>,
}

/// What follows from a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// The command for the stage, unless the loop is off.
    pub command: Option<Command>,
    /// The sample came too late to act on it: the command holds.
    pub late: bool,
    /// The lock state has changed.
    pub transition: Option<Transition>,
}

/// How the loop shall work. All of it can change while the loop runs.
#[derive(Clone, Copy, Debug)]
pub struct Tuning {
    mode: LoopMode,
    target: Target,
    /// The offset that the loop goes to, metres.
    setpoint: Xy,
    controller: Controller,
    limits: LockLimits,
    /// A sample older than this comes too late: the gains are made for this delay, and with a longer
    /// one the loop would push again and again before it sees what it has done.
    fresh_s: f64,
    /// For how long they may come too late until it is no hiccup.
    patience_s: f64,
    park: Xy,
    on_exit: OnExit,
    on_lease: Expiry,
    lease_ms: u16,
}

impl Tuning {
    /// From a checked configuration.
    pub fn new(config: &Config) -> Self {
        let steering = &config.steering;
        Self {
            mode: config.centering.mode,
            target: config.centering.target,
            setpoint: config.centering.setpoint_um.map(|um| um * 1e-6),
            controller: Controller::new(config),
            limits: LockLimits::new(&config.centering),
            fresh_s: config.centering.loop_delay_s(config.acquisition.rate_hz),
            patience_s: config.centering.lost_time_ms * 1e-3,
            park: steering.park_um.map(|um| um * 1e-6),
            on_exit: steering.on_exit,
            on_lease: match steering.on_lease {
                OnExit::Hold => Expiry::Hold,
                OnExit::Park => Expiry::Park,
            },
            lease_ms: steering.lease_ms,
        }
    }
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
    /// For how long samples have come too late.
    late_s: f64,
    last: Option<(u64, Mono)>,
    offset: Option<Xy>,
    shadow: Option<(Xy, Xy)>,
    commands: u32,
}

impl Centering {
    /// From a checked configuration.
    pub fn new(config: &Config) -> Result<Self, HeadError> {
        let tuning = Tuning::new(config);
        Ok(Self {
            optics: Optics::new(&config.head.build()?),
            tuning,
            period_s: 1.0 / config.acquisition.rate_hz,
            lock: Lock::new(tuning.limits, tuning.mode == LoopMode::On),
            memory: None,
            apart: true,
            ours: false,
            late_s: 0.0,
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
            commanded: self.commanded(),
            shadow: self.shadow,
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
        self.memory = self.memory.map(|memory| memory.shifted(step));
        let transition = self.lock.retune(tuning.limits, tuning.mode == LoopMode::On);
        let mut command = None;
        if tuning.mode != old.mode {
            (self.offset, self.shadow) = (None, None);
            if let Some(position) = self.commanded() {
                command = Some(Command { on_expiry: Expiry::Hold, ..self.command(position) });
            }
            self.apart = true;
        }
        Outcome { command, late: false, transition }
    }

    /// Samples that came and went between `sample` and the last one seen; `None` if it is not newer.
    pub fn skipped(&self, sample: &Sample) -> Option<u64> {
        let Some((last, _)) = self.last else { return Some(0) };
        (sample.index > last).then(|| (sample.index - last - 1).saturating_sub(sample.lost.into()))
    }

    /// The source is another one, or came back: the stage may stand elsewhere.
    pub fn source_changed(&mut self) {
        self.last = None;
        let parked = self.tuning.on_lease == Expiry::Park && !self.apart;
        (self.apart, self.ours) = (true, false);
        // Until a readback says better, where the lease has left it.
        self.memory = self.memory.map(|m| Memory::at(if parked { self.tuning.park } else { m.position }));
    }

    /// Takes a sample, which must be newer than all before, at the moment `now`. `pose` is the last valid
    /// pose, if it is fresh.
    pub fn sample(&mut self, sample: &Sample, pose: Option<&Pose>, now: Mono) -> Outcome {
        let dt = self.seconds_since_last(sample);
        let lease_s = f64::from(self.tuning.lease_ms) * 1e-3;
        if self.last.is_some_and(|(_, time)| sample.time.seconds_since(time) >= lease_s) {
            self.source_changed(); // the board has acted by itself in the meantime
        }
        self.last = Some((sample.index, sample.time));
        match self.tuning.mode {
            LoopMode::Off | LoopMode::Manual => Outcome::default(),
            LoopMode::Shadow => {
                self.watch(sample, pose, dt);
                Outcome::default()
            }
            LoopMode::On => {
                let late = now.seconds_since(sample.time) > self.tuning.fresh_s;
                self.late_s = if late { self.late_s + dt } else { 0.0 };
                let offset = self.offset(sample, pose);
                let patient = self.late_s <= self.tuning.patience_s;
                // What is late is looked at, and not acted upon. The stage still gets its command: that
                // renews the lease, which is for a daemon that is dead.
                let command = self.steer(sample, if late { Err(TOO_LATE) } else { offset }, dt);
                let transition = self.judge(sample, if patient { offset } else { Err(TOO_LATE) }, dt);
                Outcome { command: Some(command), late, transition }
            }
        }
    }

    fn steer(&mut self, sample: &Sample, offset: Result<Xy, &str>, dt: f64) -> Command {
        let memory = match self.memory {
            Some(memory) if !self.apart => memory,
            _ => self.take_over(sample, dt),
        };
        (self.apart, self.ours) = (false, true);
        let controller = self.tuning.controller;
        let next = match offset {
            Ok(offset) => controller.update(&memory, self.error(offset), dt),
            Err(_) => controller.hold(&memory, dt),
        };
        self.memory = Some(next);
        self.command(next.position)
    }

    /// What the lock makes of an offset.
    fn judge(&mut self, sample: &Sample, offset: Result<Xy, &'static str>, dt: f64) -> Option<Transition> {
        self.offset = offset.ok();
        let sight = match offset {
            Ok(offset) => {
                let error = self.error(offset);
                let at_limit = |position| self.tuning.controller.railed(position);
                let railed = sample.output_railed || self.commanded().is_some_and(at_limit);
                Sight::Offset { size: error[0].hypot(error[1]), railed }
            }
            Err(cause) => Sight::Nothing(cause),
        };
        self.lock.update(sight, dt)
    }

    /// In the shadow: what the loop would do next if it took over now.
    fn watch(&mut self, sample: &Sample, pose: Option<&Pose>, dt: f64) {
        let stage = self.take_over(sample, dt);
        self.offset = self.offset(sample, pose).ok();
        self.shadow = self.offset.map(|offset| {
            let next = self.tuning.controller.update(&stage, self.error(offset), dt);
            (stage.position, next.position)
        });
    }

    /// From where the beam is to where it shall be.
    fn error(&self, offset: Xy) -> Xy {
        [0, 1].map(|axis| self.tuning.setpoint[axis] - offset[axis])
    }

    /// `dt` seconds have passed without a sample. No command: the lease decides what the stage does.
    pub fn silence(&mut self, dt: f64) -> Option<Transition> {
        (self.offset, self.shadow) = (None, None);
        self.lock.update(Sight::Nothing("no samples come"), dt)
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

    /// The stage as it stands: as it says itself, or where it was sent last. If nothing but this loop has
    /// moved it (`ours`), and it stands there to within a step, the last command is the better number.
    fn take_over(&self, sample: &Sample, dt: f64) -> Memory {
        let limit = self.tuning.controller.limit;
        let sent = self.memory.map(|memory| memory.position);
        let read = sample.steering.filter(|at| at.iter().all(|p| p.is_finite()));
        if let (Some(read), Some(sent), true) = (read, sent, self.ours) {
            let reach = self.tuning.controller.slew * dt;
            if (0..2).all(|axis| (read[axis] - sent[axis]).abs() <= reach) {
                return Memory::at(sent);
            }
        }
        let position = read.or(sent).unwrap_or_default();
        Memory::at(position.map(|p| p.clamp(-limit, limit)))
    }

    fn seconds_since_last(&self, sample: &Sample) -> f64 {
        let passed = self.last.map_or(self.period_s, |(_, time)| sample.time.seconds_since(time));
        passed.clamp(0.0, MOST_PERIODS * self.period_s)
    }

    /// The beam's offset by the powers, or why it is not known.
    fn offset(&self, sample: &Sample, pose: Option<&Pose>) -> Result<Xy, &'static str> {
        if sample.psds.contains(&PsdState::Clipped) {
            return Err("a channel is clipped");
        }
        if sample.psds.contains(&PsdState::Low) {
            return Err("a PSD sees too little light");
        }
        let nominal = Pose::default();
        let pose = match self.tuning.target {
            Target::Apex => pose.unwrap_or(&nominal),
            // Nominal wedges: there equal powers are zero offset.
            Target::Balance => &nominal,
        };
        let offset = self.optics.offset_of_powers(&sample.powers, pose);
        offset.map(Into::into).map_err(|_| "the powers give no offset")
    }

    fn command(&mut self, position: Xy) -> Command {
        self.commands = self.commands.wrapping_add(1);
        let Tuning { lease_ms, on_lease, .. } = self.tuning;
        Command { id: self.commands, position, lease_ms, on_expiry: on_lease }
    }
}
