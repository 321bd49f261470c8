//! Liveness of the daemon, and readiness of its poses. Pure.

use jiff::Timestamp;
use serde::Serialize;
use trifacet_core::centering::lock::LockCause;
use trifacet_wire::{LockState, PoseFrame, Status};

use crate::doubts::ShownDoubt;
use crate::grade::Assessment;

/// A condition for the use of poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Subject {
    /// Samples come from a source, not from a recording.
    Samples,
    /// The time of the measurement is reliable.
    Time,
    /// The frame has a valid pose.
    Optics,
    /// The pose agrees with the other signals.
    Consistency,
    /// The spots are where their correction tables have measurements.
    Calibration,
    /// The loop holds the beam on the apex.
    Lock,
}

impl Subject {
    /// All subjects, in the order of the signal flow.
    pub const ALL: [Subject; 6] = [
        Subject::Samples,
        Subject::Time,
        Subject::Optics,
        Subject::Consistency,
        Subject::Calibration,
        Subject::Lock,
    ];

    /// Name of the subject.
    pub fn name(self) -> &'static str {
        match self {
            Subject::Samples => "samples",
            Subject::Time => "time",
            Subject::Optics => "optics",
            Subject::Consistency => "consistency",
            Subject::Calibration => "calibration",
            Subject::Lock => "lock",
        }
    }

    fn holds(self, frame: &PoseFrame) -> bool {
        match self {
            Subject::Samples => Status(frame.status.0 & NO_SAMPLES.0) == Status::default(),
            Subject::Time => !frame.status.has(Status::CLOCK_UNSYNCED),
            Subject::Optics => frame.status.has(Status::POSE_VALID),
            Subject::Consistency => !frame.status.has(Status::INCONSISTENT),
            Subject::Calibration => !frame.status.has(Status::OUT_OF_CALIBRATION),
            Subject::Lock => frame.lock == LockState::Locked,
        }
    }

    /// Why the condition fails for this frame: names of status bits, or the lock state with its cause. Without
    /// a known cause, the status bits that are fatal are the reason.
    fn reason(self, frame: &PoseFrame, causes: &Causes) -> String {
        match self {
            Subject::Samples => match &causes.source {
                Some(why) => format!("{}: {why}", names(frame.status, NO_SAMPLES)),
                None => names(frame.status, NO_SAMPLES),
            },
            Subject::Time => names(frame.status, Status::CLOCK_UNSYNCED),
            Subject::Consistency => names(frame.status, Status::INCONSISTENT),
            Subject::Calibration => names(frame.status, Status::OUT_OF_CALIBRATION),
            Subject::Optics => {
                let fatal = names(frame.status, Status::FATAL);
                // The only other cause of an invalid frame is a gap within an averaged block.
                if fatal.is_empty() { "SAMPLE_GAP".into() } else { fatal }
            }
            Subject::Lock => {
                let why = causes
                    .lock
                    .map_or_else(|| names(frame.status, Status::FATAL), |cause| cause.text().into());
                if why.is_empty() {
                    frame.lock.name().into()
                } else {
                    format!("{}: {why}", frame.lock.name())
                }
            }
        }
    }
}

/// What the daemon knows beyond the newest frame.
#[derive(Clone, Debug, Default)]
pub struct Causes {
    /// The cause of the lock state of that frame.
    pub lock: Option<LockCause>,
    /// Why the source is down.
    pub source: Option<String>,
}

/// Status bits of frames without live samples.
const NO_SAMPLES: Status = Status(Status::SOURCE_DOWN.0 | Status::REPLAYED.0);

fn names(status: Status, of: Status) -> String {
    Status(status.0 & of.0).names().collect::<Vec<_>>().join(", ")
}

/// A part of the daemon that stalls.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Standstill {
    /// Description.
    pub why: String,
    /// Time at which the stall was noticed, or, if there are no frames, time of the last frame; nanoseconds
    /// of UTC since 1970. `None` before the first frame.
    pub since_ns: Option<i64>,
    /// There are no frames. Otherwise other tasks continue, and the contents of the frames are valid.
    pub silent: bool,
}

/// Result of each check, and the time of its last change.
#[derive(Clone, Copy, Debug, Default)]
pub struct Checks([Option<Check>; Subject::ALL.len()]);

#[derive(Clone, Copy, Debug)]
struct Check {
    ok: bool,
    /// Time of the first frame with this result, UTC.
    since_ns: i64,
}

impl Checks {
    /// Takes every frame in turn.
    pub fn frame(&mut self, frame: &PoseFrame) {
        for (check, subject) in self.0.iter_mut().zip(Subject::ALL) {
            let ok = subject.holds(frame);
            if check.is_none_or(|check| check.ok != ok) {
                *check = Some(Check { ok, since_ns: frame.time_ns });
            }
        }
    }

    /// The findings with `newest` as the newest frame. No check passes while a part of the daemon stalls
    /// (`dead`).
    pub fn findings(
        &self,
        newest: Option<&PoseFrame>,
        dead: Option<&Standstill>,
        causes: &Causes,
    ) -> Vec<Finding> {
        let checks = Subject::ALL.iter().zip(self.0).map(|(subject, check)| {
            let (Some(frame), Some(check)) = (newest, check) else {
                let reason = dead.map_or("no frame has been made yet", |still| &still.why);
                return Finding { name: subject.name(), ok: false, since: None, reason: Some(reason.into()) };
            };
            let (ok, since_ns, reason) = match dead {
                Some(still) => {
                    let since_ns = still.since_ns.unwrap_or(frame.time_ns);
                    (false, if check.ok { since_ns } else { check.since_ns }, Some(still.why.clone()))
                }
                None => (check.ok, check.since_ns, (!check.ok).then(|| subject.reason(frame, causes))),
            };
            Finding { name: subject.name(), ok, since: utc(since_ns), reason }
        });
        checks.collect()
    }
}

