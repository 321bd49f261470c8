//! The loop: a sample and the last pose in, a steering command out. Pure.

use super::controller::{Controller, Memory, Xy};
use super::lock::{Lock, LockLimits, LockState, Sight, Transition};
use crate::acquisition::{Expiry, OutputCommand, PsdState, Sample};
use crate::clock::Mono;
use crate::config::{Config, OnExit, Target};
use crate::optics::{HeadError, Optics, Pose};

/// The time between samples counts as at most so many periods.
const MOST_PERIODS: f64 = 5.0;

const TOO_LATE: &str = "samples come later than centering.loop_delay_ms";

/// What the rest of the house is told of the loop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LoopState {
    /// The lock state.
    pub lock: LockState,
    /// Where the stage was last commanded to, metres.
    pub position: Option<Xy>,
}

/// What follows from a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// The command for the stage, unless the loop is off.
    pub command: Option<OutputCommand>,
    /// The sample came too late to act on it: the command holds.
    pub late: bool,
    /// The lock state has changed.
    pub transition: Option<Transition>,
}

/// The loop.
#[derive(Clone, Debug)]
pub struct Centering {
    optics: Optics,
    target: Target,
    controller: Controller,
    enabled: bool,
    period_s: f64,
    /// A sample older than this comes too late: the gains are made for this delay, and with a longer
    /// one the loop would push again and again before it sees what it has done.
    fresh_s: f64,
    /// For how long they have come too late, and how long that may last before it is no hiccup.
    late_s: f64,
    patience_s: f64,
    steering: Steering,
    lock: Lock,
    memory: Option<Memory>,
    last: Option<(u64, Mono)>,
}

/// The stage as the commands need to know it.
#[derive(Clone, Debug)]
struct Steering {
    full_scale: f64,
    park: Xy,
    on_exit: OnExit,
    on_lease: Expiry,
    lease_ms: u16,
    id: u32,
}

impl Centering {
    /// From a checked configuration.
    pub fn new(config: &Config) -> Result<Self, HeadError> {
        let steering = &config.steering;
        Ok(Self {
            optics: Optics::new(&config.head.build()?),
            target: config.centering.target,
            controller: Controller::new(config),
            enabled: config.centering.enabled,
            period_s: 1.0 / config.acquisition.rate_hz,
            fresh_s: config.centering.loop_delay_s(config.acquisition.rate_hz),
            late_s: 0.0,
            patience_s: config.centering.lost_time_ms * 1e-3,
            lock: Lock::new(LockLimits::new(&config.centering), config.centering.enabled),
            memory: None,
            last: None,
            steering: Steering {
                full_scale: steering.full_scale_um * 1e-6,
                park: steering.park_um.map(|um| um * 1e-6),
                on_exit: steering.on_exit,
                on_lease: match steering.on_lease {
                    OnExit::Hold => Expiry::Hold,
                    OnExit::Park => Expiry::Park,
                },
                lease_ms: steering.lease_ms,
                id: 0,
            },
        })
    }

    /// What the loop is doing.
    pub fn state(&self) -> LoopState {
        LoopState { lock: self.lock.state(), position: self.memory.map(|memory| memory.position) }
    }

    /// Samples that came and went between `sample` and the last one seen; `None` if it is not newer.
    pub fn skipped(&self, sample: &Sample) -> Option<u64> {
        let Some((last, _)) = self.last else { return Some(0) };
        (sample.index > last).then(|| (sample.index - last - 1).saturating_sub(sample.lost.into()))
    }

    /// The source is another one, or came back: the stage may stand elsewhere.
    pub fn source_changed(&mut self) {
        let parked = self.steering.on_lease == Expiry::Park;
        let Some(memory) = self.memory else { return };
        // Until a readback says better, where the lease has left it.
        self.memory = Some(Memory::at(if parked { self.steering.park } else { memory.position }));
        self.last = None;
    }

    /// Takes a sample, which must be newer than all before, at the moment `now`. `pose` is the last valid
    /// pose, if it is fresh; `output_bits` the resolution of the stage's outputs.
    pub fn sample(&mut self, sample: &Sample, pose: Option<&Pose>, now: Mono, output_bits: u8) -> Outcome {
        let dt = self.seconds_since_last(sample);
        let lease_s = f64::from(self.steering.lease_ms) * 1e-3;
        if self.last.is_some_and(|(_, time)| sample.time.seconds_since(time) >= lease_s) {
            self.source_changed(); // the board has acted by itself in the meantime
        }
        let first = self.last.is_none();
        self.last = Some((sample.index, sample.time));
        if !self.enabled {
            return Outcome::default();
        }
        if first {
            self.take_over(sample);
        }
        let late = now.seconds_since(sample.time) > self.fresh_s;
        self.late_s = if late { self.late_s + dt } else { 0.0 };
        let memory = self.memory.unwrap_or_default();
        let (next, sight) = match self.offset(sample, pose) {
            _ if self.late_s > self.patience_s => (memory, Sight::Nothing(TOO_LATE)),
            Ok(offset) => {
                let next = if late { memory } else { self.controller.update(&memory, offset, dt) };
                let railed = sample.output_railed || self.controller.railed(next.position);
                (next, Sight::Offset { size: offset[0].hypot(offset[1]), railed })
            }
            Err(cause) => (memory, Sight::Nothing(cause)),
        };
        self.memory = Some(next);
        let transition = self.lock.update(sight, dt);
        // Also while nothing new is known: it renews the lease, which is for a daemon that is dead.
        Outcome { command: Some(self.steering.command(next.position, output_bits)), late, transition }
    }

