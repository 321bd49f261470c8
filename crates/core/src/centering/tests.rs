//! The loop with a stage that follows at once, and a mirror at rest.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use trifacet_optics::{Head, Model, Optics, Pose, Vec2};
use trifacet_wire::LockState;
use trifacet_wire::actuator::{Ack, LeaseAction};

use crate::centering::centering::Centering;
use crate::centering::lock::LockCause;
use crate::centering::{LoopMode, LoopParams, Outcome, TimedPose};
use crate::signals::{PsdState, Sample};
use crate::steering::{BeamMap, BeamOffset, BeamPoint, StagePosition};
use crate::time::Mono;

const DT_NS: i64 = 1_000_000;

struct Bench {
    params: LoopParams,
    centering: Centering,
    optics: Optics,
    /// Position of the beam while the stage is at zero, micrometres.
    laser_um: [f64; 2],
    stage_um: [f64; 2],
    readback: bool,
    index: u64,
    expiry: Option<LeaseAction>,
}

impl Bench {
    fn new(change: impl FnOnce(&mut LoopParams)) -> Self {
        let mut params = LoopParams::default();
        change(&mut params);
        let optics = Optics::new(&Head::default());
        Self {
            centering: Centering::new(params, optics.clone()),
            optics,
            params,
            laser_um: [100.0, -60.0],
            stage_um: [0.0; 2],
            readback: true,
            index: 0,
            expiry: None,
        }
    }

    fn sample(&mut self) -> Sample {
        self.index += 1;
        let offset = Vec2::from([0, 1].map(|i| (self.laser_um[i] + self.stage_um[i]) * 1e-6));
        let reading = self.optics.trace(Model::Gaussian, &Pose::default(), offset).unwrap();
        Sample {
            index: self.index,
            time: Mono(self.index as i64 * DT_NS),
            time_sigma_ns: None,
            lost: 0,
            spots: reading.spots,
            powers: reading.powers,
            psds: [PsdState::Good; 3],
            steering: self.readback.then(|| self.stage_um.map(|um| um * 1e-6)),
            output_railed: false,
            applied: None,
            uncovered: false,
        }
    }

    /// A sample of a stage at rest with the beam 20 um off.
    fn beside_the_point(&mut self) -> Sample {
        (self.laser_um, self.stage_um) = ([20.0, 0.0], [0.0; 2]);
        self.sample()
    }

    /// Moves the stage as commanded, and checks its speed and its limits.
    fn obey(&mut self, outcome: Outcome) -> bool {
        let Some(command) = outcome.command else { return false };
        let to = command.position.map(|metres| metres * 1e6);
        for (axis, to) in to.into_iter().enumerate() {
            let step = (to - self.stage_um[axis]).abs();
            assert!(step <= 50.0 + 1e-6, "a jump of {step} um");
            assert!(to.abs() <= 400.0 + 1e-6, "at {to} um");
        }
        self.stage_um = to;
        self.expiry = Some(command.on_expiry);
        self.centering.stage_answers(Ack { id: command.id, accepted: true });
        true
    }

    /// Runs for `samples` samples; returns the number of commands.
    fn run(&mut self, samples: usize) -> usize {
        let mut commands = 0;
        for _ in 0..samples {
            let sample = self.sample();
            let outcome = self.centering.sample(&sample, None, sample.time);
            commands += usize::from(self.obey(outcome));
        }
        commands
    }

    fn retune(&mut self, change: impl FnOnce(&mut LoopParams)) -> bool {
        change(&mut self.params);
        let outcome = self.centering.retune(self.params);
        let before = self.stage_um;
        let commanded = self.obey(outcome);
        assert_eq!(self.stage_um, before, "a change by itself moves nothing");
        commanded
    }

    fn lock(&self) -> LockState {
        self.centering.state().lock
    }

    /// Position of the beam relative to the apex.
    fn offset_um(&self) -> [f64; 2] {
        [0, 1].map(|i| self.laser_um[i] + self.stage_um[i])
    }
}

fn near(a: [f64; 2], b: [f64; 2]) -> bool {
    (0..2).all(|i| (a[i] - b[i]).abs() < 0.1)
}

