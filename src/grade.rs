//! The grade of the poses: one word for how far they can be used, and the conditions that limit their use.
//!
//! Every output that judges the poses takes its grade from here: the live page, `/readyz`, `trifacet status`
//! and the status line of systemd. Pure.

use serde::Serialize;
use trifacet_wire::{LockState, Status};

/// Time for which a status bit counts after its last frame, seconds. Without it, a bit that comes and goes would
/// change the grade many times a second.
pub const HOLD_S: f64 = 2.0;

/// How far the poses can be used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Grade {
    /// Nothing limits the use of the pose.
    #[default]
    Good,
    /// The pose is valid, with a limitation.
    Limited,
    /// There is no pose that a control may use.
    Bad,
}

impl Grade {
    /// Name of the grade.
    pub fn name(self) -> &'static str {
        match self {
            Grade::Good => "good",
            Grade::Limited => "limited",
            Grade::Bad => "bad",
        }
    }
}

/// A condition that limits the use of the poses.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Limitation {
    /// Effect on the grade.
    pub grade: Grade,
    /// Names of the status bits, or `doubt`, `uncertainty`, `stalled`, `silent`.
    pub name: String,
    /// Description.
    pub text: String,
    /// What to do.
    pub remedy: String,
    /// UTC of its begin, if it is known.
    pub since: Option<String>,
    /// A condition before this one in the list explains it.
    pub consequence: bool,
}

impl Limitation {
    /// A few words for a headline. The text of a doubt has several sentences.
    fn short(&self) -> String {
        match (self.name.as_str(), self.name.strip_prefix("doubt: ")) {
            ("UNCALIBRATED", _) => "not calibrated".into(),
            ("SIMULATED", _) => "simulated light".into(),
            (_, Some(subject)) => format!("doubt about {}", subject.replace('_', " ")),
            _ => self.text.clone(),
        }
    }
}

/// The grade with its reasons.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Assessment {
    /// The worst grade of all limitations.
    pub grade: Grade,
    /// The most important state in one sentence.
    pub headline: String,
    /// UTC since which the first limitation stands, if it is known.
    pub since: Option<String>,
    /// All limitations: causes before their consequences, then the worse ones first.
    pub limitations: Vec<Limitation>,
}

/// What is judged.
#[derive(Clone, Copy, Debug, Default)]
pub struct Evidence<'a> {
    /// Status of the newest frame; `None` before the first frame.
    pub status: Option<Status>,
    /// Further status bits that were set in the last moments.
    pub lately: Status,
    /// Lock state of the newest frame.
    pub lock: LockState,
    /// The cause of this lock state.
    pub lock_cause: Option<&'a str>,
    /// Why the source is down.
    pub source_down: Option<&'a str>,
    /// The mode of the loop if it explains why there is no lock, such as `loop in shadow mode`.
    pub loop_mode: Option<&'a str>,
    /// The part of the daemon that stalls.
    pub stalled: Option<&'a str>,
    /// The stalled part is needed for frames: there are no current ones.
    pub silent: bool,
}

/// The fatal bits, causes first. The position on a line gives the order of the headline.
const FATAL: [Status; 7] = [
    Status::SOURCE_DOWN,
    Status::CHANNEL_FROZEN,
    Status(Status::PSD_A_CLIPPED.0 | Status::PSD_B_CLIPPED.0 | Status::PSD_C_CLIPPED.0),
    Status(Status::PSD_A_LOW.0 | Status::PSD_B_LOW.0 | Status::PSD_C_LOW.0),
    Status(Status::POWER_STEP.0 | Status::POWER_NOISY.0),
    Status::OUT_OF_RANGE,
    Status::NOT_CONVERGED,
];

/// Bits with which a control must not use the pose, although it is valid.
const UNUSABLE: [Status; 4] =
    [Status::CLOCK_UNSYNCED, Status::INCONSISTENT, Status::OUT_OF_CALIBRATION, Status::POSE_HELD];

