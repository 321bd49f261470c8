//! A laser whose power flickers, as lamps and supplies on the mains do, and converters with and without skew.

use nalgebra::Vector6;
use trifacet::core::estimation::PoseReport;
use trifacet::twin::Scene;

use super::bench::Bench;
use super::eleven::worst;

const SAMPLES: usize = 3000;
/// Frames without a pose at the begin of the flicker, until it is known.
const LEARNING: usize = 30;

/// What is measured with one setting.
#[derive(Clone, Copy, Debug)]
struct Measured {
    /// Fraction of the frames with a pose.
    usable: f64,
    /// Number of frames up to the last one without a pose.
    learning: usize,
    /// Largest error of an axis in units of its stated standard uncertainty.
    worst: f64,
    /// Mean of the normalised squared error of the six axes; 6 if the uncertainties are right.
    nees: f64,
}

pub fn nees((report, truth): &(PoseReport, Scene)) -> Option<f64> {
    let error = Vector6::from(report.pose?.to_array()) - Vector6::from(truth.pose.to_array());
    Some(error.dot(&(report.covariance?.try_inverse()? * error)))
}

fn measure(config: &str) -> Measured {
    let samples = Bench::new(config).with_truth(SAMPLES);
    let errors: Vec<f64> = samples.iter().filter_map(nees).collect();
    Measured {
        usable: errors.len() as f64 / SAMPLES as f64,
        learning: samples.iter().rposition(|(report, _)| report.pose.is_none()).map_or(0, |k| k + 1),
        worst: samples.iter().map(worst).fold(0.0, f64::max),
        nees: errors.iter().sum::<f64>() / errors.len() as f64,
    }
}

/// A mirror at rest in light that flickers by `percent` at `hz`.
fn config(rate_hz: u32, skew_us: u32, percent: u32, hz: u32, fuse: bool) -> String {
    let fraction = f64::from(percent) / 100.0;
    format!(
        "acquisition.rate_hz = {rate_hz}\ntwin.motion = []\ntwin.seed = 7\ntwin.laser_mw = 0.4\n\
         twin.channel_skew_us = {skew_us}\nestimation.fuse_steering = {fuse}\nsteering.deviation_um = 0.1\n\
         twin.fault = [{{ at_s = 0, kind = 'flicker', fraction = {fraction}, frequency_hz = {hz} }}]\n"
    )
}

/// One row of the table; each cell is for nine and for eleven signals.
fn check(rate_hz: u32, skew_us: u32, percent: u32, hz: u32, expected: f64) -> [Measured; 2] {
    let seen = [false, true].map(|fuse| measure(&config(rate_hz, skew_us, percent, hz, fuse)));
    let [nine, eleven] = seen;
    println!(
        "| {} kHz | {skew_us} us | {percent} % | {hz} Hz | {:.1} % | {:.1} | {:.1} | {:.1} | {:.1} |",
        rate_hz / 1000,
        100.0 * nine.usable,
        nine.worst,
        eleven.worst,
        nine.nees,
        eleven.nees
    );
    for seen in seen {
        assert!(seen.worst < 6.0 && seen.learning <= LEARNING, "{seen:?}");
        assert!((0.6 * expected..1.1 * expected).contains(&seen.nees), "{seen:?}");
    }
    seen
}

/// The interpolation of skewed channels averages the noise of two scans, so that the stated uncertainties of a constant
/// power are too large too.
#[test]
fn flicker_costs_few_frames_and_every_pose_is_as_stated() {
    println!("| rate | skew | amplitude | frequency | frames with a pose | error, 9 | 11 | NEES, 9 | 11 |");
    for (rate_hz, skews) in [(1000, &[0, 5, 20][..]), (10_000, &[0, 5, 9])] {
        for &skew_us in skews {
            let constant = check(rate_hz, skew_us, 0, 0, 6.0);
            let expected = constant[0].nees.max(constant[1].nees);
            for (percent, hz) in [1, 5, 20].into_iter().flat_map(|p| [50, 100, 300].map(|hz| (p, hz))) {
                let seen = check(rate_hz, skew_us, percent, hz, expected);
                assert!(skew_us > 0 || seen.iter().all(|seen| seen.usable == 1.0), "{seen:?}");
            }
        }
    }
}
