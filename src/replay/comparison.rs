//! What came out, beside what was published then.

use trifacet_core::estimation::PoseReport;
use trifacet_core::stamp::Stamp;
use trifacet_core::time::Mono;
use trifacet_wire::{PoseFrame, Status};

use crate::publishing::columns::{Columns, Value};
use crate::recording::Entry;

/// Bits that do not come from the samples: from the clock, the recorder, and the replay itself.
const OF_THE_MOMENT: u32 = Status::CLOCK_UNSYNCED.0 | Status::RECORDING_FAULT.0 | Status::REPLAYED.0;
/// What two frames are first told apart by.
const TELLING: [&str; 7] = ["tx_m", "ty_m", "tz_m", "roll_rad", "pitch_rad", "yaw_rad", "status"];

/// How many frames are the same, and how the first other one differs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Comparison {
    /// Frames that are the same, bit by bit.
    pub same: u64,
    /// Frames that differ.
    pub other: u64,
    /// Reports without a frame on record.
    pub unrecorded: u64,
    /// Frames on record before which nothing came out: at the start, or behind a hole.
    pub unrepeated: u64,
    /// The first that differs.
    pub first: Option<Difference>,
    /// A report waits for its frame.
    waits: bool,
}

/// A frame that came out differently.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// When, nanoseconds of UTC since 1970.
    pub time_ns: i64,
    /// Index of the converter's sample.
    pub index: u64,
    /// What differs, by the name of its column.
    pub column: &'static str,
    /// What was published.
    pub then: Value,
    /// What came out.
    pub now: Value,
}

/// A frame on record, and what came out.
#[derive(Clone, Copy, Debug)]
pub struct Pair<'a> {
    /// As it was published.
    pub then: &'a PoseFrame,
    /// As it would be published now: at the same moment, in the same session, as the same number.
    pub now: PoseFrame,
    same: bool,
}

impl Pair<'_> {
    /// Whether they are the same, bit by bit.
    pub fn same(&self) -> bool {
        self.same
    }
}

impl Comparison {
    /// Takes an entry and [what came out last](super::Engine::report); gives the pair when the entry is the frame of
    /// that.
    pub fn take<'a>(&mut self, entry: &'a Entry, report: Option<&PoseReport>) -> Option<Pair<'a>> {
        match entry {
            Entry::Frame { frame, time, .. } => {
                let waited = std::mem::take(&mut self.waits);
                let Some(report) = report.filter(|report| waited && of(report, frame, *time)) else {
                    self.unrecorded += u64::from(waited);
                    self.unrepeated += 1;
                    return None;
                };
                let pair = pair(frame, *time, report);
                self.count(&pair);
                Some(pair)
            }
            Entry::Sample { .. } | Entry::Silence { .. } => {
                self.unrecorded += u64::from(self.waits && report.is_some());
                self.waits |= report.is_some();
                None
            }
            Entry::Keyframe(_) | Entry::Lock { .. } => None,
        }
    }

    /// Something is missing on record.
    pub fn hole(&mut self) {
        self.unrecorded += u64::from(std::mem::take(&mut self.waits));
    }

    fn count(&mut self, pair: &Pair<'_>) {
        if pair.same {
            self.same += 1;
            return;
        }
        self.other += 1;
        if self.first.is_none() {
            self.first = Some(difference(pair));
        }
    }
}

/// Whether a frame is of this report, not of one that is missing on record.
fn of(report: &PoseReport, frame: &PoseFrame, time: Mono) -> bool {
    report.index == frame.sample_index || report.time == time
}

fn pair<'a>(then: &'a PoseFrame, time: Mono, report: &PoseReport) -> Pair<'a> {
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
    Pair { then, same: report.time == time && equal(then, &now), now }
}

/// Whether two frames are equal bit by bit; what is not a number is the same nothing.
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
    doubles(a) == doubles(b) && singles(a) == singles(b) && rest(a) == rest(b)
}

fn difference(pair: &Pair<'_>) -> Difference {
    let (then, now) = (Columns::of(pair.then), Columns::of(&pair.now));
    let all = then.0.into_iter().zip(now.0).map(|((column, then), (_, now))| (column, then, now));
    let mut different: Vec<_> = all.filter(|(_, then, now)| !alike(then, now)).collect();
    different
        .sort_by_key(|(column, ..)| TELLING.iter().position(|name| name == column).unwrap_or(usize::MAX));
    // With every column alike, only the moment can differ.
    let (column, then, now) = different.into_iter().next().unwrap_or((
        "time_ns",
        Value::Integer(pair.then.time_ns),
        Value::Text("another moment".into()),
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
