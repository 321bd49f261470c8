//! From converter codes to spots: the channel map inverts the electronics of the twin.

use std::fmt::Write as _;

use trifacet_wire::Status;

use super::calibration::{fits, record_of};
use crate::testkit::{Daemon, Frame, errors, truth};

/// Runs a daemon until its loop is locked, and returns the next `samples` frames.
fn run(config: &str, samples: usize) -> Vec<Frame> {
    let mut daemon = Daemon::start(config);
    let mut stream = daemon.client();
    stream.locked();
    stream.samples(samples)
}

/// Means of the pose errors of a daemon with this configuration, and their rms in units of the reported
/// standard uncertainties.
fn compare(config: &str, samples: usize) -> ([f64; 6], [f64; 6]) {
    let frames = run(config, samples);
    let truth = truth(config, frames.last().unwrap().sample_index as usize + 1);
    errors(&frames, &truth)
}

/// The poses are right within their reported standard uncertainties.
fn is_right(config: &str) {
    is_right_within(config, 0.85);
}

fn is_right_within(config: &str, least: f64) {
    let (_, scatter) = compare(config, 600);
    assert!(scatter.iter().all(|s| (least..1.15).contains(s)), "{config}: {scatter:?}");
}

#[test]
fn amplifiers_gains_and_signs_are_corrected() {
    is_right(
        "channels.a.amplifier = \"difference\"\nchannels.b.gain = [-1.5, 0.8, 0.7]\n\
         channels.c = { amplifier = \"difference\", gain = [2.0, -1.0, 1.3] }",
    );
}

#[test]
fn dark_offsets_are_subtracted_and_cause_errors_otherwise() {
    let dark = "twin.dark_v = [0.1, -0.05, 0.2, -0.1, 0.02, 0.1, 0.03, 0.0, -0.1]";
    let known = "channels.a.dark_v = [0.1, -0.05, 0.2]\nchannels.b.dark_v = [-0.1, 0.02, 0.1]\n\
                 channels.c.dark_v = [0.03, 0.0, -0.1]";
    is_right(&format!("{dark}\n{known}"));
    let (mean, scatter) = compare(dark, 200);
    // 0.1 V at 10 V is 65 um at 6.5 mm.
    assert!(mean.iter().any(|error| error.abs() > 10e-6), "{mean:?}");
    assert!(scatter.iter().any(|s| *s > 10.0), "{scatter:?}");
}

#[test]
fn the_skew_between_channels_is_corrected() {
    // 15 mm/s on the PSDs and 0.8 ms from the first signal to the last are 13 um.
    // Interpolation between two samples averages them and reduces the noise.
    is_right_within(
        "twin.channel_skew_us = 90.0\n\
         twin.motion = [{ axis = \"yaw\", kind = \"sine\", amount_urad = 1000.0, frequency_hz = 5.0 }, \
                        { axis = \"pitch\", kind = \"sine\", amount_urad = 1000.0, frequency_hz = 5.0 }]",
        0.6,
    );
}

#[test]
fn a_converter_of_12_bits_is_accurate_to_its_steps() {
    is_right("twin.converter_bits = 12\ntwin.spot_noise_um = 0.57");
}

const TURNED: &str = "twin.bow_um = 100.0\n\
    twin.motion = [{ axis = \"yaw\", kind = \"step\", amount_urad = 6000.0 }, \
                   { axis = \"roll\", kind = \"step\", amount_urad = -5000.0 }]";

/// The correction table of a PSD with this bow: the correction of its readings. Measurements cover the square of
/// `covered` metres to both sides.
fn correction(half: f64, bow: f64, covered: f64) -> String {
    const STEPS: i32 = 32;
    let mut table = "u_m,v_m,du_m,dv_m,covered\n".to_owned();
    for row in -STEPS..=STEPS {
        for column in -STEPS..=STEPS {
            let reading = [column, row].map(|k| f64::from(k) / f64::from(STEPS));
            // The reading is the true position times 1 + b r^2: solve for that factor.
            let radius = reading[0].hypot(reading[1]);
            let mut place = radius;
            for _ in 0..50 {
                place = radius / (1.0 + bow / half * place * place);
            }
            let shrink = if radius > 0.0 { place / radius - 1.0 } else { 0.0 };
            let [u, v] = reading.map(|x| x * half);
            let covered = u8::from(u.abs().max(v.abs()) <= covered);
            writeln!(table, "{u},{v},{},{},{covered}", u * shrink, v * shrink).unwrap();
        }
    }
    table
}

#[test]
fn correction_tables_remove_the_bow_and_a_record_is_needed_for_calibrated() {
    let folder = tempfile::tempdir().unwrap();
    let table = folder.path().join("bow.csv");
    std::fs::write(&table, correction(6.5e-3, 100e-6, 6.5e-3)).unwrap();
    let with = |names: &[&str]| {
        let mut config = TURNED.to_owned();
        for name in names {
            write!(config, "\nchannels.{name}.correction = \"{}\"", table.display()).unwrap();
        }
        config
    };
    let uncalibrated = |frames: &[Frame]| frames.iter().all(|f| f.has(Status::UNCALIBRATED));
    let truth = truth(TURNED, 5000);
    let bowed = run(&with(&[]), 500);
    let (off, _) = errors(&bowed, &truth);
    assert!(uncalibrated(&bowed) && off.iter().any(|error| error.abs() > 10e-6), "{off:?}");
    assert!(uncalibrated(&run(&with(&["a", "b", "c"]), 10)), "tables alone are not a calibration");
    let corrected = with(&["a", "b", "c"]);
    let record = folder.path().join("calibration.json");
    let fits = fits(&corrected);
    std::fs::write(&record, record_of(&fits, "2026-05-04T12:00:00Z", None)).unwrap();
    let corrected = run(&format!("{corrected}\ncalibration.record = \"{}\"", record.display()), 1000);
    assert!(!corrected.iter().any(|f| f.has(Status::UNCALIBRATED)));
    assert_ne!(corrected[0].config, bowed[0].config, "another calibration has another configuration id");
    let (mean, scatter) = errors(&corrected, &truth);
    // The residual of the bilinear interpolation is below a tenth of a micrometre on the PSD.
    assert!(mean.iter().all(|error| error.abs() < 0.4e-6), "{mean:?}");
    assert!(scatter.iter().all(|s| (0.85..1.15).contains(s)), "{scatter:?}");
}

#[test]
fn a_spot_beyond_the_measurements_of_its_table_is_flagged_and_its_pose_stands() {
    let folder = tempfile::tempdir().unwrap();
    let frames = |covered: f64| {
        let table = folder.path().join("bow.csv");
        std::fs::write(&table, correction(6.5e-3, 100e-6, covered)).unwrap();
        // The spots of B move by about 3 mm.
        run(&format!("{TURNED}\nchannels.b.correction = \"{}\"", table.display()), 300)
    };
    let [inside, outside] = [5e-3, 1e-3].map(frames);
    assert!(inside.iter().all(|f| f.valid() && !f.has(Status::OUT_OF_CALIBRATION)));
    assert!(outside.iter().all(|f| f.valid() && f.has(Status::OUT_OF_CALIBRATION)));
    assert!(outside.iter().all(|f| !f.status.usable(Status::SIMULATED)), "a control must not use them");
    // The correction is the same; only the statement about it differs.
    let truth = truth(TURNED, 5000);
    let [(within, _), (beyond, _)] = [&inside, &outside].map(|frames| errors(frames, &truth));
    assert!(within.iter().zip(beyond).all(|(a, b)| (a - b).abs() < 2e-6), "{within:?} {beyond:?}");
}
