//! Checks the contents of the frames.

use jiff::Timestamp;
use trifacet::client::{Descriptor, Heartbeat, Losses, Message, PoseFrame};
use trifacet::publishing::columns::rfc3339;
use trifacet_wire::stream::CalibrationEntry;
use trifacet_wire::{LockState, Status};

use super::Report;

/// Largest difference of the two clocks at which the age of a pose can be checked, seconds.
const CLOCKS_S: f64 = 0.1;

/// The messages received.
#[derive(Default)]
pub(super) struct ReceivedFrames {
    pub(super) descriptor: Option<Box<Descriptor>>,
    pub(super) heartbeat: Option<Heartbeat>,
    last: Option<PoseFrame>,
    frames: u64,
    valid: u64,
    /// Frames with `NOT_LOCKED`.
    unlocked: u64,
    /// Status bits of frames without a valid pose; `valid_bits`: of frames with one.
    invalid_bits: Status,
    valid_bits: Status,
    /// Shortest apparent transit time of a frame, from the difference of the two clocks.
    way_ns: Option<i64>,
}

impl ReceivedFrames {
    pub(super) fn frames(&self) -> u64 {
        self.frames
    }

    /// Registers a message that arrived at `now_ns` on the clock of this machine.
    pub(super) fn message(&mut self, message: Message, now_ns: i64) {
        match message {
            Message::Pose(frame) => self.frame(&frame, now_ns),
            Message::Descriptor(descriptor) => self.descriptor = Some(descriptor),
            Message::Heartbeat(heartbeat) => self.heartbeat = Some(heartbeat),
            Message::Event(_) | Message::Answer(_) | Message::Refusal(_) => {}
        }
    }

    fn frame(&mut self, frame: &PoseFrame, now_ns: i64) {
        self.frames += 1;
        self.unlocked += u64::from(frame.status.has(Status::NOT_LOCKED));
        if frame.status.has(Status::POSE_VALID) {
            self.valid += 1;
            self.valid_bits |= frame.status;
        } else {
            self.invalid_bits |= frame.status;
        }
        let way = now_ns.saturating_sub(frame.time_ns).saturating_sub(frame.send_delay_ns.into());
        self.way_ns = Some(self.way_ns.map_or(way, |least| least.min(way)));
        self.last = Some(*frame);
    }

    /// Evaluates the messages and reports the results.
    pub(super) fn tell(&self, losses: Losses, report: &mut Report) {
        let Some(last) = &self.last else { return };
        if let Some(descriptor) = &self.descriptor {
            report.good(&format!(
                "daemon {}, stream version {}, {} frames per second",
                descriptor.daemon_version, descriptor.stream_version, descriptor.rate_hz
            ));
            calibration(descriptor, report);
        }
        report.good(&format!(
            "{} frames arrived (session {:08x}, config {:08x})",
            self.frames, last.session, last.config
        ));
        self.losses(losses, report);
        if self.replayed() {
            self.replay(last, report);
            return self.poses(last.lock, report); // the times of a replay are in the past
        }
        self.poses(last.lock, report);
        self.clock(report);
    }

    fn replayed(&self) -> bool {
        (self.valid_bits | self.invalid_bits).has(Status::REPLAYED)
    }

    fn replay(&self, last: &PoseFrame, report: &mut Report) {
        let replayed = self.descriptor.as_ref().and_then(|descriptor| descriptor.replay.as_ref());
        let what = match replayed {
            Some(replay) => format!("REPLAYED: a replay of {}, recorded {}", replay.file, replay.recorded),
            None => format!("REPLAYED: the newest frame is from {}", rfc3339(last.time_ns)),
        };
        report.note(&what, "the poses are from the past: do not control a machine with them");
    }

    /// Why a replay sends no samples, and what to do.
    fn nothing_due(&self) -> (&'static str, &'static str) {
        let ends = self.heartbeat.as_ref().and_then(|heartbeat| heartbeat.counters.get("replay_ends"));
        let replayed = self.descriptor.as_ref().and_then(|descriptor| descriptor.replay.as_ref());
        match (replayed, ends) {
            (Some(replay), Some(1..)) if !replay.repeat => (
                "the recording has ended",
                "restart the daemon to replay it again, or set replay.repeat = true",
            ),
            (Some(_), Some(_)) => (
                "the recording has a gap here",
                "wait: the replay continues after the gap; trifacet info FILE shows its length",
            ),
            _ => ("the recording gives no samples", "it has ended, or it has a gap here"),
        }
    }

