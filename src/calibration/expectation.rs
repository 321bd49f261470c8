//! What a calibration can reach, before a single reading: the fit of the readings that the head as drawn would give.
//!
//! The uncertainty of a fit depends on the poses and on the noise, hardly on the readings themselves.

use trifacet_core::steering::{BeamOffset, BeamPoint};
use trifacet_optics::calibration::fit::{FIRST_FIELD, Job, fit};
use trifacet_optics::calibration::parameters::Tolerances;
use trifacet_optics::calibration::plan::Planned;
use trifacet_optics::calibration::point::{Known, Point};
use trifacet_optics::calibration::result::RangeUncertainty;
use trifacet_optics::{Model, Pose, Vec2};

use super::effort::ReferenceNoise;
use super::nominal;
use super::scan_pattern::{HALF, square};
use crate::config::Config;

/// Standard uncertainty of the readback of the steering, as `calibrate fit` takes it by default, metres.
const READBACK: f64 = 0.1e-6;
/// Number of poses over which the uncertainty is averaged.
const POSES: usize = 200;

/// The expected uncertainty over `range` (metres, radians) after a run with these poses, one scan of the steering, and
/// the built-in tolerances of the head.
///
/// # Errors
/// The poses do not determine a fit; the message says why.
pub fn expectation(
    config: &Config,
    poses: &[Planned],
    reference: ReferenceNoise,
    range: [f64; 2],
) -> Result<RangeUncertainty, String> {
    let nominal = nominal(config).map_err(|e| e.to_string())?;
    let reading = Readings { config, samples: f64::from(reference.samples(config)), reference };
    let on_apex = poses.iter().filter_map(|planned| reading.point(&planned.pose, BeamOffset::default()));
    let scan = square(HALF).filter_map(|offset| reading.point(&Pose::default(), offset));
    let points: Vec<Point> = on_apex.chain(scan.map(|point| point.of_scan(0))).collect();
    let (tolerances, fields) = (Tolerances::default(), [FIRST_FIELD]);
    let job = Job { nominal: &nominal, tolerances: &tolerances, points: &points, fields: &fields };
    let fitted = fit(job, |_| {}).map_err(|e| e.to_string())?;
    let [metres, radians] = range;
    let uncertainty = fitted.calibration.range_uncertainty(metres, radians, POSES);
    uncertainty.ok_or_else(|| "the tare pose has no reading".to_owned())
}

/// The readings of the head as drawn.
struct Readings<'a> {
    config: &'a Config,
    /// Samples of each reading.
    samples: f64,
    reference: ReferenceNoise,
}

impl Readings<'_> {
    /// The reading at a pose; `None` if a PSD gets no light.
    fn point(&self, pose: &Pose, offset: BeamOffset) -> Option<Point> {
        let optics = self.config.optics().ok()?;
        let reading = optics.trace(Model::Gaussian, pose, Vec2::from(offset)).ok()?;
        let beam: [f64; 2] = (optics.across(pose.t) + Vec2::from(offset)).into();
        let stage = self.config.steering.beam_map().stage(BeamPoint(beam));
        let mean = self.samples.sqrt();
        let spot = self.config.estimation.spot_noise_um * 1e-6 / mean;
        let (pose, sigmas) = (pose.to_array(), self.reference.of_pose());
        let known = |value, deviation| Known { value, deviation };
        Some(Point {
            spots: reading.spots,
            spot_deviations: [spot; 6],
            powers: reading.powers,
            power_deviations: reading.powers.map(|power| self.config.estimation.power_noise * power / mean),
            reference: [0, 1, 2, 3, 4, 5].map(|i| Some(known(pose[i], sigmas[i]))),
            steering: Some(stage.map(|x| known(x, READBACK))),
            run: None,
        })
    }
}
