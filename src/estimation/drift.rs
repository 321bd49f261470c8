//! The drift of the head since its calibration: steering residual, power gains and dark readings against the record.

use nalgebra::Matrix2;
use trifacet_core::calibration_drift::{DriftCheck, ResidualDrift, ResidualReference};
use trifacet_core::estimation::PoseReport;
use trifacet_core::light_checks::{DARK_LEAST, DarkVerdict};
use trifacet_core::time::Mono;
use trifacet_optics::{Estimator, FACETS, Model, Optics, Pose, Signals, Vec2};

use crate::config::{
    AtCalibration, CalibrationContext, ChannelsConfig, RecordHeader, Standing, SteeringConfig,
};
use crate::doubts::{Doubter, Subject};

/// Number of standard uncertainties beyond which a dark reading is doubted.
const COVERAGE: f64 = 3.0;
/// A doubt ends below this part of its limit.
const AGAIN: f64 = 0.8;
/// Change of a power by which its effect on the beam position is computed.
const CHANGE: f64 = 0.01;

/// Compares the head with the record of its calibration. The names and the parts of a difference are for people; the
/// limits follow from the uncertainties that record and configuration state.
#[derive(Debug)]
pub struct DriftWatch {
    settings: Settings,
    check: Option<DriftCheck>,
    /// Relative changes of the power gains of B and C that explain a residual along x, along y; 1/m.
    gains_by_residual: Option<Matrix2<f64>>,
    dark_doubted: bool,
}

/// What the watch depends on.
#[derive(Clone, Debug, PartialEq)]
struct Settings {
    record: RecordHeader,
    at: AtCalibration,
    steering: SteeringConfig,
    channels: ChannelsConfig,
    power_noise: f64,
}

impl DriftWatch {
    /// The watch of this context; `None` without a record of this head that states what to compare with. An expired one
    /// serves as well.
    pub fn new(context: &CalibrationContext) -> Option<Self> {
        let settings = Settings::of(context)?;
        let optics = context.config.optics().ok();
        let gains_by_residual = optics.and_then(|optics| beam_by_gains(optics)?.try_inverse()).map(|m| -m);
        let check = settings.residual().map(DriftCheck::new);
        Some(Self { settings, check, gains_by_residual, dark_doubted: false })
    }

    /// Other settings. What they have changed is judged again.
    pub fn retune(watch: &mut Option<Self>, context: &CalibrationContext, doubter: &Doubter) {
        if watch.as_ref().map(|watch| &watch.settings) == Settings::of(context).as_ref() {
            return;
        }
        *watch = Self::new(context);
        doubter.drift.set_residual(None, None, None);
        doubter.drift.set_dark(None);
        if watch.as_ref().is_none_or(|watch| watch.check.is_none()) {
            doubter.end(Subject::CalibrationDrift);
        }
        doubter.end(Subject::DarkDrift); // until the next time without light
    }

    /// Another source: its residuals do not continue those before.
    pub fn source(&mut self) {
        self.check = self.settings.residual().map(DriftCheck::new);
    }

    /// Takes every report.
    pub fn report(&mut self, report: &PoseReport, doubter: &Doubter) {
        let Some(drift) = self.check.as_mut().and_then(|check| check.push(report)) else { return };
        let gains = self.gains_by_residual.map(|by| <[f64; 2]>::from(by * Vec2::from(drift.difference)));
        doubter.drift.set_residual(Some(drift.difference), Some(drift.limit), gains);
        let text = drift.doubted.then(|| self.residual_text(&drift, gains));
        doubter.set(Subject::CalibrationDrift, report.time, text);
    }

    fn residual_text(&self, drift: &ResidualDrift, gains: Option<[f64; 2]>) -> String {
        let [x, y] = drift.difference.map(|metres| metres * 1e6);
        let day = self.settings.record.day();
        let [known_b, known_c] = self.settings.at.power_gain_std_percent;
        let gains = gains.map_or_else(String::new, |[b, c]| {
            format!(
                ", or power gains that changed by {:+.2} % (B) and {:+.2} % (C) against A, which were calibrated to \
                 {known_b:.2} % and {known_c:.2} %",
                b * 1e2,
                c * 1e2
            )
        });
        format!(
            "the head has drifted since its calibration of {day}: the mean steering residual has changed by {x:.2}, \
             {y:.2} um (x, y), and the stated uncertainties allow {:.2} um. Possible causes: a laser that points \
             elsewhere, a PSD or mirror that is displaced or dirty, temperature, gains of a PSD{gains}. Poses are less \
             accurate than they state. Calibrate again, or remove the cause",
            drift.limit * 1e6
        )
    }