    fn losses(&self, losses: Losses, report: &mut Report) {
        let dropped = self.heartbeat.as_ref().map_or(0, |heartbeat| heartbeat.dropped);
        let Losses { missed_frames, late_frames, skipped_bytes } = losses;
        if missed_frames + late_frames + skipped_bytes + dropped > 0 {
            report.note(
                &format!("{missed_frames} frames are missing, {late_frames} late, {skipped_bytes} bytes unreadable, {dropped} frames dropped by the daemon"),
                "if this machine or the network is too slow, use a larger receive buffer (net.core.rmem_max) or a divider",
            );
        }
    }

    fn poses(&self, lock: LockState, report: &mut Report) {
        if self.valid * 2 > self.frames {
            report.good(&format!("poses are valid ({} of {})", self.valid, self.frames));
            if self.valid < self.frames {
                let names: Vec<_> = fatal(self.invalid_bits).map(|(bit, _)| name(bit)).collect();
                report.note(&format!("the others were not: {}", names.join(" ")), "");
            }
            self.warnings(lock, report);
            return;
        }
        report.wrong(&format!("poses are not valid ({} of {} are)", self.valid, self.frames), "");
        let low = Status::PSD_A_LOW | Status::PSD_B_LOW | Status::PSD_C_LOW;
        let mut bits = self.invalid_bits;
        if bits.has(low) {
            report.wrong(
                "no light on any PSD",
                "check that the laser is on, the beam is not blocked, and the amplifier is powered",
            );
            bits = Status(bits.0 & !low.0);
        }
        if bits.has(Status::SOURCE_DOWN) && self.replayed() {
            let (what, advice) = self.nothing_due();
            report.wrong(what, advice);
            bits = Status(bits.0 & !Status::SOURCE_DOWN.0);
        }
        for (bit, advice) in fatal(bits) {
            report.wrong(name(bit), advice);
        }
        self.lock(lock, report);
    }

    fn warnings(&self, lock: LockState, report: &mut Report) {
        for (bit, advice) in WARNINGS.into_iter().filter(|(bit, _)| self.valid_bits.has(*bit)) {
            report.note(name(bit), advice);
        }
        self.lock(lock, report);
    }

    fn lock(&self, lock: LockState, report: &mut Report) {
        let bits = self.valid_bits | self.invalid_bits;
        if self.replayed() && bits.has(Status::SOURCE_DOWN) {
            return; // the stage is not held
        }
        if bits.has(Status::NOT_LOCKED) {
            let advice = match lock {
                _ if self.replayed() => "a replay does not steer: this is the recorded state",
                LockState::Off => {
                    "the centering loop is off: set [centering] mode, or use `trifacet ctl loop on`"
                }
                LockState::Manual => "the operator moves the laser",
                LockState::Searching | LockState::Lost => "there is no light to centre: see above",
                LockState::Acquiring => {
                    "the beam is not on the apex yet; if this persists, align the laser and check the gains"
                }
                LockState::Railed => {
                    "the stage is at its limit: align the laser by hand until the stage leaves it"
                }
                LockState::Held => "the stage is held: light or samples are missing at the moment",
                LockState::Locked => "the loop lost its lock for a short time, and has it again",
            };
            let what = match lock {
                LockState::Locked => {
                    format!("was not locked for {} of {} frames", self.unlocked, self.frames)
                }
                _ => format!("the lock state is {}", lock.name()),
            };
            report.note(&format!("NOT_LOCKED: {what}"), advice);
        }
    }

    fn clock(&self, report: &mut Report) {
        let Some(way_s) = self.way_ns.map(|ns| ns as f64 * 1e-9) else { return };
        if way_s.abs() > CLOCKS_S {
            let which = if way_s > 0.0 { "behind" } else { "ahead of" };
            report.note(
                &format!("clock error: the clock of the daemon is {:.3} s {which} that of this machine", way_s.abs()),
                "synchronise both with NTP or PTP and restart the daemon, or do not compare time_ns with the clock of this machine",
            );
        }
    }
}

