//! The loop brings the beam to the apex and keeps it there, and the lock state is true.

use trifacet_wire::{LockState, Status};

use crate::testkit::{Board, Daemon, Frame, Stream, mean, waited_ns};

/// A beam offset of 99 um and a mirror at rest.
const OFF: &str = "twin.laser_offset_um = [70.0, -70.0]\ntwin.motion = []";

fn offset_um(frames: &[Frame]) -> f64 {
    let [x, y] = [0, 1].map(|i| mean(frames, |f| f64::from(f.beam_offset[i])));
    x.hypot(y) * 1e6
}

/// For the next `tenths` intervals of 100 ms: the loop is locked and the offset below 1 um in each interval,
/// by the estimate and by the readback of the stage, which must compensate the offset of the laser.
///
/// While the machine suspends the board or the daemon, the loop is open, and the frames report it. Such
/// pauses are excluded, with the time in which the loop closes again.
fn stays_on_the_apex(stream: &mut Stream, tenths: usize) {
    let mut smooth = Smooth::default();
    (0..tenths).for_each(|_| smooth.stays_on_the_apex(stream));
}

/// Excludes the frames that a pause of the machine has disturbed.
#[derive(Default)]
struct Smooth {
    disturbed_until_ns: i64,
}

impl Smooth {
    fn frames(&mut self, stream: &mut Stream, n: usize) -> Vec<Frame> {
        let mut frames = Vec::new();
        while frames.len() < n {
            let frame = stream.next().unwrap();
            if !frame.of_samples() || frame.send_delay_ns > 5_000_000 {
                self.disturbed_until_ns = frame.sent_ns() + 200_000_000;
            } else if frame.time_ns > self.disturbed_until_ns {
                frames.push(frame);
            }
        }
        frames
    }

    /// Checks the next 100 ms.
    fn stays_on_the_apex(&mut self, stream: &mut Stream) {
        let frames = self.frames(stream, 100);
        let unlocked = frames.iter().filter(|f| !f.locked()).count();
        assert_eq!(unlocked, 0, "frames without a lock");
        assert!(offset_um(&frames) < 1.0, "{} um", offset_um(&frames));
        let stage = [0, 1].map(|i| mean(&frames, |f| f64::from(f.steering[i])) * 1e6);
        assert!((stage[0] + 70.0).hypot(stage[1] - 70.0) < 1.0, "{stage:?}");
    }
}

/// The sequence of lock states while samples arrived.
fn states(frames: &[Frame]) -> Vec<LockState> {
    let blind = [LockState::Held, LockState::Lost];
    let mut states: Vec<_> = frames.iter().map(|f| f.lock).filter(|lock| !blind.contains(lock)).collect();
    states.dedup();
    states
}

#[test]
fn on_the_twin_the_loop_closes_from_an_offset_of_100_um_and_stays_closed() {
    // The first frame of the daemon is visible only by UDP.
    let mut stream = Stream::udp();
    let udp = stream.local();
    let _daemon = Daemon::start(&format!("publishing.udp = [\"{udp}\"]\n{OFF}"));
    let closing = stream.through("locked", Frame::locked);
    let first = closing.iter().find(|f| f.valid()).unwrap();
    let [x, y] = first.beam_offset.map(|x| f64::from(x) * 1e6);
    assert!((x - 70.0).hypot(y + 70.0) < 5.0, "the first estimate is the offset of the laser: {x} {y}");
    assert_eq!(states(&closing), [LockState::Acquiring, LockState::Locked]);
    stream.samples(100);
    stays_on_the_apex(&mut stream, 20);
}

/// The line buffers scans for at least this time while the daemon does not read, nanoseconds.
const LINE_NS: i64 = 40_000_000;

/// Runs for `tenths` intervals of 100 ms on the apex without a lost sample. Samples may be lost only where
/// the board or the daemon has waited for a CPU for longer than the line can buffer.
fn loses_nothing(stream: &mut Stream, pids: [u32; 2], tenths: usize) {
    let waits = || pids.map(waited_ns).iter().sum::<i64>();
    let (mut smooth, mut before_ns) = (Smooth::default(), 0);
    for _ in 0..tenths {
        let (lost, begin_ns) = (stream.lost, waits());
        smooth.stays_on_the_apex(stream);
        let (lost, waited_ns) = (stream.lost - lost, waits() - begin_ns);
        assert!(
            lost == 0 || waited_ns.max(before_ns) > LINE_NS,
            "{lost} lost after {waited_ns} ns without a CPU"
        );
        before_ns = waited_ns;
    }
}

