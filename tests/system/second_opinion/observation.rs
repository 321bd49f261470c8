//! What a control sees of a situation: the errors of the usable poses, and what indicates the situation, and when.

use std::collections::BTreeMap;

use trifacet_wire::Status;

use super::board::{Board, Program};
use crate::testkit::Frame;

/// Bits that every frame of this head has: it is simulated and has no correction tables.
pub(crate) const USUAL: Status =
    Status(Status::POSE_VALID.0 | Status::SIMULATED.0 | Status::UNCALIBRATED.0 | Status::STEERING_MEASURED.0);

/// Usable poses in a block. The mean of a block shows an error below the noise of a single pose.
const BLOCK: usize = 100;

/// The observation of a board from the begin of its faults to the end.
#[derive(Debug)]
pub(crate) struct Observation {
    /// Largest error of the mean of a block of usable poses: position (um) and rotation (urad).
    pub(crate) error: [f64; 2],
    /// Largest error of a usable pose in units of the stated standard uncertainty.
    pub(crate) sigmas: f64,
    /// Largest error of the time of a usable pose, beyond five stated standard uncertainties and beyond the delays of
    /// the program of the board, milliseconds.
    pub(crate) time_ms: f64,
    /// Longest delay of the program of the board, milliseconds.
    pub(crate) stall_ms: f64,
    /// Number of usable poses.
    pub(crate) usable: usize,
    /// Number of frames with samples.
    pub(crate) frames: usize,
    /// For each bit, the number of scans after the begin of the faults at which it was set first.
    pub(crate) bits: BTreeMap<&'static str, u64>,
    /// The bits that were set in every frame.
    pub(crate) always: Status,
    /// The counters of the daemon that the situation has increased.
    pub(crate) counters: BTreeMap<String, u64>,
    /// The log of the daemon.
    pub(crate) log: Vec<String>,
}

/// Where the faults begin and where the observation ends, sequence numbers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Window {
    pub(crate) from: u64,
    pub(crate) to: u64,
}

/// Runs a daemon with a board with these arguments.
pub(crate) fn observe(program: &Program, arguments: &str, config: &str, window: Window) -> Observation {
    let mut board = Board::start(program, arguments);
    let mut daemon = board.daemon(config);
    let mut client = daemon.client();
    let mut frames = client.through("the end", |frame| frame.sample_index >= window.to);
    let counters = client.heartbeat();
    daemon.read_log();
    frames.retain(|frame| frame.sample_index >= window.from);
    let mut seen = Observation {
        error: [0.0; 2],
        sigmas: 0.0,
        time_ms: 0.0,
        stall_ms: 0.0,
        usable: 0,
        frames: frames.iter().filter(|frame| frame.of_samples()).count(),
        bits: BTreeMap::new(),
        always: Status(frames.iter().fold(u32::MAX, |all, frame| all & frame.status.0)),
        counters: counters.counters.into_iter().filter(|(_, n)| *n > 0).collect(),
        log: daemon.log.iter().map(ToString::to_string).collect(),
    };
    for frame in &frames {
        for name in Status(frame.status.0 & !USUAL.0).names() {
            seen.bits.entry(name).or_insert(frame.sample_index - window.from);
        }
    }
    let usable = frames.iter().filter(|frame| frame.status.usable(Status::SIMULATED));
    let errors: Vec<[f64; 6]> = usable.map(|frame| seen.compare(frame, &mut board)).collect();
    seen.stall_ms = board.latest_ns() as f64 * 1e-6;
    seen.time_ms -= seen.stall_ms;
    // An incomplete block counts only if it is the only one.
    for block in errors.chunks(BLOCK).filter(|block| block.len() == errors.len().min(BLOCK)) {
        for axis in 0..6 {
            let mean = block.iter().map(|errors| errors[axis]).sum::<f64>() / block.len() as f64;
            let part = &mut seen.error[axis / 3];
            *part = part.max(mean.abs() * 1e6);
        }
    }
    seen
}

impl Observation {
    /// The errors of a usable pose.
    fn compare(&mut self, frame: &Frame, board: &mut Board) -> [f64; 6] {
        let truth = board.truth(frame);
        self.usable += 1;
        let stated_ms = f64::from(frame.clock_quality) * 1e-4;
        let time_ms = (frame.time_ns - truth.time_ns) as f64 * 1e-6;
        self.time_ms = self.time_ms.max(time_ms.abs() - 5.0 * stated_ms);
        let errors: [f64; 6] = std::array::from_fn(|axis| frame.pose[axis] - truth.pose[axis]);
        for (error, deviation) in errors.iter().zip(frame.deviations) {
            self.sigmas = self.sigmas.max(error.abs() / f64::from(deviation));
        }
        errors
    }
}
