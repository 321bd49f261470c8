//! Times without samples during a measurement. A step during such a time is repeated.

use trifacet_wire::actuator::LeaseAction;

use super::observation::Observation;
use super::plan::Settings;
use crate::exit::{self, Failure};

/// Largest number of attempts at one step.
const ATTEMPTS: u32 = 5;

/// The times without samples so far.
#[derive(Debug, Default)]
pub(super) struct Gaps {
    count: u32,
    repeats: u32,
}

impl Gaps {
    /// Records that samples have stopped.
    pub(super) fn add(&mut self) {
        self.count += 1;
    }

    /// Number of times without samples.
    pub(super) fn count(&self) -> u32 {
        self.count
    }

    /// Number of steps that were repeated.
    pub(super) fn repeats(&self) -> u32 {
        self.repeats
    }

    /// Records that a step is repeated after this many attempts.
    ///
    /// # Errors
    /// [`exit::UNAVAILABLE`] if these were too many.
    pub(super) fn repeat(&mut self, attempts: u32) -> Result<(), Failure> {
        self.repeats += 1;
        if attempts < ATTEMPTS {
            return Ok(());
        }
        Err(Failure::new(
            exit::UNAVAILABLE,
            format!(
                "samples stopped during each of {ATTEMPTS} attempts at one step, {} times in all: the link to the \
                 board must deliver samples without pauses of acquisition.silence_ms",
                self.count
            ),
        ))
    }
}

/// Checks that a stage that parks is still where it was commanded: the lease has not expired between the last
/// observation and `look`.
///
/// # Errors
/// [`exit::UNAVAILABLE`] if the board has parked the stage.
pub(super) fn check_lease(
    last: Option<&Observation>,
    look: &Observation,
    settings: &Settings,
) -> Result<(), Failure> {
    let Settings { lease_ms, on_expiry, .. } = *settings;
    let gap_s = last.map_or(0.0, |last| look.time.seconds_since(last.time));
    if on_expiry == LeaseAction::Hold || gap_s < f64::from(lease_ms) * 1e-3 {
        return Ok(());
    }
    let gap_ms = gap_s * 1e3;
    Err(Failure::new(
        exit::UNAVAILABLE,
        format!(
            "no samples for {gap_ms:.0} ms, longer than steering.lease_ms, {lease_ms}: the board has parked the stage"
        ),
    ))
}