#[test]
fn through_a_board_the_loop_closes_and_loses_no_sample_in_10_s() {
    let mut board = Board::start(OFF);
    let mut daemon = Daemon::on_port(&board.link(), "");
    let mut stream = daemon.client();
    stream.locked();
    stream.samples(100);
    let (before, first) = (stream.heartbeat().counters, stream.next().unwrap());
    loses_nothing(&mut stream, [daemon.pid(), board.pid()], 100);
    let last = stream.next().unwrap();
    let after = stream.heartbeat().counters;
    assert!(last.sample_index >= first.sample_index + 10_000);
    let seconds = (last.time_ns - first.time_ns) as f64 * 1e-9;
    let samples = (last.sample_index - first.sample_index) as f64;
    assert!((seconds - samples * 1e-3).abs() < 5e-3, "{samples} samples in {seconds} s");
    // On this line no message is damaged, repeated or out of order.
    let harm = ["scans_repeated", "scans_late", "frames_corrupted", "frames_unknown", "board_errors"];
    for counter in harm.iter().chain(&["commands_refused", "estimation_overflows"]) {
        assert_eq!(after[*counter], 0, "{counter}");
    }
    let status = board.status();
    let output = [0, 1].map(|i| status["output_um"][i].as_f64().unwrap());
    assert!((output[0] + 70.0).hypot(output[1] - 70.0) < 3.0, "{status}");
    assert_eq!(status["commands_refused"], 0);
    let lost = stream.lost.max(after["scans_lost"]);
    assert!(after["scans"] + lost >= before["scans"] + 10_000);
}

#[test]
fn a_step_of_the_mirror_is_followed_and_not_reported_as_locked_meanwhile() {
    let mut daemon =
        Daemon::start("twin.motion = [{ axis = \"tx\", kind = \"step\", amount_um = 60.0, from_s = 1.0 }]");
    let mut stream = daemon.client();
    stream.locked();
    let moving = stream.through("unlocked", |f| !f.locked());
    assert!((990..1010).contains(&moving.last().unwrap().sample_index), "{:?}", moving.last());
    let again = stream.through("locked", Frame::locked);
    assert_eq!(states(&again), [LockState::Acquiring, LockState::Locked]);
    stream.samples(100);
    let frames = Smooth::default().frames(&mut stream, 100);
    assert!(offset_um(&frames) < 1.0 && frames.iter().all(Frame::locked));
    let [pose, stage] = [mean(&frames, |f| f.pose[0]), mean(&frames, |f| f64::from(f.steering[0]))];
    assert!((pose - 60e-6).abs() < 1e-6 && (stage - 60e-6).abs() < 1e-6, "{pose} {stage}");
}

#[test]
fn with_the_loop_off_the_state_is_off_and_the_stage_does_not_move() {
    let mut board = Board::start(OFF);
    let mut daemon = Daemon::on_port(&board.link(), "centering.mode = \"off\"");
    let mut stream = daemon.client();
    let frames = stream.samples(300);
    assert!(frames.iter().all(|f| f.lock == LockState::Off && f.valid()));
    assert!((offset_um(&frames) - 99.0).abs() < 1.0, "{}", offset_um(&frames));
    daemon.ends_in_order(rustix::process::Signal::TERM);
    let status = board.status();
    assert_eq!((&status["steering"], &status["commands_taken"]), (&"idle".into(), &0.into()));
}

const BEYOND: &str = "twin.laser_offset_um = [0.0, -100.0]\ntwin.motion = ";

#[test]
fn an_apex_beyond_the_limits_is_railed_and_never_locked() {
    let mut board = Board::start(&format!("{BEYOND}[]")).steered_within(50.0);
    let mut daemon = Daemon::on_port(&board.link(), "steering.limit_um = 50");
    let mut stream = daemon.client().steered_within(50.0);
    stream.until("railed", |f| f.lock == LockState::Railed);
    stream.samples(100);
    let frames = Smooth::default().frames(&mut stream, 500);
    let other = frames.iter().find(|f| f.lock != LockState::Railed || !f.has(Status::STEERING_RAILED));
    assert!(other.is_none(), "{other:?}");
    assert!((offset_um(&frames) - 50.0).abs() < 1.0, "{}", offset_um(&frames));
    let status = board.status();
    assert_eq!(status["output_um"][1].as_f64().unwrap().round(), 50.0, "{status}");
}

#[test]
fn the_loop_leaves_the_rail_when_the_apex_comes_within_reach() {
    let board = Board::start(&format!(
        "{BEYOND}[{{ axis = \"ty\", kind = \"step\", amount_um = -70.0, from_s = 1.5 }}]"
    ));
    let mut daemon = Daemon::on_port(&board.link(), "steering.limit_um = 50");
    let mut stream = daemon.client().steered_within(50.0);
    stream.until("railed", |f| f.lock == LockState::Railed);
    let coming = stream.through("locked", Frame::locked);
    assert_eq!(states(&coming), [LockState::Railed, LockState::Acquiring, LockState::Locked]);
    stream.samples(100);
    let frames = Smooth::default().frames(&mut stream, 100);
    assert!(offset_um(&frames) < 1.0 && frames.iter().all(Frame::locked));
}