#[test]
fn in_shadow_mode_commands_are_reported_and_not_sent() {
    let mut bench = Bench::new(|params| params.mode = LoopMode::Shadow);
    bench.stage_um = [20.0, 10.0];
    assert_eq!(bench.run(500), 0);
    assert_eq!(bench.lock(), LockState::Off);
    assert_eq!(bench.centering.state().position, None);
    let (at, to) = bench.centering.view().shadow.unwrap();
    assert!(near(at.map(|m| m * 1e6), [20.0, 10.0]), "{at:?}");
    // Towards the apex, by the integral of one period: 0.2 of the offset of 120 and -50 um (the offset of a
    // beam so far off is measured somewhat too small or too large).
    let step = [0, 1].map(|i| (to[i] - at[i]) * 1e6);
    assert!((-30.0..-18.0).contains(&step[0]) && (8.0..14.0).contains(&step[1]), "{step:?}");
    assert_eq!(bench.centering.finish(), None, "a stage that the loop never controlled is not parked");
    assert!(!bench.retune(|params| params.mode = LoopMode::On));
    assert_eq!(bench.run(500), 500);
    assert_eq!(bench.lock(), LockState::Locked);
}

#[test]
fn the_loop_releases_and_takes_over_the_stage_at_its_position() {
    for readback in [true, false] {
        let mut bench = Bench::new(|params| params.on_lease = LeaseAction::Park);
        bench.readback = readback;
        bench.run(500);
        assert!(near(bench.offset_um(), [0.0; 2]), "{:?}", bench.offset_um());
        // The lease must not park a stage that was released.
        assert!(bench.retune(|params| params.mode = LoopMode::Off));
        assert_eq!(bench.expiry, Some(LeaseAction::Hold));
        assert_eq!((bench.run(500), bench.lock()), (0, LockState::Off));
        assert_eq!(bench.centering.finish(), None);
        bench.laser_um = [130.0, -60.0];
        bench.retune(|params| params.mode = LoopMode::On);
        let before = bench.stage_um;
        bench.run(1);
        // The integral of one period, 0.2 of 30 um, without a jump to zero or elsewhere.
        assert!((bench.stage_um[0] - before[0] + 6.0).abs() < 1.0, "{before:?} {:?}", bench.stage_um);
        bench.run(500);
        assert!(near(bench.offset_um(), [0.0; 2]) && bench.lock() == LockState::Locked);
    }
}

#[test]
fn a_stage_moved_by_others_is_taken_over_at_its_position() {
    let mut bench = Bench::new(|_| {});
    bench.run(500);
    bench.retune(|params| params.mode = LoopMode::Off);
    bench.stage_um = [30.0, 200.0];
    bench.laser_um = [-30.0, -200.0];
    bench.run(10);
    bench.retune(|params| params.mode = LoopMode::On);
    bench.run(1);
    assert!(near(bench.stage_um, [30.0, 200.0]), "{:?}", bench.stage_um);
}

#[test]
fn the_loop_moves_to_another_setpoint_and_locks_there() {
    let mut bench = Bench::new(|_| {});
    bench.run(500);
    bench.retune(|params| params.setpoint = BeamOffset([20e-6, -5e-6]));
    let before = bench.stage_um;
    bench.run(1);
    assert!((bench.stage_um[0] - before[0] - 4.0).abs() < 0.5, "no kick: {:?}", bench.stage_um);
    assert_eq!(bench.lock(), LockState::Acquiring, "not yet at the new setpoint");
    bench.run(500);
    assert!(near(bench.offset_um(), [20.0, -5.0]), "{:?}", bench.offset_um());
    assert_eq!(bench.lock(), LockState::Locked);
}

#[test]
fn gains_change_without_a_step() {
    let mut bench = Bench::new(|params| params.controller.slew = 1.0);
    bench.laser_um = [30.0, 0.0];
    bench.run(3);
    let sample = bench.sample();
    let next =
        |centering: &mut Centering| centering.sample(&sample, None, sample.time).command.unwrap().position[0];
    let unchanged = next(&mut bench.centering.clone());
    // Ten times the proportional gain acts on the change of the error since the last sample, about 6 um, and
    // not on the remaining 18 um.
    bench.retune(|params| (params.controller.kp, params.controller.ki_per_s) = (1.0, 200.0));
    let changed = next(&mut bench.centering);
    let step_um = (changed - unchanged) * 1e6;
    assert!((3.0..8.0).contains(&step_um), "{step_um} um");
}

