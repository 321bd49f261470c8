//! Faults of the twin, and their times.

use trifacet_wire::channel::SIGNALS;

use super::TwinError;
use crate::config::{Fault, FaultKind};

/// The bits of an id that a wrong acknowledgement changes: no command of the last weeks has that id.
const WRONG_ID: u32 = 0x8000_0000;

/// The fate of a scan on its way to the host.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Fate {
    /// The scan arrives.
    #[default]
    Sent,
    /// The scan is not sent.
    Dropped,
    /// The scan arrives damaged.
    Corrupted,
    /// The board sends nothing at all.
    Stalled,
}

/// What the board acknowledges, in the order of severity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Acks {
    /// The commands.
    #[default]
    Right,
    /// Other ids than those of the commands.
    Wrong,
    /// Nothing.
    Missing,
}

/// All faults, configured and injected.
#[derive(Clone, Debug, Default)]
pub struct Faults {
    list: Vec<Fault>,
}

/// The faults that are active at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Active {
    /// PSDs without light.
    pub dark: [bool; 3],
    /// Channels at their rail.
    pub clipped: [bool; SIGNALS.len()],
    /// Channels that repeat their last code.
    pub frozen: [bool; SIGNALS.len()],
    /// The readback of the stage repeats its last codes.
    pub readback_frozen: bool,
    /// The clock of the board runs at this rate, 1 without a fault.
    pub clock: f64,
    /// Fraction of the scans that is dropped.
    pub dropped: f64,
    /// Fraction of the scans that is damaged.
    pub corrupted: f64,
    /// The board sends nothing.
    pub stalled: bool,
    /// The board sends in bursts at this interval, seconds; 0: at once.
    pub burst_s: f64,
    /// What the board acknowledges.
    pub acks: Acks,
    /// The steering stage does not move.
    pub stuck: bool,
    /// The laser's power is multiplied by this.
    pub power: f64,
    /// Other light on each PSD, as a fraction of a third of the laser's nominal power.
    pub ambient: f64,
    /// The noise of spots and powers is multiplied by this.
    pub noise: f64,
    /// The laser is displaced by this, x and y, metres.
    pub shift: [f64; 2],
}

impl Faults {
    /// The faults of the configuration.
    ///
    /// # Errors
    /// A value of a fault is out of range; the error names its key.
    pub fn new(planned: &[Fault]) -> Result<Self, TwinError> {
        for (i, fault) in planned.iter().enumerate() {
            check(fault).map_err(|(key, reason)| TwinError::new(format!("twin.fault[{i}].{key}"), reason))?;
        }
        Ok(Self { list: planned.to_vec() })
    }

    /// Adds a fault at run time, and removes those that have ended.
    ///
    /// # Errors
    /// A value of the fault is out of range.
    pub fn inject(&mut self, fault: Fault) -> Result<(), TwinError> {
        check(&fault).map_err(|(key, reason)| TwinError::new(format!("fault.{key}"), reason))?;
        self.list.retain(|f| end(f) > fault.at_s);
        self.list.push(fault);
        Ok(())
    }

    /// The faults at `t_s` seconds.
    pub fn active(&self, t_s: f64) -> Active {
        let mut active = Active::default();
        for fault in self.list.iter().filter(|f| f.at_s <= t_s && t_s < end(f)) {
            active.add(fault.kind, t_s);
        }
        active
    }
}

impl Default for Active {
    fn default() -> Self {
        Self {
            dark: [false; 3],
            clipped: [false; SIGNALS.len()],
            frozen: [false; SIGNALS.len()],
            readback_frozen: false,
            clock: 1.0,
            dropped: 0.0,
            corrupted: 0.0,
            stalled: false,
            burst_s: 0.0,
            acks: Acks::Right,
            stuck: false,
            power: 1.0,
            ambient: 0.0,
            noise: 1.0,
            shift: [0.0; 2],
        }
    }
}