#[test]
fn a_stage_at_its_own_limit_is_railed_too() {
    let mut daemon =
        Daemon::start("twin.laser_offset_um = [100.0, 0.0]\ntwin.motion = []\ntwin.steering.limit_um = 60");
    let mut stream = daemon.client();
    stream.until("railed", |f| f.lock == LockState::Railed);
    let frames = Smooth::default().frames(&mut stream, 1000);
    let other = frames.iter().find(|f| f.lock != LockState::Railed || !f.has(Status::STEERING_RAILED));
    assert!(other.is_none(), "{other:?}");
    assert!((mean(&frames, |f| f64::from(f.steering[0])) + 60e-6).abs() < 0.1e-6);
}

const BLOCKED: &str = "twin.fault = [{ at_s = 1.0, for_s = 0.3, kind = \"beam-blocked\" }]";

#[test]
fn for_a_blocked_beam_the_loop_is_held_then_lost_then_acquires_again() {
    let mut daemon = Daemon::start(&format!("centering.search = false\n{BLOCKED}\n{OFF}"));
    let mut stream = daemon.client();
    stream.locked();
    stream.until("dark", |f| f.has(Status::PSD_A_LOW));
    let dark = stream.through("light", Frame::valid);
    let (light, dark) = dark.split_last().unwrap();
    assert!((1300..1303).contains(&light.sample_index), "{light:?}");
    // Lost after lost_time_ms, which is 50; the loop may be some samples ahead of the frames or behind them.
    let held = dark.iter().filter(|f| f.lock == LockState::Held).count();
    assert!((10..=90).contains(&held), "held for {held} ms");
    assert_eq!(dark.last().unwrap().lock, LockState::Lost);
    let stage = |f: &Frame| f64::from(f.steering[0]);
    assert!(dark.iter().all(|f| (stage(f) + 70e-6).abs() < 5e-6), "the stage keeps its position");
    let again = stream.through("locked", Frame::locked);
    assert!(states(&again).ends_with(&[LockState::Acquiring, LockState::Locked]), "{:?}", states(&again));
    stream.samples(100);
    stays_on_the_apex(&mut stream, 2);
}

#[test]
fn a_confirmed_loss_starts_a_search_that_finds_the_beam() {
    let mut daemon = Daemon::start(&format!("{BLOCKED}\n{OFF}"));
    let mut stream = daemon.client();
    stream.locked();
    stream.until("dark", |f| f.has(Status::PSD_A_LOW));
    let found = stream.through("locked", Frame::locked);
    let mut states: Vec<_> = found.iter().map(|f| f.lock).collect();
    states.dedup();
    let course = [LockState::Held, LockState::Lost, LockState::Searching];
    assert_eq!(states[..3], course);
    assert!(states.ends_with(&[LockState::Acquiring, LockState::Locked]), "{states:?}");
    let searching = |f: &&Frame| f.lock == LockState::Searching;
    let away = |f: &Frame| f64::from(f.steering[0]) + 70e-6;
    let farthest = found.iter().filter(searching).map(|f| away(f).abs()).fold(0.0, f64::max);
    assert!(farthest > 100e-6, "the search reaches {farthest} m");
    stream.samples(100);
    stays_on_the_apex(&mut stream, 2);
}

#[test]
fn balance_makes_the_powers_equal_which_is_not_the_apex_of_a_tilted_mirror() {
    let tilted = "twin.motion = [{ axis = \"pitch\", kind = \"step\", amount_urad = 8000.0 }]";
    let run = |target: &str| {
        let mut daemon = Daemon::start(&format!("centering.target = \"{target}\"\n{tilted}"));
        let mut stream = daemon.client();
        stream.locked();
        stream.samples(200);
        let frames = stream.samples(1000);
        let powers = [0, 1, 2].map(|i| mean(&frames, |f| f64::from(f.powers[i])));
        let third = powers.iter().sum::<f64>() / 3.0;
        let unequal = powers.iter().map(|p| (p / third - 1.0).abs()).fold(0.0, f64::max);
        (unequal, offset_um(&frames))
    };
    let (apex_unequal, apex_off_um) = run("apex");
    let (balance_unequal, balance_off_um) = run("balance");
    assert!(balance_unequal < 3e-4 && apex_unequal > 2e-3, "{balance_unequal} {apex_unequal}");
    assert!(apex_off_um < 0.1 && balance_off_um > 0.25, "{apex_off_um} {balance_off_um}");
}