#[test]
fn narrower_limits_are_reached_in_steps_with_and_without_light() {
    let mut bench = Bench::new(|_| {});
    bench.laser_um = [-300.0, 0.0];
    bench.stage_um = [250.0, 0.0];
    bench.run(500);
    assert!((bench.stage_um[0] - 300.0).abs() < 0.1);
    bench.retune(|params| params.controller.limit = 100e-6);
    for sees in [300.0, 250.0, 200.0, 150.0, 100.0, 100.0] {
        assert!((bench.stage_um[0] - sees).abs() < 0.1, "{:?}", bench.stage_um);
        let mut sample = bench.sample();
        if sees > 200.0 {
            sample.psds = [PsdState::Low; 3];
        }
        let outcome = bench.centering.sample(&sample, None, sample.time);
        bench.obey(outcome);
    }
    assert!((bench.stage_um[0] - 100.0).abs() < 0.1, "{:?}", bench.stage_um);
}

#[test]
fn invalid_inputs_give_no_command() {
    let mut bench = Bench::new(|_| {});
    bench.run(500);
    let at = bench.stage_um;
    for nonsense in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -1.0] {
        let mut sample = bench.sample();
        sample.powers = [nonsense, 1e-4, 1e-4];
        sample.steering = Some([nonsense; 2]);
        let pose = TimedPose { pose: Pose::from_array([f64::NAN; 6]), time: sample.time };
        let outcome = bench.centering.sample(&sample, Some(&pose), sample.time);
        bench.obey(outcome);
        assert!(near(bench.stage_um, at), "{nonsense}: {:?}", bench.stage_um);
    }
    // Also while the loop takes over.
    bench.retune(|params| params.mode = LoopMode::Off);
    bench.retune(|params| params.mode = LoopMode::On);
    let mut sample = bench.sample();
    sample.steering = Some([f64::NAN, f64::INFINITY]);
    let outcome = bench.centering.sample(&sample, None, sample.time);
    bench.obey(outcome);
    assert!(near(bench.stage_um, at), "{:?}", bench.stage_um);
}

#[test]
fn late_samples_do_not_repeat_a_correction() {
    let mut bench = Bench::new(|_| {});
    let now = Mono(51 * DT_NS);
    let outcomes: Vec<_> = (0..=50)
        .map(|_| {
            let sample = bench.beside_the_point();
            bench.centering.sample(&sample, None, now)
        })
        .collect();
    // After a pause of 50 ms, only samples younger than the loop delay of 2.5 ms count.
    for (k, outcome) in outcomes.iter().enumerate() {
        assert_eq!(outcome.late, k < 48);
        let still = outcome.command.is_some_and(|command| command.position == StagePosition([0.0; 2]));
        assert_eq!(still, outcome.late, "commands of late samples hold the stage and renew the lease");
    }
    let [x, _] = bench.centering.state().position.unwrap().0;
    assert!((-20e-6..-5e-6).contains(&x), "{x}");
}

#[test]
fn a_source_that_is_always_late_is_reported() {
    let mut bench = Bench::new(|_| {});
    let mut transitions = Vec::new();
    for _ in 0..200 {
        let sample = bench.beside_the_point();
        let outcome = bench.centering.sample(&sample, None, sample.time + 10 * DT_NS);
        assert!(
            outcome.late
                && outcome.command.is_some_and(|command| command.position == StagePosition([0.0; 2]))
        );
        transitions.extend(outcome.transition.map(|t| (t.to, t.cause)));
        bench.obey(outcome);
    }
    assert_eq!(
        transitions,
        [(LockState::Held, LockCause::SamplesTooLate), (LockState::Lost, LockCause::SamplesTooLate)]
    );
    let sample = bench.beside_the_point();
    bench.centering.sample(&sample, None, sample.time);
    assert_eq!(bench.centering.state().lock, LockState::Acquiring);
}

/// Runs for `bursts` bursts of `length` samples that arrive together: the loop gets the last one of each.
fn run_in_bursts(bench: &mut Bench, bursts: usize, length: u64) -> Vec<(LockState, LockCause)> {
    let mut transitions = Vec::new();
    for _ in 0..bursts {
        bench.index += length - 1;
        let sample = bench.sample();
        let outcome = bench.centering.sample(&sample, None, sample.time);
        transitions.extend(outcome.transition.map(|t| (t.to, t.cause)));
        bench.obey(outcome);
    }
    transitions
}

