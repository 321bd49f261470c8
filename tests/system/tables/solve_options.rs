//! `trifacet solve` with `--readings`, `--frames`, `--tare-row` and `--sigma`.

use std::fmt::Write as _;

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;
use trifacet_optics::{Pose, Rigid};

use super::{POSE, POWERS, SPOTS, columns, stderr, trifacet};
use crate::testkit::{Daemon, Folder};

const CAL_STD: [&str; 6] = [
    "cal_std_tx_m",
    "cal_std_ty_m",
    "cal_std_tz_m",
    "cal_std_roll_rad",
    "cal_std_pitch_rad",
    "cal_std_yaw_rad",
];

const STD: [&str; 6] = ["std_tx_m", "std_ty_m", "std_tz_m", "std_roll_rad", "std_pitch_rad", "std_yaw_rad"];

/// Frames that turn and shift.
const FRAMES: &str = "[frames.base]\ntranslation_mm = [5, -3, 20]\nrotation_deg = [10, -20, 75]\n\
                      [frames.tool]\ntranslation_mm = [1, 2, -40]\nrotation_deg = [0, 5, -30]\n";

/// A table whose correction bends and turns, with measurements for |u|, |v| up to 4 mm.
fn table() -> String {
    let mut table = "u_m,v_m,du_m,dv_m,covered\n".to_owned();
    for i in -26..=26 {
        for k in -26..=26 {
            let [u, v] = [i, k].map(|n| f64::from(n) * 0.25e-3);
            let bow = 400.0 * (u * u + v * v);
            let covered = u8::from(u.abs().max(v.abs()) <= 4e-3);
            writeln!(table, "{u},{v},{},{},{covered}", u * bow + 0.01 * v, v * bow - 0.02 * u).unwrap();
        }
    }
    table
}

/// A configuration with these tables, gains and frames.
fn configured(folder: &Folder) -> String {
    folder.write("psd.csv", table());
    let psds =
        ["a", "b", "c"].map(|psd| format!("[channels.{psd}]\ncorrection = 'psd.csv'\ngain = [1, 1, 1.25]\n"));
    folder.write("head.toml", format!("{}{FRAMES}", psds.concat())).display().to_string()
}

/// Signals of these poses, by `trace`.
fn traced(poses: &[[f64; 6]]) -> Vec<[f64; 9]> {
    let mut text = POSE.join(",");
    for pose in poses {
        write!(text, "\n{}", pose.map(|x| x.to_string()).join(",")).unwrap();
    }
    let output = trifacet(&["trace"], text.as_bytes());
    assert!(output.status.success(), "{}", stderr(&output));
    rows(&output.stdout, &[&SPOTS[..], &POWERS].concat())
        .into_iter()
        .map(|row| row.try_into().unwrap())
        .collect()
}

/// The numbers of these columns, row by row.
fn rows(csv: &[u8], names: &[&str]) -> Vec<Vec<f64>> {
    let columns = columns(csv);
    let number = |name: &&str, row: usize| columns[*name][row].parse().unwrap();
    (0..columns[names[0]].len()).map(|row| names.iter().map(|name| number(name, row)).collect()).collect()
}

/// A table of signals, optionally with a standard uncertainty of each.
fn signals(rows: &[[f64; 9]], std: Option<[f64; 9]>) -> String {
    let names = [&SPOTS[..], &POWERS].concat();
    let mut text = names.join(",");
    if std.is_some() {
        text += &std_columns(&names);
    }
    for row in rows {
        text.push('\n');
        let cells = row.iter().chain(std.iter().flatten());
        text += &cells.map(|x| format!("{x:e}")).collect::<Vec<_>>().join(",");
    }
    text
}

fn solved(arguments: &[&str], input: &str) -> Vec<u8> {
    let output = trifacet(&[&["solve"], arguments].concat(), input.as_bytes());
    assert!(output.status.success(), "{}", stderr(&output));
    output.stdout
}

fn poses(csv: &[u8]) -> Vec<Pose> {
    rows(csv, &POSE).into_iter().map(|row| Pose::from_array(row.try_into().unwrap())).collect()
}

