//! Tables of a recording, read by pandas.

use std::path::PathBuf;
use std::process::Command;

use super::fixture::{EVENTFUL, Lab};
use crate::testkit::{on, venv};

fn pandas() -> Command {
    let python: PathBuf = venv::python("replay-venv", "pandas, pyarrow", &["pandas", "pyarrow"]);
    Command::new(python)
}

#[test]
fn pandas_reads_the_same_numbers_from_both_forms_bit_by_bit() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", EVENTFUL, 5000);
    for what in ["frames", "samples"] {
        for format in ["csv", "parquet"] {
            let done = on(&["export", "--what", what, "--format", format], &file);
            assert_eq!(done.code, 0, "{}", done.err);
            assert!(done.err.contains("rows in"), "{}", done.err);
        }
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/system/replay/tables.py");
    let output = pandas().arg(script).arg(lab.path("a")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn rows_beyond_one_row_group_are_complete() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "acquisition.rate_hz = 20000", 70_000);
    assert_eq!(on(&["export", "--format", "parquet"], &file).code, 0);
    let check = "import sys, pandas; d = pandas.read_parquet(sys.argv[1]); \
                 assert list(d.sample_index) == list(range(70000)), d";
    let output = pandas().args(["-c", check]).arg(lab.path("a.parquet")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}
