//! The steering outputs of a board: which commands it accepts, and what it does when a lease expires.

use trifacet_core::time::Mono;
use trifacet_wire::actuator::{LeaseAction, OutputCommand};

use crate::config::SteeringConfig;

/// Resolution of the steering outputs in bits, sign included.
pub const OUTPUT_BITS: u8 = 16;

/// The output code of full scale; the largest code is one less.
const FULL_SCALE: i32 = 1 << (OUTPUT_BITS - 1);

/// Two steering outputs with the lease of their last command.
#[derive(Clone, Debug)]
pub struct Outputs {
    /// Metres per code.
    step: f64,
    park: [i32; 2],
    lease: Option<(Mono, LeaseAction)>,
}

impl Outputs {
    /// Outputs at rest, without a lease.
    pub fn new(steering: &SteeringConfig) -> Self {
        let step_um = steering.full_scale_um / f64::from(FULL_SCALE);
        let code =
            |um: f64| (um / step_um).round().clamp(f64::from(-FULL_SCALE), f64::from(FULL_SCALE - 1)) as i32;
        Self { step: step_um * 1e-6, park: steering.park_um.map(code), lease: None }
    }

    /// The position for these codes, metres.
    pub fn metres(&self, codes: [i32; 2]) -> [f64; 2] {
        codes.map(|code| f64::from(code) * self.step)
    }

    /// Whether the board accepts this command; its codes must be within the range of the outputs. A rejected
    /// command changes nothing, the lease included.
    #[must_use]
    pub fn take(&mut self, command: &OutputCommand, now: Mono) -> bool {
        let accepted = Self::in_range(command.codes);
        if accepted {
            self.lease = Some((now + i64::from(command.lease_ms) * 1_000_000, command.on_expiry));
        }
        accepted
    }

    /// Ends a lease without its action.
    pub fn clear_lease(&mut self) {
        self.lease = None;
    }

    /// Sets the parking position, in codes within the range.
    pub fn set_park(&mut self, park: [i32; 2]) {
        self.park = park;
    }

    /// Whether the codes are within the range of the outputs.
    pub fn in_range(codes: [i32; 2]) -> bool {
        codes.iter().all(|code| (-FULL_SCALE..FULL_SCALE).contains(code))
    }

    /// Reports once that the lease of the last command has expired, and the action: the outputs stay, or move
    /// to [`Outputs::park`].
    #[must_use]
    pub fn expire(&mut self, now: Mono) -> Option<LeaseAction> {
        self.lease.take_if(|(end, _)| *end <= now).map(|(_, on_expiry)| on_expiry)
    }

    /// The codes of the parking position.
    pub fn park(&self) -> [i32; 2] {
        self.park
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    fn command(codes: [i32; 2], on_expiry: LeaseAction) -> OutputCommand {
        OutputCommand { id: 1, codes, lease_ms: 200, on_expiry }
    }

    fn outputs() -> Outputs {
        Outputs::new(&SteeringConfig { park_um: [100.0, -100.0], ..SteeringConfig::default() })
    }

    #[test]
    fn a_lease_runs_out_once() {
        let mut parking = outputs();
        assert!(parking.take(&command([5, 6], LeaseAction::Park), Mono(0)));
        assert!(parking.take(&command([5, 6], LeaseAction::Park), Mono(150 * MS)));
        assert_eq!(parking.expire(Mono(349 * MS)), None);
        assert_eq!(parking.expire(Mono(350 * MS)), Some(LeaseAction::Park));
        assert_eq!(parking.park(), [6554, -6554]);
        assert_eq!(parking.expire(Mono(900 * MS)), None);
        let mut holding = outputs();
        assert!(holding.take(&command([5, 6], LeaseAction::Hold), Mono(0)));
        assert_eq!(holding.expire(Mono(900 * MS)), Some(LeaseAction::Hold));
    }

    #[test]
    fn codes_outside_the_range_are_refused_and_do_not_renew_the_lease() {
        let mut outputs = outputs();
        assert!(outputs.take(&command([-32768, 32767], LeaseAction::Park), Mono(0)));
        assert!(!outputs.take(&command([0, 32768], LeaseAction::Park), Mono(150 * MS)));
        assert!(!outputs.take(&command([-32769, 0], LeaseAction::Park), Mono(150 * MS)));
        assert!(outputs.expire(Mono(200 * MS)).is_some());
    }

    #[test]
    fn full_scale_is_the_configured_length() {
        let [x, y] = outputs().metres([-32768, 16384]);
        assert!((x + 500e-6).abs() < 1e-18 && (y - 250e-6).abs() < 1e-18);
    }
}
