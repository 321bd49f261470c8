//! A healthy board: the daemon and the model in C agree, and the board keeps the stage safe without the daemon.

use super::board::{Board, Program};
use crate::testkit::Frame;

/// Errors of a frame in units of its stated standard uncertainties.
fn normalised(frame: &Frame, truth: &[f64; 6]) -> [f64; 6] {
    std::array::from_fn(|axis| (frame.pose[axis] - truth[axis]) / f64::from(frame.deviations[axis]))
}

#[test]
fn poses_of_a_moving_mirror_agree_with_the_model_in_c() {
    let program = Program::board();
    let mut board = Board::start(&program, "");
    let mut daemon = board.daemon("");
    let mut client = daemon.client();
    client.locked();
    let frames = client.samples(4000);
    let (mut mean, mut square, mut late) = ([0.0; 6], [0.0; 6], Vec::new());
    for frame in &frames {
        assert!(frame.valid(), "{frame:?}");
        let truth = board.truth(frame);
        let errors = normalised(frame, &truth.pose);
        assert!(errors.iter().all(|error| error.abs() < 7.0), "{errors:?} {frame:?} {truth:?}");
        for axis in 0..6 {
            mean[axis] += errors[axis] / frames.len() as f64;
            square[axis] += errors[axis].powi(2) / frames.len() as f64;
        }
        late.push(frame.time_ns - truth.time_ns);
    }
    late.sort_unstable();
    println!("mean {mean:.3?} mean square {square:.3?}, in standard uncertainties");
    println!(
        "time stamps: median {} ns, range {} to {} ns",
        late[late.len() / 2],
        late[0],
        late[late.len() - 1]
    );
    // Seven standard errors of the mean of white noise; the noise of both sides is that of the documents.
    let limit = 7.0 / (frames.len() as f64).sqrt();
    assert!(mean.iter().all(|mean| mean.abs() < limit), "systematic: {mean:?}");
    assert!(square.iter().all(|square| (0.85..1.15).contains(square)), "uncertainties as stated: {square:?}");
}

#[test]
fn boards_of_each_version_and_width_of_the_tick_lock() {
    let program = Program::board();
    for arguments in ["minor=0", "wide=1"] {
        let board = Board::start(&program, arguments);
        let mut daemon = board.daemon("");
        let mut client = daemon.client();
        client.locked();
        assert!(client.samples(500).iter().all(Frame::valid), "{arguments}");
        let counters = client.heartbeat().counters;
        for name in ["frames_unknown", "frames_corrupted", "board_errors", "board_restarts", "clock_faults"] {
            assert_eq!(counters[name], 0, "{arguments}: {name}");
        }
    }
}

#[test]
fn the_board_parks_the_stage_when_the_daemon_is_gone() {
    let program = Program::board();
    let mut board = Board::start(&program, "");
    let mut daemon = board.daemon("steering.on_lease = \"park\"\nsteering.park_um = [-50, 100]");
    let mut client = daemon.client();
    let locked = client.locked();
    let steered = std::iter::repeat_with(|| board.next());
    let steered = steered.skip(locked.sample_index as usize).find(|truth| !truth.expired).unwrap();
    assert_ne!(steered.outputs, [0, 0], "{steered:?}");
    daemon.kill();
    let parked = std::iter::repeat_with(|| board.next()).find(|truth| truth.expired).unwrap();
    // 500 um at code 32768.
    assert_eq!(parked.outputs, [-3277, 6554], "{parked:?}");
}
