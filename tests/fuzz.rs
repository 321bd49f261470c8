//! A short run of every fuzz target; `fuzz/run 300` is a long one.

use std::io::Write;
use std::process::Command;

#[test]
fn no_decoder_falls_within_seconds() {
    let nightly = Command::new("rustup").args(["run", "nightly", "rustc", "--version"]).output();
    if !nightly.is_ok_and(|output| output.status.success()) {
        assert!(
            std::env::var_os("CI").is_none(),
            "fuzzing needs the nightly toolchain, and in CI it must run"
        );
        let note = "NOT RUN: fuzzing needs the nightly toolchain (rustup toolchain install nightly)";
        writeln!(std::io::stderr(), "{note}").expect("standard error");
        return;
    }
    // The toolchain and flags of this test run are not those of the fuzzer.
    let run = Command::new(concat!(env!("CARGO_MANIFEST_DIR"), "/fuzz/run"))
        .arg("5")
        .env_remove("RUSTUP_TOOLCHAIN")
        .env_remove("CARGO")
        .output()
        .expect("fuzz/run");
    let said = [run.stdout, run.stderr].map(|text| String::from_utf8_lossy(&text).into_owned());
    assert!(run.status.success(), "{}{}", said[0], said[1]);
    for target in ["board", "commands", "gcs", "recording", "stream"] {
        assert!(said[0].contains(&format!("fuzzing {target} ")), "{}", said[0]);
    }
}