#[test]
fn samples_in_bursts_are_too_late_although_the_last_of_a_burst_is_fresh() {
    let mut bench = Bench::new(|_| {});
    bench.run(500);
    assert_eq!(run_in_bursts(&mut bench, 100, 5), [], "a few periods");
    let held = run_in_bursts(&mut bench, 100, 100);
    assert_eq!(held[0], (LockState::Held, LockCause::SamplesTooLate), "{held:?}");
    assert!(held.iter().all(|(_, cause)| *cause == LockCause::SamplesTooLate), "{held:?}");
    bench.run(200);
    assert_eq!(bench.lock(), LockState::Locked);
}

#[test]
fn a_refusing_stage_is_held_at_its_last_accepted_position() {
    let mut bench = Bench::new(|_| {});
    bench.run(500);
    let obeyed = bench.stage_um;
    bench.laser_um[0] += 100.0;
    for _ in 0..500 {
        let sample = bench.sample();
        let command = bench.centering.sample(&sample, None, sample.time).command.unwrap();
        let accepted = (command.position[0] * 1e6 - obeyed[0]).abs() < 1e-3;
        bench.centering.stage_answers(Ack { id: command.id, accepted });
        assert!((command.position[0] * 1e6 - obeyed[0]).abs() < 60.0, "it does not run away");
        assert_ne!(bench.lock(), LockState::Locked);
    }
    assert!(matches!(bench.lock(), LockState::Held | LockState::Lost | LockState::Acquiring));
}

#[test]
fn a_stage_that_does_not_answer_is_held_until_it_answers_again() {
    let mut bench = Bench::new(|_| {});
    bench.run(500);
    assert_eq!(bench.lock(), LockState::Locked);
    let mut transitions = Vec::new();
    for k in 0..200 {
        let sample = bench.sample();
        let outcome = bench.centering.sample(&sample, None, sample.time);
        assert!(outcome.command.is_some(), "commands renew the lease");
        transitions.extend(outcome.transition.map(|t| (k, t.to, t.cause)));
    }
    let cause = LockCause::CommandsUnanswered;
    let [(held, LockState::Held, first), (_, LockState::Lost, second)] = transitions[..] else {
        panic!("{transitions:?}")
    };
    assert_eq!([first, second], [cause; 2]);
    assert!((60..70).contains(&held), "12 ms of age for 50 ms: {held}");
    assert!(bench.centering.backlog().overdue && bench.centering.backlog().count == 200);
    bench.run(200);
    assert_eq!((bench.lock(), bench.centering.backlog().overdue), (LockState::Locked, false));
}

#[test]
fn a_search_continues_within_narrower_limits() {
    let mut bench = Bench::new(|params| params.controller.slew = 0.005);
    bench.run(300);
    let dark = |bench: &mut Bench| {
        let mut sample = bench.sample();
        (sample.psds, sample.powers) = ([PsdState::Low; 3], [0.0; 3]);
        let outcome = bench.centering.sample(&sample, None, sample.time);
        bench.obey(outcome);
    };
    (0..300).for_each(|_| dark(&mut bench));
    assert_eq!(bench.lock(), LockState::Searching);
    bench.retune(|params| params.controller.limit = 50e-6);
    (0..3000).for_each(|_| dark(&mut bench));
    assert_eq!(bench.lock(), LockState::Held, "the failed search ends");
    assert!(bench.stage_um.iter().all(|um| um.abs() <= 50.001), "{:?}", bench.stage_um);
}

#[test]
fn a_stage_that_sticks_for_a_time_causes_no_loss() {
    let mut bench = Bench::new(|_| {});
    bench.laser_um = [0.0, 0.0];
    bench.run(500);
    let stuck = bench.stage_um;
    bench.laser_um = [60.0, 0.0];
    let mut held = false;
    for _ in 0..2000 {
        let sample = bench.sample();
        let _ = bench.centering.sample(&sample, None, sample.time);
        bench.stage_um = stuck;
        held |= bench.lock() == LockState::Held;
        let [x, _] = bench.centering.state().position.unwrap().0;
        // Until the fault is noticed, within two delays and the lag, the integral has moved this far, and no
        // farther.
        assert!((x * 1e6 - stuck[0]).abs() < 200.0, "it does not wind up: {x}");
    }
    assert!(held && bench.lock() == LockState::Lost, "{:?}", bench.lock());
    // Then the stage comes free: it moves to its last command, and then to the apex.
    bench.stage_um[0] = bench.centering.state().position.unwrap()[0] * 1e6;
    bench.run(500);
    assert!(near(bench.offset_um(), [0.0; 2]) && bench.lock() == LockState::Locked);
}

