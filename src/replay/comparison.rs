//! Compares the reports of a replay with the recorded frames.

use trifacet_core::estimation::PoseReport;
use trifacet_core::stamp::Stamp;
use trifacet_core::time::Mono;
use trifacet_wire::{PoseFrame, Status};

use crate::publishing::columns::{Columns, Value};
use crate::recording::Entry;

/// Status bits that do not depend on the samples: they come from the clock, the recorder, and the replay.
const OF_THE_MOMENT: u32 = Status::CLOCK_UNSYNCED.0 | Status::RECORDING_FAULT.0 | Status::REPLAYED.0;
/// In the place of `POWER_NOISY`, versions before this bit set the bit of the PSD.
const LOW: u32 = Status::PSD_A_LOW.0 | Status::PSD_B_LOW.0 | Status::PSD_C_LOW.0;
/// Columns by which a difference is described first.
const TELLING: [&str; 7] = ["tx_m", "ty_m", "tz_m", "roll_rad", "pitch_rad", "yaw_rad", "status"];

/// Number of identical frames, and the first difference.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Comparison {
    /// Frames that are identical bit by bit.
    pub same: u64,
    /// Frames that have `PSD_A_LOW` to `PSD_C_LOW` in the place of `POWER_NOISY`, and are identical otherwise:
    /// their version did not have this bit.
    pub renamed: u64,
    /// Frames that lack `INCONSISTENT` or `OUT_OF_CALIBRATION`, and are identical otherwise: their version did not test
    /// the mean residual, or whether measurements cover the spots.
    pub untested: u64,
    /// Frames that differ.
    pub other: u64,
    /// Reports without a recorded frame.
    pub unrecorded: u64,
    /// Recorded frames without a report: at the start, or after a gap.
    pub unrepeated: u64,
    /// The first difference.
    pub first: Option<Difference>,
    /// A report is waiting for its frame.
    waits: bool,
    /// The status bits that the version of the recording did not test.
    untestable: Status,
}

/// A difference between a recorded frame and its report.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Time of the frame, nanoseconds of UTC since 1970.
    pub time_ns: i64,
    /// Index of the converter's sample.
    pub index: u64,
    /// Name of the column that differs.
    pub column: &'static str,
    /// The recorded value.
    pub then: Value,
    /// The value of the replay.
    pub now: Value,
}

/// A recorded frame, and the frame of the replay.
#[derive(Clone, Copy, Debug)]
pub struct Pair<'a> {
    /// As published.
    pub then: &'a PoseFrame,
    /// From the replay, with the same time, session and sequence number.
    pub now: PoseFrame,
    same: bool,
    earlier: Earlier,
}

/// How the status of a recorded frame differs because of its version.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Earlier {
    No,
    Renamed,
    Untested,
}

impl Pair<'_> {
    /// Whether both are identical, except for status bits that earlier versions did not have.
    pub fn same(&self) -> bool {
        self.same
    }
}

impl Comparison {
    /// Takes an entry and the [last report of the engine](super::Engine::report). Returns a pair if the entry
    /// is the frame of this report.
    pub fn take<'a>(&mut self, entry: &'a Entry, report: Option<&PoseReport>) -> Option<Pair<'a>> {
        match entry {
            Entry::Frame { frame, time, .. } => {
                let waited = std::mem::take(&mut self.waits);
                let Some(report) = report.filter(|report| waited && of(report, frame, *time)) else {
                    self.unrecorded += u64::from(waited);
                    self.unrepeated += 1;
                    return None;
                };
                let pair = pair(frame, *time, report, self.untestable);
                self.count(&pair);
                Some(pair)
            }
            Entry::Sample { .. } | Entry::Silence { .. } => {
                self.unrecorded += u64::from(self.waits && report.is_some());
                self.waits |= report.is_some();
                None
            }
            Entry::Keyframe(keyframe) => {
                self.untestable = Status::default();
                self.untestable.set(Status::INCONSISTENT, !keyframe.memory.has_mean_residual());
                self.untestable.set(Status::OUT_OF_CALIBRATION, !keyframe.memory.has_coverage());
                None
            }
            Entry::Lock { .. } => None,
        }
    }

    /// Notes a gap in the recording.
    pub fn hole(&mut self) {
        self.unrecorded += u64::from(std::mem::take(&mut self.waits));
    }

    fn count(&mut self, pair: &Pair<'_>) {
        if pair.same {
            *match pair.earlier {
                Earlier::No => &mut self.same,
                Earlier::Renamed => &mut self.renamed,
                Earlier::Untested => &mut self.untested,
            } += 1;
            return;
        }
        self.other += 1;
        if self.first.is_none() {
            self.first = Some(difference(pair));
        }
    }
}