/// Warnings, causes first.
const WARNINGS: [Status; 9] = [
    Status::STEERING_RAILED,
    Status::NOT_LOCKED,
    Status(Status::PSD_A_EDGE.0 | Status::PSD_B_EDGE.0 | Status::PSD_C_EDGE.0),
    Status::UNBALANCED,
    Status::SAMPLE_GAP,
    Status::RECORDING_FAULT,
    Status::UNCALIBRATED,
    Status::SIMULATED,
    Status::REPLAYED,
];

/// Conditions of the installation, which do not end by themselves.
const STANDING: Status = Status(Status::UNCALIBRATED.0 | Status::SIMULATED.0 | Status::REPLAYED.0);

/// Bits that follow from a missing pose or a missing lock.
const BY_NO_POSE: Status =
    Status(Status::NOT_LOCKED.0 | Status::UNBALANCED.0 | Status::NOT_CONVERGED.0 | Status::OUT_OF_RANGE.0);

impl Evidence<'_> {
    /// All bits to judge.
    fn bits(&self) -> Status {
        self.status.unwrap_or_default() | self.lately
    }

    /// Judges the evidence, with further limitations such as doubts. `since` gives the UTC of the begin of a bit.
    pub fn assess(&self, further: Vec<Limitation>, since: impl Fn(Status) -> Option<String>) -> Assessment {
        let mut limitations = self.standstill();
        let mut explained = Status::default();
        for group in FATAL.into_iter().chain(UNUSABLE).chain(WARNINGS) {
            let set = Status(self.bits().0 & group.0);
            if set.0 != 0 {
                let mut limitation = self.limitation(set);
                limitation.since = since(set);
                limitation.consequence = explained.has(set);
                limitations.push(limitation);
                explained |= consequences(set);
            }
        }
        if let Some(status) = self.status
            && !status.has(Status::POSE_VALID)
            && status.0 & Status::FATAL.0 == 0
        {
            limitations.push(gap_in_block());
        }
        limitations.extend(further);
        // Stable: the order of the lists above, causes first, within each rank.
        limitations.sort_by_key(|l| (std::cmp::Reverse(l.grade), l.consequence));
        let grade = limitations.iter().map(|limitation| limitation.grade).max().unwrap_or_default();
        let replayed = self.status.is_some_and(|status| status.has(Status::REPLAYED));
        let headline = self.headline(&limitations);
        let headline = if replayed { format!("Replay: {}", small(&headline)) } else { headline };
        let since = limitations.first().and_then(|first| first.since.clone());
        Assessment { grade, headline, since, limitations }
    }

    fn standstill(&self) -> Vec<Limitation> {
        let why = match (self.stalled, self.status) {
            (Some(why), _) => why,
            (None, None) => "no frame has been made yet",
            (None, Some(_)) => return Vec::new(),
        };
        let name = if self.silent || self.status.is_none() { "silent" } else { "stalled" };
        vec![Limitation {
            grade: Grade::Bad,
            name: name.into(),
            text: why.into(),
            remedy: "see the log of the daemon".into(),
            since: None,
            consequence: false,
        }]
    }

    fn limitation(&self, set: Status) -> Limitation {
        let fatal = Status::FATAL.0 | UNUSABLE.iter().fold(0, |bits, bit| bits | bit.0);
        let grade = if set.0 & fatal == 0 { Grade::Limited } else { Grade::Bad };
        let text = match set {
            Status::SOURCE_DOWN => with(&meaning(set), self.source_down),
            Status::NOT_LOCKED => self.no_lock(),
            _ => meaning(set),
        };
        let name = set.names().collect::<Vec<_>>().join(", ");
        Limitation { grade, name, text, remedy: remedy(set).into(), since: None, consequence: false }
    }

    /// "beam not locked: held: no PSD sees light (loop in shadow mode)".
    fn no_lock(&self) -> String {
        if self.lock == LockState::Locked {
            return "the beam was not locked just before".into();
        }
        let text = with(&format!("beam not locked: {}", self.lock.name()), self.lock_cause);
        self.loop_mode.map_or(text.clone(), |mode| format!("{text} ({mode})"))
    }

    fn headline(&self, limitations: &[Limitation]) -> String {
        let (Some(status), Some(first)) = (self.status, limitations.first()) else {
            return match limitations.first() {
                Some(first) => format!("No poses: {}", first.text),
                None => "Pose valid, beam locked".into(),
            };
        };
        let state = self.state(status);
        match first.name.as_str() {
            "silent" => format!("No poses: {}", first.text),
            "stalled" => format!("{state}: {}", first.text),
            _ if first.grade == Grade::Bad => bad(first, status),
            "NOT_LOCKED" if self.lock != LockState::Locked => format!("Pose valid, {}", first.text),
            _ => {
                let (standing, present): (Vec<_>, Vec<_>) =
                    limitations.iter().filter(|l| !l.consequence).partition(|l| is_standing(&l.name));
                // In a replay, the conditions of the installation are those of another day.
                let shown = match present.is_empty() {
                    true if status.has(Status::REPLAYED) => return state,
                    true => standing,
                    false => present,
                };
                let texts: Vec<_> = shown.iter().map(|limitation| limitation.short()).collect();
                format!("{state}; limited: {}", texts.join("; "))
            }
        }
    }

    /// Pose and lock state in words.
    fn state(&self, status: Status) -> String {
        let pose = if status.has(Status::POSE_VALID) { "Pose valid" } else { "No valid pose" };
        match self.lock {
            LockState::Locked => format!("{pose}, beam locked"),
            other => format!("{pose}, beam not locked ({})", other.name()),
        }
    }
}

