//! `[[twin.motion]]`: movements of the mirror of the twin.

use serde::{Deserialize, Serialize};

use super::check::Checker;

/// An axis of the mirror.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Axis {
    /// Translation along x.
    Tx,
    /// Translation along y.
    Ty,
    /// Translation along z.
    Tz,
    /// Rotation about x.
    Roll,
    /// Rotation about y.
    Pitch,
    /// Rotation about z.
    Yaw,
}

impl Axis {
    /// All axes, in the order of a pose.
    pub const ALL: [Axis; 6] = [Axis::Tx, Axis::Ty, Axis::Tz, Axis::Roll, Axis::Pitch, Axis::Yaw];

    /// The name, as in the configuration file.
    pub fn name(self) -> &'static str {
        match self {
            Axis::Tx => "tx",
            Axis::Ty => "ty",
            Axis::Tz => "tz",
            Axis::Roll => "roll",
            Axis::Pitch => "pitch",
            Axis::Yaw => "yaw",
        }
    }

    /// The unit in which amounts are shown: a millionth of the SI unit.
    pub fn micro_unit(self) -> &'static str {
        if self.is_turn() { "urad" } else { "um" }
    }

    /// Whether amounts of this axis are angles.
    pub fn is_turn(self) -> bool {
        matches!(self, Axis::Roll | Axis::Pitch | Axis::Yaw)
    }
}

/// An entry of `[[twin.motion]]`: one movement of one axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Motion {
    /// The axis.
    pub axis: Axis,
    /// Amount of a translation, micrometres; for a vibration the rms.
    pub amount_um: Option<f64>,
    /// Amount of a rotation, microradians; for a vibration the rms.
    pub amount_urad: Option<f64>,
    /// Kind of the movement.
    pub kind: MotionKind,
    /// Start time, seconds; 0 if absent.
    #[serde(default)]
    pub from_s: f64,
    /// End time, seconds; no end if absent. A ramp covers its amount in that time and stays there.
    pub until_s: Option<f64>,
    /// Frequency of a sine, or lowest frequency of a vibration, Hz.
    pub frequency_hz: Option<f64>,
    /// Highest frequency of a vibration, Hz.
    pub high_hz: Option<f64>,
    /// Phase of a sine at its start, degrees.
    #[serde(default)]
    pub phase_deg: f64,
}

/// Kind of a movement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MotionKind {
    /// A step at `from_s`, which lasts until `until_s`. With the default times it is a constant offset.
    Step,
    /// A constant velocity from `from_s` to `until_s`.
    Ramp,
    /// A sine between the two times.
    Sine,
    /// Band-limited noise between the two times.
    Vibration,
}

impl MotionKind {
    fn name(self) -> &'static str {
        match self {
            MotionKind::Step => "a step",
            MotionKind::Ramp => "a ramp",
            MotionKind::Sine => "a sine",
            MotionKind::Vibration => "a vibration",
        }
    }

    fn needs(self) -> String {
        format!("a number: {} needs it", self.name())
    }

    fn has_no(self) -> String {
        format!("absent: {} has no such key", self.name())
    }
}

impl Motion {
    pub(super) fn check(&self, mut at: Checker<'_>, rate_hz: f64) {
        at.optional("amount_um", self.amount_um, -10_000.0..=10_000.0);
        at.optional("amount_urad", self.amount_urad, -100_000.0..=100_000.0);
        at.number("from_s", self.from_s, 0.0..=1e6);
        at.optional("until_s", self.until_s, 0.0..=1e6);
        at.optional("frequency_hz", self.frequency_hz, 0.0001..=10_000.0);
        at.optional("high_hz", self.high_hz, 0.0001..=10_000.0);
        at.number("phase_deg", self.phase_deg, -360.0..=360.0);
        self.check_keys(&mut at);
        let order = self.until_s.is_none_or(|until| until > self.from_s);
        at.demand(order, "until_s", found(self.until_s), format_args!("later than from_s, {}", self.from_s));
        if self.kind == MotionKind::Vibration {
            self.check_band(&mut at, rate_hz);
        }
    }

    /// Checks that each axis and each kind has the keys it requires, and no key that would be ignored.
    fn check_keys(&self, at: &mut Checker<'_>) {
        let (amount, key, other, other_key) = if self.axis.is_turn() {
            (self.amount_urad, "amount_urad", self.amount_um, "amount_um")
        } else {
            (self.amount_um, "amount_um", self.amount_urad, "amount_urad")
        };
        let axis = if self.axis.is_turn() { "a rotation" } else { "a translation" };
        at.demand(amount.is_some(), key, "absent", format_args!("a number: {axis} needs it"));
        at.demand(other.is_none(), other_key, found(other), format_args!("absent: {axis} has {key}"));

        let kind = self.kind;
        let sine = kind == MotionKind::Sine;
        let vibration = kind == MotionKind::Vibration;
        at.demand(self.until_s.is_some() || kind != MotionKind::Ramp, "until_s", "absent", kind.needs());
        for (key, value, wanted) in
            [("frequency_hz", self.frequency_hz, sine || vibration), ("high_hz", self.high_hz, vibration)]
        {
            let allowed = if wanted { kind.needs() } else { kind.has_no() };
            at.demand(value.is_some() == wanted, key, found(value), allowed);
        }
        at.demand(self.phase_deg == 0.0 || sine, "phase_deg", found(Some(self.phase_deg)), kind.has_no());
    }

    fn check_band(&self, at: &mut Checker<'_>, rate_hz: f64) {
        let (Some(low), Some(high)) = (self.frequency_hz, self.high_hz) else { return };
        at.demand(high > low, "high_hz", high, format_args!("more than frequency_hz, {low}"));
        let most = rate_hz / 2.0;
        let allowed = format!("below half of acquisition.rate_hz, {most}");
        at.demand(high < most || !most.is_finite(), "high_hz", high, allowed);
        let rms = self.amount_um.or(self.amount_urad).unwrap_or(0.0);
        let key = if self.axis.is_turn() { "amount_urad" } else { "amount_um" };
        at.demand(rms >= 0.0 || rms.is_nan(), key, rms, "0 or more: it is the rms of a vibration");
    }
}

fn found(value: Option<f64>) -> String {
    value.map_or("absent".into(), |value| format!("{value:?}"))
}
