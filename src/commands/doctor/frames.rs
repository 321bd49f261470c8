//! What the frames themselves say.

use trifacet::client::{Descriptor, Heartbeat, Losses, PoseFrame};
use trifacet::publishing::columns::rfc3339;
use trifacet_wire::{LockState, Status};

use super::Report;

/// Two clocks that differ by more spoil any check of a pose's age.
const CLOCKS_S: f64 = 0.1;

/// What came.
#[derive(Default)]
pub(super) struct Seen {
    pub(super) descriptor: Option<Box<Descriptor>>,
    pub(super) heartbeat: Option<Heartbeat>,
    last: Option<PoseFrame>,
    frames: u64,
    valid: u64,
    /// Bits of the frames without a valid pose, and of those with one.
    invalid_bits: Status,
    valid_bits: Status,
    /// The least that a frame seemed to be on its way, by the two clocks.
    way_ns: Option<i64>,
}

impl Seen {
    pub(super) fn frames(&self) -> u64 {
        self.frames
    }

    /// Takes a frame that arrived at this time, by the clock of this machine.
    pub(super) fn frame(&mut self, frame: &PoseFrame, now_ns: i64) {
        self.frames += 1;
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

    /// Judges what came.
    pub(super) fn tell(&self, losses: Losses, report: &mut Report) {
        let Some(last) = &self.last else { return };
        if let Some(descriptor) = &self.descriptor {
            report.good(&format!(
                "daemon {} speaks version {} of the stream, {} frames a second",
                descriptor.daemon_version, descriptor.stream_version, descriptor.rate_hz
            ));
        }
        report.good(&format!(
            "{} frames arrived (session {:08x}, config {:08x})",
            self.frames, last.session, last.config
        ));
        self.losses(losses, report);
        if self.replayed() {
            self.replay(last, report);
            return self.poses(last.lock, report); // the time is not that of now, which is no fault of a clock
        }
        self.poses(last.lock, report);
        self.clock(report);
    }

    fn replayed(&self) -> bool {
        (self.valid_bits | self.invalid_bits).has(Status::REPLAYED)
    }

    fn replay(&self, last: &PoseFrame, report: &mut Report) {
        let told = self.descriptor.as_ref().and_then(|descriptor| descriptor.replay.as_ref());
        let what = match told {
            Some(replay) => format!("REPLAYED: a replay of {}, recorded {}", replay.file, replay.recorded),
            None => format!("REPLAYED: the newest frame is of {}", rfc3339(last.time_ns)),
        };
        report.note(&what, "the poses are of the past: never steer a machine by them");
    }

    /// Why a replay gives no samples, and what to do.
    fn nothing_due(&self) -> (&'static str, &'static str) {
        let ends = self.heartbeat.as_ref().and_then(|heartbeat| heartbeat.counters.get("replay_ends"));
        let told = self.descriptor.as_ref().and_then(|descriptor| descriptor.replay.as_ref());
        match (told, ends) {
            (Some(replay), Some(1..)) if !replay.repeat => (
                "the recording is at its end",
                "restart the daemon to see it again, or let it begin again by itself (replay.repeat = true)",
            ),
            (Some(_), Some(_)) => (
                "the recording has a hole here",
                "wait: it goes on behind it; trifacet info FILE says how large it is",
            ),
            _ => ("the recording gives no samples", "it is at its end, or has a hole here"),
        }
    }

    fn losses(&self, losses: Losses, report: &mut Report) {
        let dropped = self.heartbeat.as_ref().map_or(0, |heartbeat| heartbeat.dropped);
        let Losses { missed_frames, late_frames, skipped_bytes } = losses;
        if missed_frames + late_frames + skipped_bytes + dropped > 0 {
            report.note(
                &format!("{missed_frames} frames are missing, {late_frames} late, {skipped_bytes} bytes unreadable, {dropped} frames dropped by the daemon"),
                "is this machine or the network too slow? A larger receive buffer (net.core.rmem_max) or a divider helps",
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
            report.wrong("no light on any PSD", "is the laser on, the beam free, the amplifier powered?");
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
            return; // nothing is held
        }
        if bits.has(Status::NOT_LOCKED) {
            let advice = match lock {
                _ if self.replayed() => "nothing steers in a replay: so it was when it was recorded",
                LockState::Off => "the centering loop is switched off: [centering] enabled",
                LockState::Manual => "a person moves the laser",
                LockState::Searching | LockState::Lost => "there is no light to centre: see above",
                LockState::Acquiring => {
                    "the beam is not on the apex yet: if it stays so, align the laser, and check the gains"
                }
                LockState::Railed => {
                    "the steering stands at its limit: align the laser by hand until it comes free"
                }
                LockState::Held => "the steering holds: light or samples are missing for a moment",
                LockState::Locked => "the loop lost its lock for a moment, and has it again",
            };
            report.note(&format!("NOT_LOCKED: the lock state is {}", lock.name()), advice);
        }
    }

    fn clock(&self, report: &mut Report) {
        let Some(way_s) = self.way_ns.map(|ns| ns as f64 * 1e-9) else { return };
        if way_s.abs() > CLOCKS_S {
            let which = if way_s > 0.0 { "behind" } else { "ahead of" };
            report.note(
                &format!("the clock is off: the daemon's is {:.3} s {which} that of this machine", way_s.abs()),
                "set both by NTP or PTP, or do not compare time_ns with the clock of this machine; then restart the daemon",
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

const LOW: &str =
    "too little light there: is that part of the beam blocked, the cable in, the mirror near the middle?";
const CLIPPED: &str = "the converter is at its rail there: too much light or too much gain";
const EDGE: &str = "the spot is near the edge there: move the mirror back towards the middle";

/// The bits that make a pose invalid.
const FATAL: [(Status, &str); 10] = [
    (Status::SOURCE_DOWN, "no samples come: is the board plugged in and powered? The daemon's log says more"),
    (Status::PSD_A_LOW, LOW),
    (Status::PSD_B_LOW, LOW),
    (Status::PSD_C_LOW, LOW),
    (Status::PSD_A_CLIPPED, CLIPPED),
    (Status::PSD_B_CLIPPED, CLIPPED),
    (Status::PSD_C_CLIPPED, CLIPPED),
    (
        Status::NOT_CONVERGED,
        "no pose explains the signals: is something else reflecting, is the geometry in [head] right?",
    ),
    (Status::POWER_STEP, "the laser's power makes steps: is it stable, does something cut into the beam?"),
    (Status::OUT_OF_RANGE, "a spot is off its PSD, or the pose out of range: move the mirror back"),
];

const WARNINGS: [(Status, &str); 10] = [
    (Status::PSD_A_EDGE, EDGE),
    (Status::PSD_B_EDGE, EDGE),
    (Status::PSD_C_EDGE, EDGE),
    (
        Status::UNBALANCED,
        "the powers differ: the beam is off the apex, or dark offsets and gains are wrong (trifacet dark)",
    ),
    (Status::STEERING_RAILED, "align the laser by hand until the steering comes free of its limit"),
    (Status::SAMPLE_GAP, "samples get lost before the daemon: see its counters"),
    (Status::CLOCK_UNSYNCED, "the daemon's system clock was stepped: wait, or restart the daemon"),
    (Status::UNCALIBRATED, "errors up to 250 um on the spots: give [channels] correction tables"),
    (Status::INCONSISTENT, "steering and pose contradict each other: was the laser or the stage bumped?"),
    (Status::SIMULATED, "the light is computed: never steer a machine by it"),
];
