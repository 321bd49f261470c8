//! The mean residual: constant errors are seen, a laser that drifts as configured is not an error.

use trifacet::closed_loop_sim::ClosedLoopSim;
use trifacet::config::{Config, parse};
use trifacet_wire::Status;

/// Healthy heads in closed loop.
const HEALTHY: [(&str, &str); 8] = [
    ("at rest", "twin.motion = []"),
    ("moving slowly", ""),
    (
        "moving fast",
        "twin.motion = [{ axis = 'tx', kind = 'sine', amount_um = 200, frequency_hz = 3 },
                        { axis = 'pitch', kind = 'sine', amount_urad = 500, frequency_hz = 2 }]",
    ),
    (
        "vibrating",
        "twin.motion = [{ axis = 'ty', kind = 'vibration', amount_um = 14, frequency_hz = 20, high_hz = 200 }]",
    ),
    ("multiplexed", "twin.channel_skew_us = 50"),
    ("with 12 bits", "twin = { converter_bits = 12, spot_noise_um = 0.57 }"),
    ("with 16 bits", "twin.converter_bits = 16"),
    ("with means of 100 samples", "estimation.average = 100"),
];

fn config(text: &str, seed: u64) -> Config {
    let mut config = parse(text, None).unwrap();
    config.twin.seed = seed;
    config
}

/// Number of reports with a residual, and samples at which `INCONSISTENT` begins or ends.
fn run(config: &Config, scans: u64) -> (u64, Vec<u64>) {
    let mut sim = ClosedLoopSim::new(config).unwrap();
    let (mut judged, mut changes) = (0, Vec::new());
    for _ in 0..scans {
        let Some(report) = sim.step().report else { continue };
        let Some(_) = report.steering_residual else { continue };
        judged += 1;
        if report.status.has(Status::INCONSISTENT) != (changes.len() % 2 == 1) {
            changes.push(report.index);
        }
    }
    (judged, changes)
}

/// Runs every healthy head with a drift of the configured size, and without one.
fn no_false_alarm(scans: u64) {
    for (name, text) in HEALTHY {
        for pointing_um in [0.0, 1.0] {
            let mut config = config(text, 5);
            (config.twin.pointing_um, config.twin.pointing_s) = (pointing_um, 10.0);
            let (judged, alarms) = run(&config, scans);
            println!("{name}, drift {pointing_um} um: {judged} residuals, {alarms:?}");
            assert!(judged * u64::from(config.estimation.average) > scans * 9 / 10, "{name}: {judged}");
            assert!(alarms.is_empty(), "{name}, drift {pointing_um} um: {alarms:?}");
        }
    }
}

#[test]
fn a_drift_of_the_configured_size_is_no_contradiction() {
    no_false_alarm(20_000);
}

/// `cargo test --release --test numeric ten_million -- --ignored --nocapture`
#[test]
#[ignore = "a command: takes an hour"]
fn ten_million_samples_of_each_healthy_head_are_no_contradiction() {
    no_false_alarm(10_000_000);
}

#[test]
fn a_drift_beyond_the_configured_size_is_seen_within_seconds() {
    for seed in 1..6 {
        let drifting = "twin = { pointing_um = 8, pointing_s = 2 }";
        let (_, changes) = run(&config(drifting, seed), 10_000);
        println!("seed {seed}: {changes:?}");
        assert!(changes.first().is_some_and(|first| *first < 10_000), "seed {seed}");
    }
}

/// The laser is displaced at 3 s and returns at 6 s.
#[test]
fn a_small_constant_error_is_seen_after_a_second_and_forgotten_after_a_second() {
    let default = (1.005, "");
    let stable = (0.142, "steering.pointing_um = 0.1");
    for ((sigma, keys), um, seen) in [
        (default, 4.0, false),
        (default, 6.5, true),
        (default, 9.0, true),
        (stable, 0.4, false),
        (stable, 1.2, true),
        (stable, 4.0, true),
    ] {
        for (rate, reports_s) in [("", 1000.0), ("acquisition.rate_hz = 10000", 10_000.0)] {
            let text = format!(
                "{keys}\n{rate}\ntwin.fault = [{{ at_s = 3, for_s = 3, kind = 'laser-bump', shift_um = [{um}, 0] }}]"
            );
            let (_, changes) = run(&config(&text, 3), (9.0 * reports_s) as u64);
            let at_s: Vec<f64> = changes.iter().map(|index| *index as f64 / reports_s).collect();
            println!("{um} um with {sigma} um stated, {reports_s} Hz: {at_s:?}");
            if seen {
                // Near the limit of one residual, ten in a row and one within it alternate until the mean shows it.
                let (end, begins) = at_s.split_last().unwrap();
                assert!(
                    begins.len() % 2 == 1 && begins.iter().all(|s| (3.0..4.0).contains(s)),
                    "{um} um: {at_s:?}"
                );
                assert!((6.0..7.0).contains(end), "{um} um: {at_s:?}");
            } else {
                assert!(at_s.is_empty(), "{um} um: {at_s:?}");
            }
        }
    }
}

/// Ten reports per second, and one: the mean is over ten reports.
#[test]
fn at_low_rates_the_mean_is_over_ten_reports() {
    for (rate_hz, average) in [(10, 1), (1, 1), (1000, 1000)] {
        let text = format!(
            "acquisition.rate_hz = {rate_hz}\nestimation.average = {average}\ncentering.mode = 'off'\n\
             steering.pointing_um = 0.3\n\
             twin = {{ motion = [], laser_offset_um = [3, 0] }}"
        );
        let (_, changes) = run(&config(&text, 3), 40 * average);
        assert_eq!(changes.len(), 1, "{rate_hz} Hz, {average}: {changes:?}");
        let reports = changes[0] / average + 1;
        assert!((9..=11).contains(&reports), "{rate_hz} Hz, {average}: {changes:?}");
    }
}