impl Active {
    /// The fate of one scan, from two random numbers from 0 to 1.
    pub fn fate(&self, drop: f64, corrupt: f64) -> Fate {
        match () {
            () if self.stalled => Fate::Stalled,
            () if drop < self.dropped => Fate::Dropped,
            () if corrupt < self.corrupted => Fate::Corrupted,
            () => Fate::Sent,
        }
    }

    /// The id that is acknowledged for a command with this id; `None`: no acknowledgement is sent.
    pub fn acknowledged(&self, id: u32) -> Option<u32> {
        match self.acks {
            Acks::Right => Some(id),
            Acks::Wrong => Some(id ^ WRONG_ID),
            Acks::Missing => None,
        }
    }

    fn add(&mut self, kind: FaultKind, t_s: f64) {
        match kind {
            FaultKind::BeamBlocked => self.dark = [true; 3],
            FaultKind::PsdDark { psd } => self.dark[usize::from(psd)] = true,
            FaultKind::Clipped { channel } => self.clipped[usize::from(channel)] = true,
            FaultKind::Frozen { channel } => self.frozen[usize::from(channel)] = true,
            FaultKind::ReadbackFrozen => self.readback_frozen = true,
            FaultKind::ClockRate { factor } => self.clock *= factor,
            FaultKind::Dropped { fraction } => self.dropped = either(self.dropped, fraction),
            FaultKind::Corrupted { fraction } => self.corrupted = either(self.corrupted, fraction),
            FaultKind::Stalled => self.stalled = true,
            FaultKind::Bursts { interval_ms } => self.burst_s = self.burst_s.max(interval_ms * 1e-3),
            FaultKind::MuteAcks => self.acks = Acks::Missing,
            FaultKind::WrongAcks => self.acks = self.acks.max(Acks::Wrong),
            FaultKind::SteeringStuck => self.stuck = true,
            FaultKind::LaserPower { factor } => self.power *= factor,
            FaultKind::Flicker { fraction, frequency_hz } => {
                self.power *= 1.0 + fraction * (std::f64::consts::TAU * frequency_hz * t_s).sin();
            }
            FaultKind::AmbientLight { fraction } => self.ambient += fraction,
            FaultKind::NoiseBurst { factor } => self.noise *= factor,
            FaultKind::LaserBump { shift_um: [x, y] } => {
                self.shift = [self.shift[0] + x * 1e-6, self.shift[1] + y * 1e-6];
            }
        }
    }
}

/// The probability of at least one of two independent events.
fn either(a: f64, b: f64) -> f64 {
    1.0 - (1.0 - a) * (1.0 - b)
}

fn end(fault: &Fault) -> f64 {
    fault.for_s.map_or(f64::INFINITY, |for_s| fault.at_s + for_s)
}