fn name(bit: Status) -> &'static str {
    bit.names().next().unwrap_or_default()
}

fn fatal(bits: Status) -> impl Iterator<Item = (Status, &'static str)> {
    FATAL.into_iter().filter(move |(bit, _)| bits.has(*bit))
}

/// Reports the calibration as the descriptor states it.
fn calibration(descriptor: &Descriptor, report: &mut Report) {
    if let Some(CalibrationEntry { date, method, range: [m, rad], uncertainty, expires }) =
        &descriptor.calibration
    {
        let days = date.parse::<Timestamp>().map_or_else(
            |_| String::new(),
            |date| format!(", {} days ago", Timestamp::now().duration_since(date).as_hours() / 24),
        );
        let end = expires.as_ref().map_or_else(String::new, |end| format!("; valid until {end}"));
        let [x, y, z, roll, pitch, yaw] = uncertainty.map(|si| si * 1e6);
        report.good(&format!(
            "calibration of {date}{days}: {method}; over +-{} mm and +-{} mrad: tx {x:.3} ty {y:.3} tz {z:.3} um, \
             roll {roll:.3} pitch {pitch:.3} yaw {yaw:.3} urad{end}",
            m * 1e3,
            rad * 1e3
        ));
    }
    if let Some(why) = &descriptor.uncalibrated {
        report.note(&format!("not calibrated: {why}"), "calibrate the head, and set calibration.record");
    }
}

const LOW: &str = "too little light there: check the beam, the cable, and that the mirror is near the middle";
const CLIPPED: &str = "the converter is at its limit there: too much light or too much gain";
const EDGE: &str = "the spot is near the edge there: move the mirror towards the middle";

/// The status bits that make a pose invalid.
const FATAL: [(Status, &str); 12] = [
    (
        Status::SOURCE_DOWN,
        "no samples: check that the board is plugged in and powered, and see the daemon's log",
    ),
    (Status::PSD_A_LOW, LOW),
    (Status::PSD_B_LOW, LOW),
    (Status::PSD_C_LOW, LOW),
    (Status::PSD_A_CLIPPED, CLIPPED),
    (Status::PSD_B_CLIPPED, CLIPPED),
    (Status::PSD_C_CLIPPED, CLIPPED),
    (
        Status::NOT_CONVERGED,
        "no pose explains the signals: check for reflections, and the geometry in [head]",
    ),
    (
        Status::POWER_STEP,
        "steps of the laser power: check that the power is stable and nothing cuts into the beam",
    ),
    (
        Status::CHANNEL_FROZEN,
        "a channel repeats the same code: check converter and board; the daemon's log names the channel",
    ),
    (
        Status::POWER_NOISY,
        "the power of a PSD changes too fast: check for vibration, ambient light and noise of the electronics",
    ),
    (Status::OUT_OF_RANGE, "a spot is off its PSD, or the pose is out of range: move the mirror back"),
];

const WARNINGS: [(Status, &str); 11] = [
    (Status::PSD_A_EDGE, EDGE),
    (Status::PSD_B_EDGE, EDGE),
    (Status::PSD_C_EDGE, EDGE),
    (
        Status::UNBALANCED,
        "the powers differ: the beam is off the apex, or dark offsets and gains are wrong (trifacet dark)",
    ),
    (Status::STEERING_RAILED, "align the laser by hand until the stage leaves its limit"),
    (Status::SAMPLE_GAP, "samples are lost before they reach the daemon: see its counters"),
    (
        Status::CLOCK_UNSYNCED,
        "the time is not reliable: the system clock was stepped (wait), or the clock of the board is wrong (see the daemon's log)",
    ),
    (
        Status::OUT_OF_CALIBRATION,
        "a spot is outside the area that its correction table covers: move the mirror back, or calibrate over a larger range",
    ),
    (
        Status::UNCALIBRATED,
        "no valid calibration: spot errors up to 250 um; set calibration.record and correction tables",
    ),
    (
        Status::INCONSISTENT,
        "steering and pose are inconsistent: the log and the doubts in `trifacet ctl status` name the size; check for a displaced laser, stage, mirror or PSD, dirt, and ambient light",
    ),
    (Status::SIMULATED, "simulated light: do not control a machine with it"),
];