fn assert_same(ours: &Pose, theirs: &Pose) {
    let both = ours.to_array().into_iter().zip(theirs.to_array());
    assert!(both.clone().all(|(a, b)| (a - b).abs() < 1e-14), "{ours:?} {theirs:?}");
}

const PLACES: [[f64; 6]; 3] = [
    [0.2e-3, -0.1e-3, 0.3e-3, 1e-3, -2e-3, 3e-3],
    [-0.9e-3, 0.7e-3, -0.4e-3, -4e-3, 5e-3, -3e-3],
    [0.6e-3, 0.8e-3, 0.5e-3, 3e-3, 2e-3, 5e-3],
];

#[test]
fn readings_are_corrected_by_the_tables_and_gains_of_the_configuration() {
    let folder = Folder::new();
    let config = configured(&folder);
    let read = traced(&PLACES);
    // The same by hand: the correction of the table is smooth, and nearly linear between its points.
    let by_hand: Vec<[f64; 9]> = read
        .iter()
        .map(|row| {
            let mut row = *row;
            for psd in 0..3 {
                let [u, v] = [row[2 * psd], row[2 * psd + 1]];
                let bow = 400.0 * (u * u + v * v);
                (row[2 * psd], row[2 * psd + 1]) = (u + u * bow + 0.01 * v, v + v * bow - 0.02 * u);
                row[6 + psd] *= 1.25;
            }
            row
        })
        .collect();
    let with = poses(&solved(&["--config", &config, "--readings"], &signals(&read, None)));
    let without = poses(&solved(&["--config", &config], &signals(&by_hand, None)));
    for (ours, theirs) in with.iter().zip(&without) {
        let (ours, theirs) = (ours.to_array(), theirs.to_array());
        // Between points that are 0.25 mm apart, the bow differs from its chords by 0.1 um.
        assert!((0..6).all(|i| (ours[i] - theirs[i]).abs() < 0.6e-6), "{ours:?} {theirs:?}");
    }
}

#[test]
fn a_spot_outside_the_calibrated_area_is_a_warning_and_its_pose_stands() {
    let folder = Folder::new();
    let config = configured(&folder);
    let read = traced(&[[0.0; 6], [0.0, 0.0, 0.0, 0.0, 0.0, 20e-3]]);
    let output = solved(&["--config", &config, "--readings"], &signals(&read, None));
    let status = &columns(&output)["status"];
    assert_eq!(status[0], "ok");
    assert!(status[1].starts_with("warning: outside the calibrated area of PSD A, B, C"), "{status:?}");
    assert!((poses(&output)[1].yaw - 20e-3).abs() < 2e-3);
}

#[test]
fn frames_and_a_tare_row_are_applied_in_this_order() {
    let folder = Folder::new();
    let config = configured(&folder);
    let input = signals(&traced(&PLACES), None);
    let world = poses(&solved(&["--config", &config], &input));
    let transform = |mm: [f64; 3], deg: [f64; 3]| {
        let [roll, pitch, yaw] = deg.map(f64::to_radians);
        Rigid::from(&Pose { t: trifacet_optics::Vec3::from(mm) / 1e3, roll, pitch, yaw })
    };
    let base = transform([5.0, -3.0, 20.0], [10.0, -20.0, 75.0]);
    let tool = transform([1.0, 2.0, -40.0], [0.0, 5.0, -30.0]);
    let user: Vec<_> = world.iter().map(|pose| base * Rigid::from(pose) * tool).collect();
    let framed = poses(&solved(&["--config", &config, "--frames"], &input));
    for (ours, theirs) in framed.iter().zip(&user) {
        assert_same(ours, &Pose::from(theirs));
    }
    for (row, zero) in (1..).zip(&user) {
        let tared =
            poses(&solved(&["--config", &config, "--frames", "--tare-row", &format!("{row}")], &input));
        for (ours, theirs) in tared.iter().zip(&user) {
            assert_same(ours, &Pose::from(&(zero.inverse() * *theirs)));
        }
        assert_eq!(tared[row - 1], Pose::default());
    }
}

