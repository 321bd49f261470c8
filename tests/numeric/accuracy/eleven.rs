//! Estimation from eleven signals: the two coordinates of the steering readback are added to the nine of
//! the PSDs.

use nalgebra::Vector6;
use trifacet::core::estimation::PoseReport;
use trifacet::twin::Scene;
use trifacet_wire::Status;

use super::SAMPLES;
use super::bench::{Bench, stated};

/// Standard uncertainties of tx, ty, tz (um), roll, pitch, yaw (urad) from the linearised model at rest.
const PREDICTED: [f64; 6] = [0.134, 0.134, 0.624, 1.580, 1.580, 2.494];

/// A mirror at rest, noise of 1.08 um and 1e-3, 0.1 um on the readback. 24 bits over 10 V: a step is 0.8 nm
/// of
/// spot and 0.06 nm of stage.
fn config(more: &str) -> String {
    format!(
        "estimation.fuse_steering = true\nsteering.deviation_um = 0.1\n\
         twin.motion = []\ntwin.seed = 11\ntwin.converter_bits = 24\n{more}\n"
    )
}

/// Reported pose minus true pose, SI units.
fn error((report, truth): &(PoseReport, Scene)) -> Option<Vector6<f64>> {
    report.pose.map(|pose| Vector6::from(pose.to_array()) - Vector6::from(truth.pose.to_array()))
}

/// The largest error of any axis in units of its reported standard uncertainty; 0 without a pose.
pub fn worst(sample: &(PoseReport, Scene)) -> f64 {
    let Some(error) = error(sample) else { return 0.0 };
    let stated = Vector6::from(stated(&sample.0)) * 1e-6;
    error.component_div(&stated).amax()
}

#[test]
fn eleven_signals_scatter_as_predicted() {
    let mut samples = Bench::new(&config("")).with_truth(SAMPLES + 9);
    samples.drain(..9); // the readback is fused only after ten consistent samples
    let n = SAMPLES as f64;
    let stated = stated(&samples[SAMPLES - 1].0);
    let (mut squares, mut nees) = (Vector6::zeros(), 0.0);
    for sample in &samples {
        let error = error(sample).unwrap();
        squares += error.component_mul(&error) / n;
        nees += error.dot(&(sample.0.covariance.unwrap().try_inverse().unwrap() * error)) / n;
    }
    let scatter = squares.map(|square| square.sqrt() * 1e6);
    println!("         {:>8} {:>8} {:>8} {:>8} {:>8} {:>8}", "tx", "ty", "tz", "roll", "pitch", "yaw");
    for (name, x) in [("predicted", PREDICTED), ("stated", stated), ("scatter", scatter.into())] {
        println!("{name:9}{}", x.map(|x| format!("{x:8.4}")).join(" "));
    }
    println!("um and urad; mean normalised error squared of the six {nees:.4}");
    for axis in 0..6 {
        assert!((stated[axis] - PREDICTED[axis]).abs() < 0.5e-3, "{axis}: {stated:?}");
        assert!((scatter[axis] / stated[axis] - 1.0).abs() < 0.03, "{axis}: {scatter:?}");
    }
    // The probability of a value outside these limits is 1 %.
    assert!((5.911..6.090).contains(&nees), "{nees}");
}

#[test]
fn a_beam_that_contradicts_the_readback_does_not_bias_the_pose() {
    for step in 0..12 {
        let (y, x) = (std::f64::consts::FRAC_PI_6 * f64::from(step)).sin_cos();
        let off = format!("twin.laser_offset_um = [{}, {}]", 20.0 * x, 20.0 * y);
        let samples = Bench::new(&config(&off)).with_truth(2000);
        let worst = samples.iter().map(worst).fold(0.0, f64::max);
        println!("{:3} degrees: {worst:.2} sigma at most", 30 * step);
        assert!(worst < 7.0, "{worst}");
        for (k, (report, _)) in samples.iter().enumerate() {
            assert!(report.status.has(Status::POSE_VALID));
            assert_eq!(report.status.has(Status::INCONSISTENT), k >= 9, "{k}");
            let residual_um = report.steering_residual.unwrap() * 1e6;
            assert!((residual_um - 20.0).abs() < 6.0, "{residual_um}");
        }
    }
}

/// An offset below the noise of one residual is detected in the mean of the residuals.
#[test]
fn a_small_displacement_of_the_laser_does_not_bias_the_pose() {
    for um in [0.7, 1.0, 2.0, 3.0, 4.0, 5.0, 7.0] {
        let samples = Bench::new(&config(&format!("twin.laser_offset_um = [{um}, 0]"))).with_truth(SAMPLES);
        let worst = samples.iter().map(worst).fold(0.0, f64::max);
        println!("{um} um: {worst:.2} sigma at most");
        assert!(worst < 7.0, "{um}: {worst}");
    }
}

/// A sudden displacement is excluded after the number of samples that detection in the noise needs.
#[test]
fn a_sudden_displacement_is_excluded_within_the_allowed_samples() {
    for um in [3.0, 4.0, 5.0, 7.0, 10.0, 30.0] {
        let fault =
            format!("twin.fault = [{{ at_s = 2, for_s = 2, kind = 'laser-bump', shift_um = [{um}, 0] }}]");
        let samples = Bench::new(&config(&fault)).with_truth(6000);
        let wrong: Vec<_> = (0..samples.len()).filter(|k| worst(&samples[*k]) > 7.0).collect();
        let fused = |(report, _): &(PoseReport, Scene)| stated(report)[0] < 0.6;
        let again = samples[4000..].iter().position(fused).unwrap();
        println!("{um} um: wrong by more than 7 sigma {wrong:?}, fused {again} samples after its end");
        assert!(wrong.iter().all(|k| (2000..2030).contains(k)), "{wrong:?}");
        assert!(um < 6.0 || wrong.is_empty(), "{wrong:?}");
        assert!(again < 300 && samples[2500..4000].iter().all(|sample| !fused(sample)));
        let inconsistent = |sample: &(PoseReport, Scene)| sample.0.status.has(Status::INCONSISTENT);
        let first = samples.iter().position(inconsistent);
        assert!(um < 9.0 || first == Some(2009), "{first:?}");
        // The mean residual forgets the displacement with a time constant of half a second.
        assert!(!samples[5500..].iter().any(inconsistent));
    }
}