/// For any input, commands stay finite, within the limits (or on the way back to reduced limits) and no
/// faster than allowed: with nonsense in samples, poses and times, and parameters that change at any time.
#[test]
fn no_command_ever_leaves_the_limits() {
    let mut random = Pcg64::seed_from_u64(11);
    for _ in 0..200 {
        let mut bench = Bench::new(|params| params.controller.slew = 0.02);
        let mut last: Option<StagePosition> = None;
        for _ in 0..500 {
            if random.random_bool(0.02) {
                change(&mut bench.params, &mut random);
                let outcome = bench.centering.retune(bench.params);
                assert!(outcome.command.is_none_or(|c| Some(c.position) == last), "a change moves nothing");
            }
            let mut sample = bench.sample();
            spoil(&mut sample, &mut random);
            let pose = random.random_bool(0.5).then(|| TimedPose {
                pose: Pose::from_array([0; 6].map(|_| odd(&mut random, 1e-3))),
                time: sample.time,
            });
            let now = sample.time + random.random_range(-10..10) * DT_NS;
            let Some(command) = bench.centering.sample(&sample, pose.as_ref(), now).command else { continue };
            let limit = bench.params.controller.limit;
            for axis in 0..2 {
                let at = command.position[axis];
                let before = last.map_or(limit, |last| last[axis].abs());
                assert!(at.abs() <= limit.max(before) * (1.0 + 1e-12), "{at} beyond {limit}");
                let step = last.map_or(0.0, |last| (at - last[axis]).abs());
                // Five periods at the slew limit, plus the error of a readback at take-over.
                assert!(step <= 5.0 * 20e-6 + 1e-6, "a step of {step}");
            }
            last = Some(command.position);
            bench.stage_um = command.position.map(|p| p * 1e6);
        }
    }
}

/// An ordinary value, a very large one, or not a number.
fn odd(random: &mut Pcg64, size: f64) -> f64 {
    let ordinary = size * (random.random::<f64>() - 0.5);
    let nonsense = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, 5e-324];
    if random.random_bool(0.9) { ordinary } else { nonsense[random.random_range(0..nonsense.len())] }
}

fn spoil(sample: &mut Sample, random: &mut Pcg64) {
    if random.random_bool(0.2) {
        let state = [PsdState::Good, PsdState::Low, PsdState::Clipped];
        sample.psds = [0; 3].map(|_| state[random.random_range(0..3)]);
        sample.spots = [0; 6].map(|_| odd(random, 10e-3));
    }
    if random.random_bool(0.2) {
        sample.powers = [0; 3].map(|_| odd(random, 1e-3));
    }
    if random.random_bool(0.2) {
        let stands = sample.steering;
        let read = |at: StagePosition, random: &mut Pcg64| at.map(|p| p + odd(random, 1e-6));
        sample.steering =
            stands.filter(|_| random.random_bool(0.8)).map(|at| read(StagePosition(at), random));
    }
    if random.random_bool(0.05) {
        sample.time = Mono(random.random_range(0..i64::MAX / 2));
    }
}

fn change(params: &mut LoopParams, random: &mut Pcg64) {
    params.controller.limit = random.random_range(50e-6..400e-6);
    let matrix = [[random.random_range(0.5..2.0), 0.1], [-0.1, random.random_range(-2.0..-0.5)]];
    params.map = BeamMap::new(matrix, BeamPoint([0.0; 2]));
    params.setpoint = BeamOffset([random.random_range(-100e-6..100e-6), 0.0]);
    params.controller.ki_per_s = random.random_range(0.0..1e5);
    params.controller.kp = random.random_range(0.0..10.0);
    params.mode = LoopMode::ALL[random.random_range(0..4)];
}