fn bad(first: &Limitation, status: Status) -> String {
    let what = match status.has(Status::POSE_VALID) {
        true if UNUSABLE.iter().any(|bit| bit.names().eq([first.name.as_str()])) => "Pose not usable",
        true => "No valid pose just before",
        false => "No valid pose",
    };
    format!("{what}: {}", first.text)
}

fn is_standing(name: &str) -> bool {
    STANDING.names().any(|standing| standing == name)
}

fn with(text: &str, cause: Option<&str>) -> String {
    cause.map_or_else(|| text.to_owned(), |cause| format!("{text}: {cause}"))
}

/// The bits that these bits explain.
fn consequences(set: Status) -> Status {
    match set {
        Status::SOURCE_DOWN => Status(Status::FATAL.0 | Status::NOT_LOCKED.0 | Status::UNBALANCED.0),
        set if set.0 & Status::FATAL.0 != 0 => BY_NO_POSE,
        Status::STEERING_RAILED => Status(Status::NOT_LOCKED.0 | Status::UNBALANCED.0),
        Status::NOT_LOCKED => Status::UNBALANCED,
        _ => Status::default(),
    }
}

fn gap_in_block() -> Limitation {
    Limitation {
        grade: Grade::Bad,
        name: Status::SAMPLE_GAP.names().collect(),
        text: "samples are missing in the averaged block".into(),
        remedy: remedy(Status::SAMPLE_GAP).into(),
        since: None,
        consequence: false,
    }
}

/// The meaning of these bits in words, such as "too little light on PSD A, B".
pub fn meaning(set: Status) -> String {
    let all = Status::NAMES.iter().zip(Status::MEANINGS);
    let texts: Vec<_> =
        all.filter(|((bit, _), _)| set.has(*bit)).map(|(_, meaning)| plain(meaning)).collect();
    let Some(first) = texts.first() else { return String::new() };
    let parts: Vec<_> = texts.iter().filter_map(|text| detector(text)).collect();
    match parts.first() {
        Some(&(before, _, after))
            if parts.len() == texts.len() && parts.iter().all(|p| (p.0, p.2) == (before, after)) =>
        {
            let letters: Vec<_> = parts.iter().map(|(_, letter, _)| *letter).collect();
            format!("{before}{}{after}", letters.join(", "))
        }
        _ if texts.len() == 1 => first.clone(),
        _ => texts.join("; "),
    }
}