#[test]
fn a_tare_row_that_does_not_exist_or_has_no_pose_is_refused() {
    let read = traced(&PLACES);
    let output = trifacet(&["solve", "--tare-row", "4"], signals(&read, None).as_bytes());
    assert_eq!(output.status.code(), Some(65));
    assert!(
        stderr(&output).contains("row 4 is needed, but the table has only 3 data rows"),
        "{}",
        stderr(&output)
    );
    let mut dark = read.clone();
    dark[1][7] = -1e-4;
    let output = trifacet(&["solve", "--tare-row", "2"], signals(&dark, None).as_bytes());
    assert_eq!(output.status.code(), Some(65));
    assert!(
        stderr(&output).contains(":3: the tare row has no pose: too little light on PSD B"),
        "{}",
        stderr(&output)
    );
    // A bad row before the tare row is reported with its line.
    let output = trifacet(&["solve", "--tare-row", "3"], signals(&dark, None).as_bytes());
    assert_eq!(output.status.code(), Some(65));
    assert!(stderr(&output).contains("standard input:3: too little light on PSD B"), "{}", stderr(&output));
    let status = &columns(&output.stdout)["status"];
    assert!(status[0] == "ok" && status[1] != "ok" && status[2] == "ok", "{status:?}");
    assert_eq!(trifacet(&["solve", "--tare-row", "0"], b"").status.code(), Some(64));
}

/// Different for each signal.
const STD_SIGNALS: [f64; 9] = [0.5e-6, 1e-6, 1.5e-6, 0.8e-6, 2e-6, 0.3e-6, 1e-3, 2e-3, 0.5e-3];

/// The signals with noise of these standard uncertainties.
fn noisy(signals: &[f64; 9], std: &[f64; 9], random: &mut Pcg64) -> [f64; 9] {
    std::array::from_fn(|i| signals[i] + std[i] * random.sample::<f64, _>(StandardNormal))
}

