//! `trifacet simulate` through the binary.

use std::io::{BufRead, BufReader};
use std::process::{Command, Output, Stdio};

use crate::testkit;

fn simulate() -> Command {
    testkit::trifacet(&["simulate"])
}

fn with_config(text: &str) -> Output {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), text).unwrap();
    simulate().args(["--samples", "300", "--config"]).arg(file.path()).output().unwrap()
}

#[test]
fn the_same_seed_gives_the_same_output_and_another_seed_does_not() {
    let shaken = |seed: u64| {
        let output = with_config(&format!(
            "[twin]\nseed = {seed}\n[[twin.motion]]\naxis = \"tz\"\nkind = \"vibration\"\n\
             amount_um = 5.0\nfrequency_hz = 10\nhigh_hz = 100\n"
        ));
        assert!(output.status.success(), "{output:?}");
        let text = String::from_utf8(output.stdout).unwrap();
        assert_eq!(text.lines().count(), 301);
        text
    };
    assert_eq!(shaken(7), shaken(7));
    assert_ne!(shaken(7), shaken(8));
}

#[test]
fn a_reader_may_close_the_pipe_early() {
    let mut child = simulate().args(["--samples", "1000000000"]).stdout(Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    assert!(line.starts_with("sample,time_s,true_tx_m,"), "{line}");
    assert!(child.wait().unwrap().success());
}

#[test]
fn an_invalid_configuration_is_refused() {
    let output = with_config("[twin]\nlaser_w = 1.0\n");
    assert_eq!(output.status.code(), Some(78));
    assert!(String::from_utf8_lossy(&output.stderr).contains("laser_w"), "{output:?}");
    assert!(output.stdout.is_empty());
}

#[test]
fn solving_the_samples_gives_the_true_poses() {
    let table = tempfile::NamedTempFile::new().unwrap();
    let simulated = simulate().args(["--samples", "500"]).output().unwrap().stdout;
    std::fs::write(table.path(), &simulated).unwrap();
    let solved = testkit::trifacet(&["solve"]).arg(table.path()).output().unwrap();
    assert!(solved.status.success(), "{solved:?}");
    let (truth, poses) = (column(&simulated, "true_tz_m"), column(&solved.stdout, "tz_m"));
    assert_eq!((truth.len(), poses.len()), (500, 500));
    // The standard uncertainty of one sample is 0.62 um; the mirror moves by 20 um.
    assert!(truth.iter().zip(&poses).all(|(t, z)| (t - z).abs() < 4e-6));
    let mean = truth.iter().zip(&poses).map(|(t, z)| z - t).sum::<f64>() / 500.0;
    assert!(mean.abs() < 4.0 * 0.62e-6 / 500_f64.sqrt(), "{mean}");
}

fn column(table: &[u8], name: &str) -> Vec<f64> {
    let text = std::str::from_utf8(table).unwrap();
    let place = text.lines().next().unwrap().split(',').position(|c| c == name).unwrap();
    text.lines().skip(1).map(|row| row.split(',').nth(place).unwrap().parse().unwrap()).collect()
}

#[test]
fn in_closed_loop_the_beam_reaches_the_apex_and_the_pose_is_true() {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), "twin.laser_offset_um = [60, -30]\ntwin.motion = []\n").unwrap();
    let output = simulate().args(["--samples", "400", "--closed-loop", "--config"]).arg(file.path()).output();
    let text = String::from_utf8(output.unwrap().stdout).unwrap();
    let rows: Vec<Vec<_>> = text.lines().map(|line| line.split(',').collect()).collect();
    let place = |name: &str| rows[0].iter().position(|column| *column == name).unwrap();
    let value = |row: usize, name: &str| rows[row][place(name)].parse::<f64>().unwrap();
    assert!((value(1, "true_beam_dx_m") - 60e-6).abs() < 1e-9 && rows[1][place("lock")] == "acquiring");
    assert!(value(400, "true_beam_dx_m").hypot(value(400, "true_beam_dy_m")) < 0.5e-6);
    assert!((value(400, "stage_x_m") + 60e-6).abs() < 0.5e-6 && rows[400][place("lock")] == "locked");
    assert!(rows[400][place("status")].contains("POSE_VALID"));
    let wrong = (1..=400).find(|row| (value(*row, "tx_m") - value(*row, "true_tx_m")).abs() > 7e-6);
    assert_eq!(wrong, None);
}