/// Whether poses can be used, and the reasons if not.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Readiness {
    /// All checks pass.
    pub ready: bool,
    /// The checks in the order of [`Subject::ALL`].
    pub checks: Vec<Finding>,
    /// The doubts that stand. They do not decide whether the poses can be used.
    pub doubts: Vec<ShownDoubt>,
    /// Grade of the poses with all limitations. Poses can be ready with a limited grade.
    #[serde(flatten)]
    pub assessment: Assessment,
}

/// Result of a check.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Name of the subject.
    pub name: &'static str,
    /// The check passes.
    pub ok: bool,
    /// UTC of the first frame with this result; `None` before the first frame.
    pub since: Option<String>,
    /// Why the check fails.
    pub reason: Option<String>,
}

/// A time in nanoseconds since 1970 as text.
pub(super) fn utc(ns: i64) -> Option<String> {
    Timestamp::from_nanosecond(ns.into()).ok().map(|time| time.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames() -> [PoseFrame; 3] {
        let good = PoseFrame { time_ns: 1_000_000_000, lock: LockState::Locked, ..PoseFrame::example() };
        let dark = Status::PSD_A_LOW | Status::PSD_B_LOW | Status::UNCALIBRATED;
        let held = PoseFrame { time_ns: 2_000_000_000, status: dark, lock: LockState::Held, ..good };
        let lost = PoseFrame { time_ns: 3_000_000_000, lock: LockState::Lost, ..held };
        [good, held, lost]
    }

    fn checks_of(findings: &[Finding]) -> Vec<(bool, &str, &str)> {
        let text = |text: &'static str| text;
        let checks = findings.iter();
        checks
            .map(|c| (c.ok, c.since.as_deref().unwrap_or(text("")), c.reason.as_deref().unwrap_or("")))
            .collect()
    }

    #[test]
    fn each_check_has_its_time_and_its_reason() {
        let [good, held, lost] = frames();
        let mut checks = Checks::default();
        checks.frame(&good);
        let findings = checks.findings(Some(&good), None, &Causes::default());
        assert!(findings.iter().all(|check| check.ok));
        assert_eq!(checks_of(&findings), [(true, "1970-01-01T00:00:01Z", ""); 6]);
        checks.frame(&held);
        checks.frame(&lost);
        let findings =
            checks.findings(Some(&lost), None, &Causes { lock: Some(LockCause::NoLight), source: None });
        assert!(!findings.iter().all(|check| check.ok));
        let at = "1970-01-01T00:00:02Z";
        let dark = (false, at, "PSD_A_LOW, PSD_B_LOW");
        let good = (true, "1970-01-01T00:00:01Z", "");
        assert_eq!(
            checks_of(&findings),
            [good, good, dark, good, good, (false, at, "lost: no PSD sees light")]
        );
    }

    #[test]
    fn a_replay_is_never_ready() {
        let [good, ..] = frames();
        let replayed = PoseFrame { status: good.status | Status::REPLAYED, ..good };
        let mut checks = Checks::default();
        checks.frame(&replayed);
        let findings = checks.findings(Some(&replayed), None, &Causes::default());
        assert!(!findings.iter().all(|check| check.ok));
        let at = "1970-01-01T00:00:01Z";
        let fine = (true, at, "");
        assert_eq!(checks_of(&findings), [(false, at, "REPLAYED"), fine, fine, fine, fine, fine]);
    }

    #[test]
    fn ready_means_usable_for_control_and_locked() {
        let [good, ..] = frames();
        for (bit, name) in Status::NAMES {
            let frame = PoseFrame { status: good.status | *bit, ..good };
            let mut checks = Checks::default();
            checks.frame(&frame);
            let ready = checks.findings(Some(&frame), None, &Causes::default()).iter().all(|check| check.ok);
            // POSE_HELD is set for single clients only; with a fatal bit the estimator does not set POSE_VALID.
            if *bit != Status::POSE_HELD && !Status::FATAL.has(*bit) {
                assert_eq!(ready, frame.status.usable(Status::SIMULATED), "{name}");
            }
        }
    }

    #[test]
    fn no_check_stays_green_without_frames() {
        let [good, held, _] = frames();
        let mut checks = Checks::default();
        assert_eq!(
            checks_of(&checks.findings(None, None, &Causes::default())),
            [(false, "", "no frame has been made yet"); 6]
        );
        let dead = Standstill { why: "dead".into(), since_ns: Some(4_000_000_000), silent: true };
        assert_eq!(
            checks_of(&checks.findings(None, Some(&dead), &Causes::default())),
            [(false, "", "dead"); 6]
        );
        checks.frame(&good);
        let at = "1970-01-01T00:00:04Z";
        assert_eq!(
            checks_of(&checks.findings(Some(&good), Some(&dead), &Causes::default())),
            [(false, at, "dead"); 6]
        );
        checks.frame(&held);
        let down = PoseFrame { status: Status::SOURCE_DOWN, time_ns: 5_000_000_000, ..held };
        checks.frame(&down);
        assert_eq!(
            checks_of(&checks.findings(Some(&down), None, &Causes::default()))[0],
            (false, "1970-01-01T00:00:05Z", "SOURCE_DOWN")
        );
    }
}
