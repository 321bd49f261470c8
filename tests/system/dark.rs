//! `trifacet dark` through the binary.

use std::path::{Path, PathBuf};
use std::process::Output;

use trifacet::config;

use crate::testkit;

fn dark(file: &Path, more: &[&str]) -> Output {
    let mut command = testkit::trifacet(&["dark"]);
    command.arg("--config").arg(file).args(more).output().unwrap()
}

fn file(folder: &tempfile::TempDir, text: &str) -> PathBuf {
    let file = folder.path().join("lab.toml");
    std::fs::write(&file, text).unwrap();
    file
}

const TRUTH: [f64; 9] = [0.01, -0.02, 0.03, 0.004, 0.005, 0.006, -0.007, 0.008, 0.009];

#[test]
fn offsets_are_measured_and_written_and_the_rest_of_the_file_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let text =
        format!("# our lab\n[channels.a]  # first\ngain = [1.5, 1.0, 1.0]\n[twin]\ndark_v = {TRUTH:?}\n");
    let file = file(&folder, &text);
    let output = dark(&file, &["--samples", "1000"]);
    assert!(output.status.success(), "{output:?}");
    let after = config::load(Some(&file)).unwrap();
    for (psd, truth) in after.channels.psds().into_iter().zip(TRUTH.chunks(3)) {
        for (measured, truth) in psd.dark_v.iter().zip(truth) {
            // The position noise of the twin is 1.7 mV, the step of its converter 76 uV.
            assert!((measured - truth).abs() < 3e-4, "{measured} {truth}");
        }
    }
    let text = std::fs::read_to_string(&file).unwrap();
    assert!(text.starts_with("# our lab\n[channels.a]  # first\ngain = [1.5, 1.0, 1.0]\n"), "{text}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file is left");
}

#[test]
fn print_does_not_change_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let file = file(&folder, "[log]\n");
    let output = dark(&file, &["--samples", "50", "--print"]);
    assert!(output.status.success(), "{output:?}");
    assert!(String::from_utf8_lossy(&output.stdout).contains("[channels.c]\ndark_v = ["), "{output:?}");
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "[log]\n");
}

#[test]
fn light_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    // An offset that is too large for an amplifier: the command takes it for light.
    let text = "[twin]\ndark_v = [0.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0]\n";
    let file = file(&folder, text);
    let output = dark(&file, &["--samples", "50"]);
    assert_eq!(output.status.code(), Some(65), "{output:?}");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("PSD B sees light") && said.contains("2.0") && said.contains("0.5000 V"), "{said}");
    assert_eq!(std::fs::read_to_string(&file).unwrap(), text);
}

#[test]
fn a_missing_board_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let text = "[acquisition]\nsource = \"serial\"\n[acquisition.serial]\nport = \"/dev/no-such-port\"\n";
    let output = dark(&file(&folder, text), &[]);
    assert_eq!(output.status.code(), Some(69), "{output:?}");
    assert!(String::from_utf8_lossy(&output.stderr).contains("/dev/no-such-port"), "{output:?}");
}
