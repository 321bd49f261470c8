//! Steps of the laser power with a converter that samples its channels one after the other.

use trifacet_wire::Status;

use super::bench::Bench;
use super::eleven::worst;

/// Samples from one step to the next.
const APART: usize = 10;

/// Steps of the power up and back, each at another time within its scan.
fn steps(factor: f64, count: usize) -> String {
    let step = |k: usize| {
        let at_s = 1e-4 * (APART as f64 * (2 * k + 1) as f64 + 0.5 * k as f64 / count as f64);
        let for_s = 1e-4 * (APART as f64 + 0.4);
        format!("{{ at_s = {at_s:.8}, for_s = {for_s:.8}, kind = 'laser-power', factor = {factor} }}")
    };
    (0..count).map(step).collect::<Vec<_>>().join(", ")
}

#[test]
fn a_step_of_the_power_does_not_bias_the_pose() {
    let count = 40;
    for factor in [0.5, 0.8, 0.94, 0.97, 0.99, 1.01, 1.03, 1.06, 1.2, 1.5] {
        for fuse in [false, true] {
            let mut bench = Bench::new(&format!(
                "acquisition.rate_hz = 10000\nestimation.fuse_steering = {fuse}\nsteering.deviation_um = 0.1\n\
                 twin.motion = []\ntwin.seed = 5\ntwin.converter_bits = 24\ntwin.laser_mw = 0.4\n\
                 twin.channel_skew_us = 9\ntwin.fault = [{}]\n",
                steps(factor, count)
            ));
            let samples = bench.with_truth(APART * (2 * count + 1));
            let flagged = |k: usize| samples[k].0.status.has(Status::POWER_STEP);
            for (k, (report, _)) in samples.iter().enumerate() {
                assert_eq!(report.pose.is_none(), flagged(k), "{k}");
                // Only the scan of a step and its neighbours may be flagged.
                assert!(k % APART < 4 || !flagged(k), "{factor}: {k}");
                let must = k >= APART && k % APART == 1 && !(0.95..1.05).contains(&factor);
                assert!(!must || flagged(k), "{factor}: {k}");
            }
            let worst = samples.iter().map(worst).fold(0.0, f64::max);
            let flags = (0..samples.len()).filter(|k| flagged(*k)).count() as f64 / (2 * count) as f64;
            println!("{factor}, fused {fuse}: {worst:.2} sigma at most, {flags:.2} samples per step");
            assert!(worst < 7.0, "{factor}, {fuse}: {worst}");
        }
    }
}
