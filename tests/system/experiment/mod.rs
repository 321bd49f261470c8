//! `trifacet experiment` through the binary: on the twin, with a daemon and typed readings, and in a browser.

mod guided;
mod refused;
mod report;
mod twin;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use crate::testkit;

const AXES: [&str; 6] = ["tx", "ty", "tz", "roll", "pitch", "yaw"];

/// The command with this output folder.
fn command(out: &Path, arguments: &[&str]) -> Command {
    let mut command = testkit::trifacet(&["experiment"]);
    command.arg("--out").arg(out).args(arguments);
    command
}

fn run(out: &Path, arguments: &[&str]) -> Output {
    command(out, arguments).output().unwrap()
}

/// Runs the command in a new folder; it must succeed.
fn done(arguments: &[&str]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let output = run(&out, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", said(&output));
    (folder, out)
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into()
}

/// The rows of a CSV file by column.
fn rows(file: &Path) -> Vec<BTreeMap<String, String>> {
    let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).from_path(file).unwrap();
    reader.deserialize().collect::<Result<_, _>>().unwrap()
}

fn number(row: &BTreeMap<String, String>, column: &str) -> f64 {
    row[column].parse().unwrap()
}

/// Table 2 as written: measured, paper, predicted, by axis.
fn table2(out: &Path) -> BTreeMap<String, [f64; 3]> {
    let stds = ["measured_std", "paper_std", "predicted_std"];
    rows(&out.join("table2.csv"))
        .iter()
        .map(|row| (row["axis"].clone(), stds.map(|s| number(row, s))))
        .collect()
}

/// Readings of the moved axis in um or urad, by point.
fn points(out: &Path, part: &str, axis: &str) -> Vec<Vec<f64>> {
    let column = if AXES[..3].contains(&axis) { format!("{axis}_m") } else { format!("{axis}_rad") };
    let mut points = BTreeMap::<u32, Vec<f64>>::new();
    for row in rows(&out.join("readings.csv")).iter().filter(|r| r["part"] == part && r["axis"] == axis) {
        points.entry(row["point"].parse().unwrap()).or_default().push(1e6 * number(row, &column));
    }
    points.into_values().collect()
}

fn deviation(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt()
}

/// The median of an odd number of values.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    assert_eq!(values.len() % 2, 1);
    values[values.len() / 2]
}