/// "Fatal: too little light on PSD A." without its kind and its full stop; the first letter small.
fn plain(meaning: &str) -> String {
    let text = meaning.strip_prefix("Fatal: ").or_else(|| meaning.strip_prefix("Warning: "));
    small(text.unwrap_or(meaning).trim_end_matches('.'))
}

/// The text with a small first letter.
fn small(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_lowercase().chain(letters).collect())
}

/// The text before the letter of a PSD, the letter, and the text after it.
fn detector(text: &str) -> Option<(&str, &str, &str)> {
    let at = text.find("PSD ")? + "PSD ".len();
    Some((text.get(..at)?, text.get(at..=at)?, text.get(at + 1..)?))
}

/// What to do about a bit: the last column of the table in `docs/stream.md`. For several bits, that of the
/// first one.
pub fn remedy(set: Status) -> &'static str {
    let of = |bits: u32| set.0 & bits != 0;
    match () {
        () if of(Status::PSD_A_LOW.0 | Status::PSD_B_LOW.0 | Status::PSD_C_LOW.0) => {
            "check the beam path, the laser and the cable"
        }
        () if of(Status::PSD_A_CLIPPED.0 | Status::PSD_B_CLIPPED.0 | Status::PSD_C_CLIPPED.0) => {
            "reduce the light or the gain"
        }
        () if of(Status::PSD_A_EDGE.0 | Status::PSD_B_EDGE.0 | Status::PSD_C_EDGE.0) => {
            "move the mirror back towards the centre"
        }
        () if of(Status::UNBALANCED.0) => "the beam is off the apex: see the lock state",
        () if of(Status::NOT_LOCKED.0) => "see the lock state",
        () if of(Status::STEERING_RAILED.0) => {
            "realign the laser by hand until the steering is clear of the limit"
        }
        () if of(Status::NOT_CONVERGED.0) => "check for stray reflections and for a wrong geometry",
        () if of(Status::OUT_OF_RANGE.0) => {
            "move the mirror back; if the pitch is the cause, rotate [frames] base or tool"
        }
        () if of(Status::SAMPLE_GAP.0) => "the link to the converter loses samples: see the counters",
        () if of(Status::SOURCE_DOWN.0) => {
            "check the connection and power of the board; the log gives details"
        }
        () if of(Status::CLOCK_UNSYNCED.0) => {
            "the system clock was stepped: wait. Or the clock of the board is wrong: the log names the fault"
        }
        () if of(Status::UNCALIBRATED.0) => {
            "the descriptor names the cause (uncalibrated). Spots can have errors of up to 250 um: calibrate"
        }
        () if of(Status::INCONSISTENT.0) => {
            "the log and the doubts name the size. Check for a displaced laser, stage, mirror or PSD, for dirt \
             and ambient light, and whether matrix and origin_um of [steering] are still correct"
        }
        () if of(Status::SIMULATED.0 | Status::REPLAYED.0) => "never control a machine with this pose",
        () if of(Status::POSE_HELD.0) => "treat the frame as having no pose",
        () if of(Status::RECORDING_FAULT.0) => {
            "check for a full or slow disk; trifacet ctl record status gives the reason"
        }
        () if of(Status::POWER_STEP.0) => {
            "check the stability of the laser, and whether something moves into the beam"
        }
        () if of(Status::CHANNEL_FROZEN.0) => {
            "the log names the channel: check the converter, its multiplexer and the firmware of the board"
        }
        () if of(Status::POWER_NOISY.0) => {
            "check for noise of laser and electronics, and, if the channels are not sampled at the same time, for \
             vibration"
        }
        () if of(Status::OUT_OF_CALIBRATION.0) => "move the mirror back, or calibrate over a larger range",
        () => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assessed(status: Status, lock: LockState) -> Assessment {
        let evidence = Evidence { status: Some(status), lock, ..Evidence::default() };
        evidence.assess(Vec::new(), |_| None)
    }

    #[test]
    fn only_a_pose_without_limits_is_good() {
        let good = assessed(Status::POSE_VALID | Status::STEERING_MEASURED, LockState::Locked);
        assert_eq!((good.grade, good.headline.as_str()), (Grade::Good, "Pose valid, beam locked"));
        for (bit, name) in Status::NAMES {
            let now = assessed(Status::POSE_VALID | *bit, LockState::Locked);
            let normal = [Status::POSE_VALID, Status::STEERING_MEASURED].contains(bit);
            assert_eq!(now.grade == Grade::Good, normal, "{name}: {now:?}");
            // Whatever is not usable for control is bad, apart from the marks of a twin and of a recording.
            let permitted = Status::SIMULATED | Status::REPLAYED;
            let usable = !Status::FATAL.has(*bit) && (Status::POSE_VALID | *bit).usable(permitted);
            assert_eq!(now.grade == Grade::Bad, !usable, "{name}: {now:?}");
            let noted = now.limitations.first().is_some_and(|first| first.remedy.is_empty());
            assert!(!noted, "{name} has no remedy");
        }
    }

    #[test]
    fn the_headline_names_the_cause_before_its_consequences() {
        let status = Status::PSD_A_LOW
            | Status::PSD_B_LOW
            | Status::NOT_LOCKED
            | Status::UNBALANCED
            | Status::UNCALIBRATED;
        let dark = assessed(status, LockState::Lost);
        assert_eq!(dark.headline, "No valid pose: too little light on PSD A, B");
        let names: Vec<_> = dark.limitations.iter().map(|l| (l.name.as_str(), l.consequence)).collect();
        assert_eq!(
            names,
            [
                ("PSD_A_LOW, PSD_B_LOW", false),
                ("UNCALIBRATED", false),
                ("NOT_LOCKED", true),
                ("UNBALANCED", true)
            ]
        );
        let evidence = Evidence {
            status: Some(Status::SOURCE_DOWN | Status::NOT_LOCKED),
            lock: LockState::Held,
            source_down: Some("cannot open /dev/ttyACM0"),
            ..Evidence::default()
        };
        let down = evidence.assess(Vec::new(), |_| Some("then".into()));
        assert_eq!(down.headline, "No valid pose: no samples: cannot open /dev/ttyACM0");
        assert_eq!(down.since.as_deref(), Some("then"));
    }

    #[test]
    fn each_kind_of_state_has_its_sentence() {
        let valid = Status::POSE_VALID;
        let text = |status, lock| assessed(status, lock).headline;
        assert_eq!(
            text(valid | Status::SIMULATED | Status::UNCALIBRATED, LockState::Locked),
            "Pose valid, beam locked; limited: not calibrated; simulated light"
        );
        assert_eq!(
            text(valid | Status::SAMPLE_GAP | Status::SIMULATED, LockState::Locked),
            "Pose valid, beam locked; limited: samples were lost just before this one"
        );
        assert_eq!(
            text(valid | Status::INCONSISTENT, LockState::Locked),
            "Pose not usable: the steering readback contradicts the pose"
        );
        assert_eq!(
            text(valid | Status::NOT_LOCKED | Status::SIMULATED, LockState::Held),
            "Pose valid, beam not locked: held"
        );
        assert_eq!(
            text(Status::UNCALIBRATED, LockState::Locked),
            "No valid pose: samples are missing in the averaged block"
        );
        let just_before = Evidence {
            status: Some(valid),
            lately: Status::PSD_A_LOW,
            lock: LockState::Locked,
            ..<_>::default()
        };
        let now = just_before.assess(Vec::new(), |_| None);
        assert_eq!(now.grade, Grade::Bad);
        assert_eq!(now.headline, "No valid pose just before: too little light on PSD A");
        let none = Evidence::default().assess(Vec::new(), |_| None);
        assert_eq!(
            (none.grade, none.headline.as_str()),
            (Grade::Bad, "No poses: no frame has been made yet")
        );
        let stalled = Evidence {
            status: Some(valid | Status::NOT_LOCKED),
            lock: LockState::Held,
            stalled: Some("task centering stalled"),
            ..<_>::default()
        };
        assert_eq!(
            stalled.assess(Vec::new(), |_| None).headline,
            "Pose valid, beam not locked (held): task centering stalled"
        );
    }
}
