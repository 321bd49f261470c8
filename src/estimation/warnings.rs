//! Warnings about the steering position and the light, logged once per change.

use trifacet_core::estimation::PoseReport;
use trifacet_core::estimation::integrity::MeanResidual;
use trifacet_core::signals::{Identity, Sample};
use trifacet_core::time::{Mono, NS_PER_S};
use trifacet_wire::Status;
use trifacet_wire::channel::Role;

use super::drift::DriftWatch;
use super::light::LightWatch;
use crate::config::CalibrationContext;
use crate::doubts::{Doubter, Subject};

/// A contradiction is over after this time without one: near the limit it comes and goes.
const CALM_NS: i64 = NS_PER_S / 2;

/// Watches samples and reports.
#[derive(Debug)]
pub struct Warnings {
    doubter: Doubter,
    light: LightWatch,
    drift: Option<DriftWatch>,
    no_readback: bool,
    /// Time of the last contradiction, while it is doubted.
    contradicted: Option<Mono>,
}

impl Warnings {
    /// Without a source.
    pub fn new(context: &CalibrationContext, doubter: Doubter) -> Self {
        let (light, drift) = (LightWatch::new(&context.config), DriftWatch::new(context));
        Self { doubter, light, drift, no_readback: false, contradicted: None }
    }

    /// A source is up.
    pub fn source(&mut self, identity: &Identity, fuses: bool) {
        self.light.source();
        self.drift.iter_mut().for_each(DriftWatch::source);
        self.no_readback = ![0, 1].iter().all(|axis| identity.roles.contains(&Role::Steering(*axis)));
        self.fusion(fuses);
    }

    /// The settings have changed.
    pub fn retune(&mut self, context: &CalibrationContext, fuses: bool) {
        self.light.retune(&context.config, &self.doubter);
        DriftWatch::retune(&mut self.drift, context, &self.doubter);
        self.fusion(fuses);
    }

    /// Takes every sample.
    pub fn sample(&mut self, sample: &Sample) {
        if let (Some(dark), Some(drift)) = (self.light.sample(sample, &self.doubter), &mut self.drift) {
            drift.dark(&dark, sample.time, &self.doubter);
        }
    }

    fn fusion(&self, fuses: bool) {
        if fuses && self.no_readback {
            tracing::warn!(
                "estimation.fuse_steering: the source has no steering readback, so there is nothing to fuse"
            );
        }
    }

    /// Takes every report. One without a residual does not change the doubt.
    pub fn report(&mut self, report: &PoseReport) {
        self.doubter.residual.set(report);
        if let Some(drift) = &mut self.drift {
            drift.report(report, &self.doubter);
        }
        let Some(residual) = report.steering_residual else { return };
        if !report.status.has(Status::INCONSISTENT) {
            if self.contradicted.take_if(|last| report.time - *last > CALM_NS).is_some() {
                self.doubter.end(Subject::Residual);
            }
            return;
        }
        if self.contradicted.replace(report.time).is_none() {
            let mean = report.mean_residual.filter(|mean| mean.contradicts);
            let text = mean.map_or_else(|| contradiction(residual), |mean| constant_contradiction(&mean));
            self.doubter.begin(Subject::Residual, report.time, text);
        }
    }
}

fn contradiction(residual: f64) -> String {
    format!(
        "steering and pose contradict each other by {:.1} um in ten reports: was the laser or the stage bumped?",
        residual * 1e6
    )
}

fn constant_contradiction(MeanResidual { mean, limit, .. }: &MeanResidual) -> String {
    let [x, y] = mean.map(|metres| metres * 1e6);
    format!(
        "steering and pose contradict each other constantly: the mean residual is {x:.2}, {y:.2} um (x, y), its \
         limit is {:.2} um. Possible causes: ambient light, a PSD or mirror that is displaced or dirty, a displaced \
         laser, or a drift of the laser beyond steering.pointing_um",
        limit * 1e6
    )
}
