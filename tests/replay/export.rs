//! Tables of a recording.

use std::path::PathBuf;
use std::process::Command;

use crate::fixture::{EVENTFUL, Lab, on, run, trifacet};
use crate::venv;

fn pandas() -> Command {
    let python: PathBuf = venv::python("replay-venv", "pandas, pyarrow", &["pandas", "pyarrow"]);
    Command::new(python)
}

/// The forms that this build has.
const FORMATS: &[&str] = if cfg!(feature = "parquet") { &["csv", "parquet"] } else { &["csv"] };

#[test]
#[cfg(not(feature = "parquet"))]
fn a_build_without_parquet_says_so() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "", 100);
    let done = on(&["export", "--format", "parquet"], &file);
    assert!(done.code == 64 && done.err.contains("--features parquet"), "{}", done.err);
    assert!(!lab.path("a.parquet").exists());
}

#[test]
#[cfg(feature = "parquet")]
fn pandas_reads_the_same_numbers_from_both_forms_bit_by_bit() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", EVENTFUL, 5000);
    for what in ["frames", "samples"] {
        for format in FORMATS {
            let done = on(&["export", "--what", what, "--format", format], &file);
            assert_eq!(done.code, 0, "{}", done.err);
            assert!(done.err.contains("rows in"), "{}", done.err);
        }
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/replay/tables.py");
    let output = pandas().arg(script).arg(lab.path("a")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
#[cfg(feature = "parquet")]
fn more_rows_than_fit_into_a_group_are_all_there() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "acquisition.rate_hz = 20000", 70_000);
    assert_eq!(on(&["export", "--format", "parquet"], &file).code, 0);
    let check = "import sys, pandas; d = pandas.read_parquet(sys.argv[1]); \
                 assert list(d.sample_index) == list(range(70000)), d";
    let output = pandas().args(["-c", check]).arg(lab.path("a.parquet")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn what_is_in_the_way_is_named_and_nothing_is_overwritten() {
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
fn a_full_disk_ends_with_a_message_and_leaves_no_half_table() {
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