fn check(fault: &Fault) -> Result<(), (&'static str, &'static str)> {
    let within = |x: f64, max: f64| (0.0..=max).contains(&x);
    match fault.kind {
        _ if !fault.at_s.is_finite() => Err(("at_s", "must be a finite number of seconds")),
        _ if fault.for_s.is_some_and(|x| !within(x, f64::MAX)) => Err(("for_s", "must be 0 or more")),
        FaultKind::PsdDark { psd: 3.. } => Err(("psd", "must be 0, 1 or 2 (A, B, C)")),
        FaultKind::Clipped { channel: 9.. } | FaultKind::Frozen { channel: 9.. } => {
            Err(("channel", "must be 0 to 8"))
        }
        FaultKind::Dropped { fraction }
        | FaultKind::Corrupted { fraction }
        | FaultKind::Flicker { fraction, .. }
        | FaultKind::AmbientLight { fraction }
            if !within(fraction, 1.0) =>
        {
            Err(("fraction", "must be from 0 to 1"))
        }
        FaultKind::Flicker { frequency_hz, .. } if !within(frequency_hz, f64::MAX) => {
            Err(("frequency_hz", "must be a finite number, 0 or more"))
        }
        FaultKind::LaserPower { factor }
        | FaultKind::NoiseBurst { factor }
        | FaultKind::ClockRate { factor }
            if !within(factor, f64::MAX) =>
        {
            Err(("factor", "must be a finite number, 0 or more"))
        }
        FaultKind::Bursts { interval_ms } if !within(interval_ms, f64::MAX) => {
            Err(("interval_ms", "must be a finite number, 0 or more"))
        }
        FaultKind::LaserBump { shift_um } if !shift_um.iter().all(|um| um.is_finite()) => {
            Err(("shift_um", "must be two finite numbers"))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(at_s: f64, for_s: Option<f64>, kind: FaultKind) -> Fault {
        Fault { at_s, for_s, kind }
    }

    #[test]
    fn faults_come_and_go_and_combine() {
        let faults = Faults::new(&[
            fault(1.0, Some(1.0), FaultKind::LaserPower { factor: 0.5 }),
            fault(1.5, None, FaultKind::LaserPower { factor: 0.5 }),
            fault(1.0, Some(1.0), FaultKind::Dropped { fraction: 0.5 }),
            fault(1.0, Some(1.0), FaultKind::Dropped { fraction: 0.5 }),
            fault(1.0, Some(1.0), FaultKind::PsdDark { psd: 2 }),
        ])
        .unwrap();
        assert_eq!(faults.active(0.999), Active::default());
        let middle = faults.active(1.5);
        assert_eq!((middle.power, middle.dropped, middle.dark), (0.25, 0.75, [false, false, true]));
        assert_eq!(faults.active(2.0), Active { power: 0.5, ..Active::default() });
    }

    #[test]
    fn injected_faults_start_at_the_order_and_old_ones_are_dropped() {
        let mut faults = Faults::default();
        for k in 0..1000 {
            faults.inject(fault(f64::from(k), Some(0.5), FaultKind::Stalled)).unwrap();
        }
        assert_eq!(faults.list.len(), 1);
        assert!(faults.active(999.2).stalled && !faults.active(999.5).stalled);
    }

    #[test]
    fn the_most_severe_fault_of_the_link_applies() {
        let all = Active { stalled: true, dropped: 1.0, corrupted: 1.0, ..Active::default() };
        assert_eq!(all.fate(0.0, 0.0), Fate::Stalled);
        assert_eq!(Active { stalled: false, ..all }.fate(0.999, 0.0), Fate::Dropped);
        assert_eq!(Active { stalled: false, dropped: 0.0, ..all }.fate(0.0, 0.999), Fate::Corrupted);
        assert_eq!(Active::default().fate(0.0, 0.0), Fate::Sent);
    }

    #[test]
    fn impossible_faults_are_refused_by_key() {
        for (kind, key) in [
            (FaultKind::PsdDark { psd: 3 }, "psd"),
            (FaultKind::Clipped { channel: 9 }, "channel"),
            (FaultKind::Dropped { fraction: 1.1 }, "fraction"),
            (FaultKind::Corrupted { fraction: f64::NAN }, "fraction"),
            (FaultKind::LaserPower { factor: -1.0 }, "factor"),
            (FaultKind::NoiseBurst { factor: f64::INFINITY }, "factor"),
            (FaultKind::AmbientLight { fraction: -0.1 }, "fraction"),
            (FaultKind::Flicker { fraction: 1.5, frequency_hz: 100.0 }, "fraction"),
            (FaultKind::Flicker { fraction: 0.5, frequency_hz: f64::NAN }, "frequency_hz"),
            (FaultKind::Bursts { interval_ms: f64::NAN }, "interval_ms"),
            (FaultKind::LaserBump { shift_um: [0.0, f64::NAN] }, "shift_um"),
        ] {
            let error = Faults::new(&[fault(0.0, None, kind)]).unwrap_err();
            assert_eq!(error.key, format!("twin.fault[0].{key}"));
        }
        assert!(Faults::new(&[fault(0.0, Some(-1.0), FaultKind::Stalled)]).is_err());
    }
}
