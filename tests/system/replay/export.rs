//! Export of tables from a recording.

use std::process::Command;

use super::fixture::Lab;
use crate::testkit::{on, run, trifacet};

#[test]
#[cfg(not(feature = "parquet"))]
fn a_build_without_parquet_reports_the_missing_feature() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "", 100);
    let done = on(&["export", "--format", "parquet"], &file);
    assert!(done.code == 64 && done.err.contains("--features parquet"), "{}", done.err);
    assert!(!lab.path("a.parquet").exists());
}

#[test]
fn errors_name_the_file_and_nothing_is_overwritten() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "", 2000);
    let export = |args: &[&str]| run(trifacet(&["export"]).arg(&file).args(args));
    let there = lab.write("a.csv", "mine");
    let done = export(&["--format", "csv"]);
    assert!(done.code == 74 && done.err.contains("a.csv exists already"), "{}", done.err);
    assert_eq!(std::fs::read_to_string(there).unwrap(), "mine");
    let done = export(&["--format", "csv", "--output", "/nowhere/b.csv"]);
    assert!(done.code == 74 && done.err.contains("/nowhere/b.csv"), "{}", done.err);
    let done = on(&["export", "--format", "csv"], &lab.path("nothing.mcap"));
    assert!(done.code == 74 && done.err.contains("nothing.mcap"), "{}", done.err);
    let done = export(&["--format", "xml"]);
    assert!(done.code == 64 || done.code == 2, "{}", done.err);
}

#[test]
fn a_full_disk_is_reported_and_leaves_no_partial_table() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "", 5000);
    let out = lab.path("out.csv");
    // Files may not grow beyond 100 kB in this shell: writing fails as on a full disk.
    let script = "ulimit -f 100; trap '' XFSZ; exec \"$@\"";
    let mut command = Command::new("bash");
    command.args([
        "-c",
        script,
        "-",
        env!("CARGO_BIN_EXE_trifacet"),
        "export",
        "--format",
        "csv",
        "--output",
    ]);
    let done = run(command.arg(&out).arg(&file));
    assert!(
        done.code == 74 && done.err.contains("cannot write") && done.err.contains("out.csv"),
        "{}",
        done.err
    );
    assert!(!out.exists());
}