    /// Takes the result of a time without light. A dark reading beyond its offset acts as a power gain that is wrong by
    /// the same part.
    pub fn dark(&mut self, verdict: &DarkVerdict, now: Mono, doubter: &Doubter) {
        let Settings { at, channels, power_noise, .. } = &self.settings;
        let moved: [f64; 3] = std::array::from_fn(|psd| {
            let volts = channels.psds()[psd].dark_v[2] - at.dark_v[psd][2];
            volts * channels.power_mw_per_v * 1e-3 / verdict.usual[psd]
        });
        let since: [f64; 3] = std::array::from_fn(|psd| verdict.excess[psd] + moved[psd]);
        doubter.drift.set_dark(Some(since));
        let [b, c] = at.power_gain_std_percent.map(|percent| percent * 1e-2);
        let noise = power_noise / f64::from(DARK_LEAST).sqrt();
        let limit = COVERAGE * b.max(c).hypot(noise);
        let worst = verdict.excess.iter().fold(0.0_f64, |worst, part| worst.max(part.abs()));
        self.dark_doubted = worst > limit * if self.dark_doubted { AGAIN } else { 1.0 };
        let text =
            self.dark_doubted.then(|| dark_text(self.settings.record.day(), since, &verdict.excess, limit));
        doubter.set(Subject::DarkDrift, now, text);
    }
}

fn dark_text(day: &str, since: [f64; 3], excess: &[f64; 3], limit: f64) -> String {
    let list = |parts: &[f64; 3]| {
        let each = FACETS.iter().zip(parts).map(|(psd, part)| format!("{psd} {:+.2} %", part * 1e2));
        each.collect::<Vec<_>>().join(", ")
    };
    format!(
        "the dark readings have drifted since the calibration of {day}: without light the sums read {} of their usual \
         power, compared with those of the calibration, and {} compared with the configured dark offsets. The calibrated \
         power gains allow {:.2} %. Run trifacet dark, or screen the head",
        list(&since),
        list(excess),
        limit * 1e2
    )
}

impl Settings {
    fn of(context: &CalibrationContext) -> Option<Self> {
        let CalibrationContext { config, calibration, .. } = context;
        let belongs = matches!(calibration.standing, Standing::Valid | Standing::Expired);
        let record = calibration.record.clone().filter(|_| belongs)?;
        let at = record.at_calibration.clone()?;
        let (steering, channels) = (config.steering.clone(), config.channels.clone());
        Some(Self { record, at, steering, channels, power_noise: config.estimation.power_noise })
    }

    /// The residual of the record. Its uncertainty: the scatter of the points, which contains the pointing during the
    /// calibration, and that of the calibrated poses.
    fn residual(&self) -> Option<ResidualReference> {
        let at = self.at.steering?;
        let largest = |numbers: &[f64]| numbers.iter().copied().fold(0.0, f64::max);
        let sigma = largest(&at.std_um).hypot(largest(&self.record.std_um)) * 1e-6;
        Some(ResidualReference { mean: at.mean_um.map(|um| um * 1e-6), sigma })
    }
}

/// Displacement of the computed beam position (rows x, y) per relative change of the power gain of B, of C (columns),
/// with the mirror at rest and the beam on the apex; metres.
fn beam_by_gains(optics: Optics) -> Option<Matrix2<f64>> {
    let reading = optics.trace(Model::Gaussian, &Pose::default(), Vec2::zeros()).ok()?;
    let estimator = Estimator::new(optics, Model::Gaussian);
    let beam = |powers: [f64; 3]| {
        let solution = estimator.solve(&Signals { spots: reading.spots, powers }, None).ok()?;
        Some(estimator.optics().across(solution.pose.t) + solution.offset)
    };
    let changed = |psd: usize, by: f64| {
        let mut powers = reading.powers;
        powers[psd] *= 1.0 + by;
        beam(powers)
    };
    let column = |psd| Some((changed(psd, CHANGE)? - changed(psd, -CHANGE)?) / (2.0 * CHANGE));
    Some(Matrix2::from_columns(&[column(1)?, column(2)?]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    #[test]
    fn the_gains_that_explain_a_residual_are_those_that_cause_it() {
        let optics = Config::default().optics().unwrap();
        let reading = optics.trace(Model::Gaussian, &Pose::default(), Vec2::zeros()).unwrap();
        let (gains, estimator) = ([0.02, -0.01], Estimator::new(optics.clone(), Model::Gaussian));
        let [a, b, c] = reading.powers;
        let powers = [a, b * (1.0 + gains[0]), c * (1.0 + gains[1])];
        let solution = estimator.solve(&Signals { spots: reading.spots, powers }, None).unwrap();
        // The readback says that the beam is on the apex at rest.
        let residual = -(optics.across(solution.pose.t) + solution.offset);
        assert!(residual.norm() > 1e-6);
        let by_residual = -beam_by_gains(optics).unwrap().try_inverse().unwrap();
        let found = by_residual * residual;
        assert!((found.x - gains[0]).abs() < 4e-4 && (found.y - gains[1]).abs() < 4e-4, "{found}");
    }
}