    /// `dt` seconds have passed without a sample. No command: the lease decides what the stage does.
    pub fn silence(&mut self, dt: f64) -> Option<Transition> {
        self.lock.update(Sight::Nothing("no samples come"), dt)
    }

    /// The last command: hold or park. `None` if the loop never moved the stage.
    pub fn finish(&mut self, output_bits: u8) -> Option<OutputCommand> {
        let position = match self.steering.on_exit {
            OnExit::Hold => self.memory?.position,
            OnExit::Park => self.memory.map(|_| self.steering.park)?,
        };
        Some(self.steering.command(position, output_bits))
    }

    /// Starts where the stage says that it stands.
    fn take_over(&mut self, sample: &Sample) {
        let known = self.memory.unwrap_or_default().position;
        let limit = self.controller.limit;
        let position = sample.steering.unwrap_or(known).map(|p| p.clamp(-limit, limit));
        self.memory = Some(Memory::at(position));
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
        let pose = match self.target {
            Target::Apex => pose.unwrap_or(&nominal),
            // Nominal wedges: there equal powers are zero offset.
            Target::Balance => &nominal,
        };
        let offset = self.optics.offset_of_powers(&sample.powers, pose);
        offset.map(Into::into).map_err(|_| "the powers give no offset")
    }
}

impl Steering {
    fn command(&mut self, position: Xy, output_bits: u8) -> OutputCommand {
        let full = f64::from(1_i32 << (output_bits - 1));
        let code = |p: f64| (p / self.full_scale * full).round().clamp(-full, full - 1.0) as i32;
        let codes = position.map(code);
        self.id = self.id.wrapping_add(1);
        OutputCommand { id: self.id, codes, lease_ms: self.lease_ms, on_expiry: self.on_lease }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Model, Vec2};

    const MS: i64 = 1_000_000;

    fn centering() -> Centering {
        Centering::new(&Config::default()).unwrap()
    }

    /// What is seen with the beam 20 um off.
    fn sample(index: u64) -> Sample {
        let optics = Optics::new(&Config::default().head.build().unwrap());
        let (_, powers) = optics.trace_each(Model::Gaussian, &Pose::default(), Vec2::new(20e-6, 0.0));
        Sample {
            index,
            time: Mono(index as i64 * MS),
            time_sigma_ns: None,
            lost: 0,
            spots: [0.0; 6],
            powers: powers.map(|p| p * 1e-3),
            psds: [PsdState::Good; 3],
            steering: Some([0.0; 2]),
            output_railed: false,
        }
    }

    #[test]
    fn what_was_late_is_not_acted_upon_again_and_again() {
        let mut centering = centering();
        let now = Mono(50 * MS);
        let outcomes: Vec<_> = (0..=50).map(|k| centering.sample(&sample(k), None, now, 16)).collect();
        // After a pause of 50 ms only what is younger than the loop delay of 2.5 ms counts.
        for (k, outcome) in (0..).zip(&outcomes) {
            assert_eq!(outcome.late, k < 48);
            assert_eq!(
                outcome.command.unwrap().codes[0] == 0,
                outcome.late,
                "late ones hold, and renew the lease"
            );
        }
        let [x, _] = centering.state().position.unwrap();
        assert!((-20e-6..-5e-6).contains(&x), "{x}");
    }

    #[test]
    fn a_source_that_is_always_late_is_said_to_be() {
        let mut centering = centering();
        let mut transitions = Vec::new();
        for k in 0..200 {
            let outcome = centering.sample(&sample(k), None, Mono((k as i64 + 10) * MS), 16);
            assert_eq!((outcome.late, outcome.command.unwrap().codes), (true, [0, 0]));
            transitions.extend(outcome.transition.map(|t| (t.to, t.cause)));
        }
        assert_eq!(transitions, [(LockState::Held, TOO_LATE), (LockState::Lost, TOO_LATE)]);
        centering.sample(&sample(200), None, Mono(200 * MS), 16);
        assert_eq!(centering.state().lock, LockState::Acquiring);
    }
}