/// Whether a frame belongs to this report, and not to one that is missing in the recording.
fn of(report: &PoseReport, frame: &PoseFrame, time: Mono) -> bool {
    report.index == frame.sample_index || report.time == time
}

fn pair<'a>(then: &'a PoseFrame, time: Mono, report: &PoseReport, untestable: Status) -> Pair<'a> {
    let stamp = Stamp {
        session: then.session,
        config: report.config,
        sequence: then.sequence,
        time_ns: then.time_ns,
        synced: true,
        sent: report.time,
    };
    let mut now = report.frame(stamp);
    let of_the_moment = |frame: &PoseFrame| frame.status.0 & OF_THE_MOMENT;
    now.status.0 = now.status.0 & !OF_THE_MOMENT | of_the_moment(then);
    (now.solve_delay_ns, now.send_delay_ns) = (then.solve_delay_ns, then.send_delay_ns);
    let (status, earlier) = as_then(then.status, now.status, untestable);
    let compared = PoseFrame { status, ..now };
    let same = report.time == time && equal(then, &compared);
    Pair { then, now, same, earlier }
}

/// The status `now` as the version of `then` would have stated it.
fn as_then(then: Status, now: Status, untestable: Status) -> (Status, Earlier) {
    let new = now.0 & !then.0 & untestable.0;
    if let Some(status) = with_earlier_names(then, now) {
        (status, Earlier::Renamed)
    } else if new != 0 {
        (Status(now.0 & !new), Earlier::Untested)
    } else {
        (now, Earlier::No)
    }
}

/// The status `now` in the names of a version without `POWER_NOISY`, if `then` can be of such a version.
fn with_earlier_names(then: Status, now: Status) -> Option<Status> {
    let noisy = now.has(Status::POWER_NOISY) && !then.has(Status::POWER_NOISY);
    let low = then.0 & LOW & !now.0;
    (noisy && low != 0).then_some(Status(now.0 & !Status::POWER_NOISY.0 | low))
}

/// Whether a recorded frame and another one are equal bit by bit, including NaN.
fn equal(a: &PoseFrame, b: &PoseFrame) -> bool {
    let doubles = |f: &PoseFrame| f.pose.map(f64::to_bits);
    let singles = |f: &PoseFrame| {
        let PoseFrame { deviations, beam_offset, spots, powers, steering, .. } = f;
        (
            deviations.map(f32::to_bits),
            beam_offset.map(f32::to_bits),
            f.steering_residual.to_bits(),
            spots.map(f32::to_bits),
            powers.map(f32::to_bits),
            steering.map(f32::to_bits),
        )
    };
    let rest = |f: &PoseFrame| {
        let PoseFrame { config, sample_index, status, clock_quality, lock, .. } = *f;
        (config, sample_index, status, clock_quality, lock, f.iterations, f.averaged, f.lost)
    };
    let systematic = |f: &PoseFrame| f.systematic.map(|part| part.map(f32::to_bits));
    // Versions without the systematic part recorded none.
    let unrecorded = a.systematic.is_none();
    doubles(a) == doubles(b)
        && singles(a) == singles(b)
        && rest(a) == rest(b)
        && (unrecorded || systematic(a) == systematic(b))
}

fn difference(pair: &Pair<'_>) -> Difference {
    let (then, now) = (Columns::of(pair.then), Columns::of(&pair.now));
    let all = then.0.into_iter().zip(now.0).map(|((column, then), (_, now))| (column, then, now));
    let mut different: Vec<_> = all.filter(|(_, then, now)| !alike(then, now)).collect();
    different
        .sort_by_key(|(column, ..)| TELLING.iter().position(|name| name == column).unwrap_or(usize::MAX));
    // If all columns are equal, only the monotonic time can differ.
    let (column, then, now) = different.into_iter().next().unwrap_or((
        "time_ns",
        Value::Integer(pair.then.time_ns),
        Value::Text("another time".into()),
    ));
    let PoseFrame { time_ns, sample_index: index, .. } = *pair.then;
    Difference { time_ns, index, column, then, now }
}

fn alike(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::Number(a), Value::Number(b)) => a.to_bits() == b.to_bits(),
        (a, b) => a == b,
    }
}
