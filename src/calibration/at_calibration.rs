//! What the drift of a head is judged by, as a fit found it.

use super::ParameterReport;
use crate::config::{AtCalibration, Config, SteeringResidual};

/// What shows a drift, as it was at the calibration. `residuals`: those of the steering at each point, without those of
/// scans, in which the beam is not on the apex; beam position by the nine signals less that by the readback, metres.
/// `config`: the one with which they were measured.
pub fn at_calibration(
    residuals: &[Option<[f64; 2]>],
    parameters: &[ParameterReport],
    config: &Config,
) -> AtCalibration {
    AtCalibration {
        steering: steering(residuals),
        power_gain_std_percent: power_gains(parameters).map(|relative| relative * 1e2),
        dark_v: config.channels.psds().map(|psd| psd.dark_v),
    }
}

fn steering(residuals: &[Option<[f64; 2]>]) -> Option<SteeringResidual> {
    let known: Vec<[f64; 2]> = residuals.iter().flatten().copied().collect();
    let n = known.len() as f64;
    let mean = |axis: usize| known.iter().map(|r| r[axis]).sum::<f64>() / n;
    let square = |axis: usize| known.iter().map(|r| (r[axis] - mean(axis)).powi(2)).sum::<f64>() / (n - 1.0);
    (known.len() > 1).then(|| SteeringResidual {
        mean_um: [0, 1].map(|axis| -mean(axis) * 1e6),
        std_um: [0, 1].map(|axis| square(axis).sqrt() * 1e6),
    })
}

/// Standard uncertainties of the power gains of B and C; NaN if the parameters do not contain them.
fn power_gains(parameters: &[ParameterReport]) -> [f64; 2] {
    ["psd_b.ln_power_gain", "psd_c.ln_power_gain"].map(|name| {
        parameters.iter().find(|parameter| parameter.name == name).map_or(f64::NAN, |found| found.posterior)
    })
}