/// Standard deviations of poses.
fn scatter(poses: &[Pose]) -> [f64; 6] {
    let n = poses.len() as f64;
    std::array::from_fn(|i| {
        let values = poses.iter().map(|pose| pose.to_array()[i]);
        let mean = values.clone().sum::<f64>() / n;
        (values.map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt()
    })
}

fn assert_scatter(poses: &[Pose], stated: &[f64], tolerance: f64, what: &str) {
    for (i, seen) in scatter(poses).into_iter().enumerate() {
        let ratio = seen / stated[i];
        assert!(
            (ratio - 1.0).abs() < tolerance,
            "{what}: {} scatters by {ratio} of its uncertainty",
            POSE[i]
        );
    }
}

#[test]
fn uncertainties_are_the_scatter_of_repeated_readings() {
    let folder = Folder::new();
    let config = configured(&folder);
    let mut random = Pcg64::seed_from_u64(13);
    let at = traced(&PLACES)[1];
    let options = ["--config", &config, "--readings", "--frames", "--sigma"];
    let relative = |std: [f64; 9]| std::array::from_fn(|i| if i < 6 { std[i] } else { std[i] * at[i] });
    let configured = relative([1.08e-6, 1.08e-6, 1.08e-6, 1.08e-6, 1.08e-6, 1.08e-6, 1e-3, 1e-3, 1e-3]);
    for (std, stated) in [(relative(STD_SIGNALS), true), (configured, false)] {
        let readings: Vec<_> = (0..4000).map(|_| noisy(&at, &std, &mut random)).collect();
        let output = solved(&options, &signals(&readings, stated.then_some(std)));
        // 4 deviations of an estimate from 4000 readings.
        assert_scatter(&poses(&output), &rows(&output, &STD)[0], 0.045, "repeated readings");
    }
}

#[test]
fn the_uncertainty_of_a_difference_has_the_noise_of_both_rows() {
    let folder = Folder::new();
    let config = configured(&folder);
    let mut random = Pcg64::seed_from_u64(14);
    let [zero, at] = [0, 1].map(|i| traced(&PLACES)[i]);
    let std = std::array::from_fn(|i| if i < 6 { STD_SIGNALS[i] } else { STD_SIGNALS[i] * at[i] });
    let options = ["--config", &config, "--readings", "--frames", "--sigma", "--tare-row", "1"];
    let mut differences = Vec::new();
    let mut stated = Vec::new();
    for _ in 0..250 {
        let pair = [zero, at].map(|signals| noisy(&signals, &std, &mut random));
        let output = solved(&options, &signals(&pair, Some(std)));
        differences.push(poses(&output)[1]);
        stated = rows(&output, &STD);
    }
    assert_eq!(stated[0], [0.0; 6], "the tare row differs from itself by exactly nothing");
    // 4 deviations of an estimate from 250 differences.
    assert_scatter(&differences, &stated[1], 0.18, "differences");
}

#[test]
fn the_systematic_part_is_that_of_the_configuration_and_the_total_contains_it() {
    let folder = Folder::new();
    let file =
        folder.write("head.toml", "[estimation]\nsystematic_um = [1, 2, 3]\nsystematic_urad = [4, 5, 6]\n");
    let config = file.display().to_string();
    let input = signals(&traced(&PLACES), None);
    let systematic = STD.map(|name| format!("sys_{name}"));
    let systematic: Vec<_> = systematic.iter().map(String::as_str).collect();
    let numbers = |arguments: &[&str], names: &[&str]| rows(&solved(arguments, &input), names);
    let sys = numbers(&["--config", &config, "--sigma"], &systematic);
    let expected = [1e-6, 2e-6, 3e-6, 4e-6, 5e-6, 6e-6];
    assert!(sys.iter().all(|row| row.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-18)), "{sys:?}");
    let [total, random] = [&["--config", &config, "--sigma"][..], &["--sigma"]].map(|a| numbers(a, &STD));
    for ((total, random), sys) in total.iter().zip(&random).zip(&sys) {
        for i in 0..6 {
            assert!((total[i] / random[i].hypot(sys[i]) - 1.0).abs() < 1e-12, "{i}");
        }
    }
    // What is not known is absent, not zero.
    let output = trifacet(&["solve", "--sigma"], input.as_bytes());
    assert!(!columns(&output.stdout).contains_key("cal_std_tx_m"));
    assert!(
        stderr(&output).contains("no columns cal_std_tx_m to cal_std_yaw_rad: the configuration names no")
    );
    let negative = input.replacen("power_c", "power_c,std_u_a_m", 1).replace('\n', ",-1\n") + ",-1";
    let negative = negative.replacen("std_u_a_m,-1", "std_u_a_m", 1);
    let output = trifacet(&["solve", "--sigma"], negative.as_bytes());
    assert_eq!(output.status.code(), Some(65));
    assert!(stderr(&output).contains("std_u_a_m is -1: allowed is at least 0"), "{}", stderr(&output));
}

/// Points of a stage over a small range, with the noise that they state, for `calibrate fit`.
pub(crate) fn points(random: &mut Pcg64) -> String {
    const REF_STD: [f64; 6] = [0.1e-6, 0.1e-6, 0.1e-6, 0.5e-6, 0.5e-6, 0.5e-6];
    let span = [0.1e-3, 0.1e-3, 0.1e-3, 0.5e-3, 0.5e-3, 0.5e-3];
    let poses: Vec<[f64; 6]> = (0..80).map(|_| span.map(|most| random.random_range(-most..most))).collect();
    let names = [&SPOTS[..], &POWERS].concat();
    let mut text = names.join(",");
    text += &std_columns(&names);
    text += &POSE.map(|name| format!(",ref_{name}")).concat();
    text += &POSE.map(|name| format!(",ref_std_{name}")).concat();
    text += ",stage_x_m,stage_y_m";
    for (signals, pose) in traced(&poses).iter().zip(&poses) {
        let std = std::array::from_fn(|i| if i < 6 { 0.108e-6 } else { 1e-4 * signals[i] });
        let seen = noisy(signals, &std, random);
        let reference: [f64; 6] =
            std::array::from_fn(|i| pose[i] + REF_STD[i] * random.sample::<f64, _>(StandardNormal));
        // The beam is on the apex.
        let stage = [0, 1].map(|i| pose[i] + 0.1e-6 * random.sample::<f64, _>(StandardNormal));
        let cells = seen.iter().chain(&std).chain(&reference).chain(&REF_STD).chain(&stage);
        text.push('\n');
        text += &cells.map(|x| format!("{x:e}")).collect::<Vec<_>>().join(",");
    }
    text + "\n"
}

