//! Special files, other formats, and files that are not yet complete.

use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Stdio};

use rustix::process::{Pid, Signal, kill_process};

use super::fixture::Lab;
use crate::testkit::{on, run, trifacet, wait_for};

#[test]
fn a_file_that_is_not_a_recording_is_refused_without_waiting() {
    let lab = Lab::new();
    let pipe = lab.path("pipe.mcap");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let [empty, short] = [("empty.mcap", &b""[..]), ("short.mcap", b"\x89MCA")].map(|(n, b)| lab.write(n, b));
    for (file, told) in [
        (&*empty, "is not an MCAP file"),
        (&*short, "is not an MCAP file"),
        (&*pipe, "is a pipe: a recording is a file"),
        (Path::new("/dev/zero"), "is a device"),
        (Path::new("/tmp"), "is a folder"),
    ] {
        for command in [&["info"][..], &["replay"], &["recover"], &["export", "--format", "csv"]] {
            let done = on(command, file);
            assert!(done.code == 65 && done.err.contains(told), "{command:?}: {} {}", done.code, done.err);
        }
    }
    let done = on(&["info"], &lab.path("nothing.mcap"));
    assert_eq!(done.err.matches("No such file").count(), 1, "{}", done.err);
}

#[test]
fn one_bad_file_does_not_hide_the_others() {
    let lab = Lab::new();
    let (good, other) = (lab.record("a.mcap", "", 100), lab.record("b.mcap", "", 100));
    let text = lab.write("notes.txt", "none");
    let info = |args: &[&str]| run(trifacet(&["info"]).args(args).args([&good, &text, &other]));
    let done = info(&[]);
    assert!(done.code == 65 && done.out.contains("a.mcap") && done.out.contains("b.mcap"), "{}", done.out);
    assert!(
        done.err.contains("notes.txt is not an MCAP file") && done.err.contains("1 of 3"),
        "{}",
        done.err
    );
    let done = info(&["--json"]);
    let lines: Vec<serde_json::Value> =
        done.out.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.iter().map(|line| line["whole"] == true).collect::<Vec<_>>(), [true, false, true]);
    assert!(lines[1]["error"].as_str().unwrap().contains("not an MCAP file"), "{}", lines[1]);
    // The exit code is that of the most severe error.
    let done = run(trifacet(&["info"]).args([&lab.path("nothing.mcap"), &text, &good]));
    assert!(done.code == 74 && done.err.contains("2 of 3"), "{}", done.err);
}

/// The names of the files in a folder.
fn names(lab: &Lab) -> Vec<String> {
    let inside = fs::read_dir(lab.path("")).unwrap();
    let mut names: Vec<_> = inside.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn a_full_disk_leaves_no_partial_file() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "", 5000);
    let before = names(&lab);
    let replay = |out: &str| vec!["replay".into(), "--output".into(), lab.path(out), file.clone()];
    let simulate = ["simulate", "--closed-loop", "--samples", "5000", "--record"].map(Into::into).into();
    let simulate = [simulate, vec![lab.path("new.mcap")]].concat();
    let recover = vec!["recover".into(), file.clone(), lab.path("new.mcap")];
    for command in [replay("new.csv"), replay("new.mcap"), simulate, recover] {
        // Files may not grow beyond 100 kB in this shell: writing fails as on a full disk.
        let script = "ulimit -f 100; trap '' XFSZ; exec \"$@\"";
        let program = env!("CARGO_BIN_EXE_trifacet");
        let done = run(Command::new("bash").args(["-c", script, "-", program]).args(&command));
        assert!(
            done.code == 74 && done.err.contains("cannot write"),
            "{command:?}: {} {}",
            done.code,
            done.err
        );
        assert_eq!(names(&lab), before, "{command:?}");
    }
}

#[test]
fn an_interrupted_replay_leaves_no_file() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "", 1000);
    let (before, out) = (names(&lab), lab.path("out.csv"));
    let mut command = trifacet(&["replay", "--speed", "0.001", "--output"]);
    let mut child = command.arg(&out).arg(&file).stderr(Stdio::null()).spawn().unwrap();
    let files = format!("/proc/{}/fd", child.id());
    wait_for("a file that replay writes", || {
        let mut open = fs::read_dir(&files).unwrap().filter_map(|fd| fs::read_link(fd.ok()?.path()).ok());
        let begun = open.any(|to| to.starts_with(lab.path("")) && to != file);
        begun.then_some(()).ok_or_else(|| "none".into())
    });
    kill_process(Pid::from_child(&child), Signal::INT).unwrap();
    assert!(!child.wait().unwrap().success());
    assert_eq!(names(&lab), before);
    assert_eq!(run(trifacet(&["replay", "--output"]).arg(&out).arg(&file)).code, 0);
}

#[test]
fn a_new_file_has_the_permissions_of_its_source() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "", 500);
    fs::set_permissions(&file, Permissions::from_mode(0o600)).unwrap();
    assert_eq!(on(&["export", "--format", "csv"], &file).code, 0);
    assert_eq!(on(&["recover"], &file).code, 0);
    assert_eq!(run(trifacet(&["replay", "--output"]).arg(lab.path("b.mcap")).arg(&file)).code, 0);
    for new in ["a.csv", "a.recovered.mcap", "b.mcap"] {
        let mode = fs::metadata(lab.path(new)).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600, "{new}");
    }
}

#[test]
fn tables_can_go_to_standard_output_and_the_extension_must_match_the_format() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "", 300);
    let export = |args: &[&str]| run(trifacet(&["export"]).args(args).arg(&file).current_dir(lab.path("")));
    let done = export(&["--format", "csv", "--output", "-"]);
    assert!(done.code == 0 && done.out.lines().count() == 301, "{} {}", done.code, done.err);
    assert!(!lab.path("-").exists());
    let done = export(&["--format", "csv", "--output", "x.parquet"]);
    assert!(done.code == 64 && done.err.contains("--format csv"), "{}", done.err);
    let done = export(&["--format", "parquet", "--output", "-"]);
    assert!(done.code == 64 && done.err.contains("only --format csv"), "{}", done.err);
}

#[test]
fn a_damaged_index_loses_no_data_and_is_reported() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "", 3000);
    let mut bad = fs::read(&file).unwrap();
    // The end of the data is a record of 13 bytes that begins with 0x0f; the definitions follow again after
    // it.
    let end = bad.windows(9).rposition(|w| *w == [0x0f, 4, 0, 0, 0, 0, 0, 0, 0]).unwrap();
    bad[end + 13] = 0xee;
    let bad = lab.write("bad.mcap", &bad);
    let told = "the index after the data is damaged";
    let info = on(&["info"], &bad);
    assert!(info.code == 65 && info.out.contains(told) && !info.out.contains("a second"), "{}", info.out);
    let done = on(&["replay"], &bad);
    assert!(done.code == 0 && done.err.contains(told) && done.out.contains("3000 of 3000"), "{}", done.err);
    let done = on(&["recover"], &bad);
    assert!(done.code == 0 && done.err.contains("nothing is lost at the end"), "{}", done.err);
    assert_eq!(on(&["info"], &lab.path("bad.recovered.mcap")).code, 0);
}
