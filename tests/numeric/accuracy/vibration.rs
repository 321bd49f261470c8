//! A mirror that vibrates fast at the sample rate: the powers are well known, although they differ from sample to
//! sample.

use trifacet_wire::Status;

use super::bench::Bench;
use super::eleven::worst;
use super::flicker::nees;

const SAMPLES: usize = 3000;
/// The vibration begins with the first sample. The stated uncertainties are right after this number of samples.
const BEGIN: usize = 20;

#[test]
fn a_power_that_is_known_is_not_noisy_in_a_fast_vibration() {
    println!(
        "| skew | amplitude | frequency | frames with a pose | POWER_NOISY | POWER_STEP | largest error | NEES |"
    );
    for skew_us in [0, 20] {
        for um in [5, 20, 100] {
            for hz in [50, 200, 400, 450] {
                let samples = Bench::new(&format!(
                    "twin.channel_skew_us = {skew_us}\ntwin.laser_mw = 0.4\ncentering.mode = 'off'\n\
                     twin.motion = [{{ axis = 'tx', kind = 'sine', amount_um = {um}, frequency_hz = {hz} }}]\n"
                ))
                .with_truth(BEGIN + SAMPLES)
                .split_off(BEGIN);
                let share = |test: &dyn Fn(Status) -> bool| {
                    samples.iter().filter(|(report, _)| test(report.status)).count() as f64 / SAMPLES as f64
                };
                let valid = share(&|status| status.has(Status::POSE_VALID));
                let noisy = share(&|status| status.has(Status::POWER_NOISY));
                let step = share(&|status| status.has(Status::POWER_STEP));
                let worst = samples.iter().map(worst).fold(0.0, f64::max);
                let errors: Vec<f64> = samples.iter().filter_map(nees).collect();
                let nees = errors.iter().sum::<f64>() / errors.len().max(1) as f64;
                println!(
                    "| {skew_us} us | {um} um | {hz} Hz | {:.1} % | {:.1} % | {:.1} % | {worst:.1} | {nees:.2} |",
                    100.0 * valid,
                    100.0 * noisy,
                    100.0 * step
                );
                assert!(worst < 6.0 && nees < 6.6, "{worst} {nees}");
                assert!(skew_us > 0 || valid == 1.0);
            }
        }
    }
}