#[test]
fn the_share_of_the_calibration_is_stated_if_its_record_belongs_to_the_configuration() {
    let folder = Folder::new();
    let mut random = Pcg64::seed_from_u64(15);
    folder.write("in.toml", "");
    folder.write("points.csv", points(&mut random));
    let path = |name: &str| folder.path(name).display().to_string();
    let fit = trifacet(
        &[
            "calibrate",
            "fit",
            "--config",
            &path("in.toml"),
            "--points",
            &path("points.csv"),
            "--out",
            &path("out"),
        ],
        b"",
    );
    assert!(fit.status.success(), "{}", stderr(&fit));
    let config = path("out/trifacet.toml");

    // The daemon counts as calibrated with what the fit has written.
    let frames = Daemon::start(
        &std::fs::read_to_string(&config)
            .unwrap()
            .replace("\"psd-", &format!("\"{}/psd-", path("out")))
            .replace("\"calibration.json\"", &format!("\"{}\"", path("out/calibration.json"))),
    )
    .client()
    .take(10);
    assert!(frames.iter().all(|frame| !frame.has(trifacet_wire::Status::UNCALIBRATED)));

    let places =
        [[0.0; 6], [50e-6, -40e-6, 30e-6, 2e-4, -3e-4, 1e-4], [-80e-6, 0.0, 60e-6, 0.0, 3e-4, -4e-4]];
    let input = signals(&traced(&places), None);
    let options = ["--readings", "--frames", "--tare-row", "1", "--sigma"];
    let with =
        |config: &str| trifacet(&[&["solve", "--config", config], &options[..]].concat(), input.as_bytes());
    let output = with(&config);
    assert!(output.status.success() && output.stderr.is_empty(), "{}", stderr(&output));
    let [cal, total] = [&CAL_STD, &STD].map(|names| rows(&output.stdout, names));
    assert_eq!((&*cal[0], &*total[0]), (&[0.0; 6][..], &[0.0; 6][..]));
    let (truth, solved) = (&places, poses(&output.stdout));
    for row in 1..3 {
        for i in 0..6 {
            let unit = if i < 3 { 1e-6 } else { 3e-6 };
            assert!(cal[row][i] > 1e-3 * unit && cal[row][i] < 0.3 * unit, "{row} {i}: {}", cal[row][i]);
            assert!(total[row][i] > cal[row][i]);
            let error = solved[row].to_array()[i] - truth[row][i];
            assert!(error.abs() < 5.0 * cal[row][i], "{row} {i}: {error} of {}", cal[row][i]);
        }
    }

    // Other frames, and another head: the share is not known, and the reason is said.
    let text = std::fs::read_to_string(&config).unwrap();
    let without = |name: &str, text: &str, why: &str| {
        folder.write(&format!("out/{name}"), text);
        let output = with(&path(&format!("out/{name}")));
        assert!(output.status.success(), "{}", stderr(&output));
        assert!(!columns(&output.stdout).contains_key("cal_std_tx_m"), "{name}");
        assert!(stderr(&output).contains(why), "{}", stderr(&output));
    };
    let moved = text.replacen(
        "[frames.tool]\ntranslation_mm = [",
        "[frames.tool]\ntranslation_mm = [0.9, 0, 0] # [",
        1,
    );
    without("frames.toml", &moved, "frames.base and frames.tool are not those of the calibration");
    let other = text.replacen("beam_diameter_mm = 0.4", "beam_diameter_mm = 0.40", 1);
    without("head.toml", &other, "belongs to another configuration");
}

/// The names of the columns with the standard uncertainties of these signals, each behind a comma.
fn std_columns(names: &[&str]) -> String {
    names.iter().flat_map(|name| [",std_", name]).collect()
}
