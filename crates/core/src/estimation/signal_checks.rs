//! Checks of the signals: whether a pose can be computed, and which status bits apply.

use trifacet_optics::{Noise, SolveError};
use trifacet_wire::Status;

use super::Settings;
use super::block::Mean;
use super::power_step::Power;
use crate::signals::PsdState;

/// A power of fewer standard uncertainties than this gives no pose: it is not known to a fifth of itself, and
/// the linear propagation of uncertainties does not hold. The live uncertainty is from second differences, in
/// which a fast vibration also counts.
const KNOWN: f64 = 5.0;

const LOW: [Status; 3] = [Status::PSD_A_LOW, Status::PSD_B_LOW, Status::PSD_C_LOW];
const CLIPPED: [Status; 3] = [Status::PSD_A_CLIPPED, Status::PSD_B_CLIPPED, Status::PSD_C_CLIPPED];
const EDGE: [Status; 3] = [Status::PSD_A_EDGE, Status::PSD_B_EDGE, Status::PSD_C_EDGE];

/// Sets the status bits of the signals; returns true if no pose can be computed.
pub(super) fn judge(settings: &Settings, mean: &Mean, noise: &Noise, status: &mut Status) -> bool {
    let sample = &mean.sample;
    let frozen = sample.psds.contains(&PsdState::Frozen);
    status.set(Status::CHANNEL_FROZEN, frozen);
    let step = mean.power == Power::Step;
    status.set(Status::POWER_STEP, step);
    let mut noisy = false;
    let mut fatal = frozen || step;
    for i in 0..3 {
        let clipped = sample.psds[i] == PsdState::Clipped;
        let low = sample.psds[i] == PsdState::Low;
        noisy |= sample.psds[i] == PsdState::Good && sample.powers[i] < KNOWN * noise.powers[i];
        status.set(CLIPPED[i], clipped);
        status.set(LOW[i], low);
        let edge = settings.estimator.optics().half_sizes()[i] - settings.edge_margin;
        let spot = &sample.spots[2 * i..2 * i + 2];
        status.set(EDGE[i], spot.iter().any(|s| s.abs() > edge)); // not if it is NaN
        fatal |= clipped || low;
    }
    status.set(Status::POWER_NOISY, noisy);
    let total: f64 = sample.powers.iter().sum();
    let balanced = |p: &f64| (p / total - 1.0 / 3.0).abs() <= settings.balance_limit && total > 0.0;
    status.set(Status::UNBALANCED, !sample.powers.iter().all(balanced));
    fatal || noisy
}

/// The status bit for an error of the solver.
pub(super) fn reason(error: &SolveError) -> Status {
    match error {
        SolveError::OffPsd { .. } | SolveError::OutOfRange { .. } => Status::OUT_OF_RANGE,
        SolveError::Dark { psd: 'A', .. } => LOW[0],
        SolveError::Dark { psd: 'B', .. } => LOW[1],
        SolveError::Dark { .. } => LOW[2],
        SolveError::NotFinite { .. } | SolveError::Singular { .. } | SolveError::NotConverged { .. } => {
            Status::NOT_CONVERGED
        }
    }
}
