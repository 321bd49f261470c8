//! `trifacet emulate` through the binary.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, Stdio};

use rustix::process::{Pid, Signal, kill_process};

use crate::testkit;

fn emulate(link: &Path) -> Child {
    testkit::trifacet(&["emulate", "--link"])
        .arg(link)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

#[test]
fn emulate_links_to_its_port_obeys_orders_and_ends_in_order() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("board");
    std::os::unix::fs::symlink("/nowhere", &link).unwrap();
    for signal in [Signal::TERM, Signal::INT] {
        let mut child = emulate(&link);
        let mut out = BufReader::new(child.stdout.take().unwrap()).lines().map(Result::unwrap);
        let port = out.next().unwrap();
        assert_eq!(fs::read_link(&link).unwrap(), Path::new(&port));
        let mut orders = child.stdin.take().unwrap();
        writeln!(orders, "explode 5\nstatus\npose 100 0 0 0 0 -250 0").unwrap();
        let status: serde_json::Value = serde_json::from_str(&out.next().unwrap()).unwrap();
        assert_eq!((&status["started"], &status["steering"]), (&false.into(), &"idle".into()));
        assert_eq!(status["output_um"], serde_json::json!([0.0, 0.0]));
        let there = serde_json::json!([1e-4, 0.0, 0.0, 0.0, 0.0, -2.5e-4]);
        loop {
            writeln!(orders, "status").unwrap();
            let status: serde_json::Value = serde_json::from_str(&out.next().unwrap()).unwrap();
            if status["mirror"] == there {
                break;
            }
        }
        writeln!(orders, "unplug 0.05").unwrap();
        let port = out.next().unwrap();
        assert_eq!(fs::read_link(&link).unwrap(), Path::new(&port), "plugged in again");
        drop(orders); // the end of its input does not end the emulator
        kill_process(Pid::from_child(&child), signal).unwrap();
        let end = child.wait_with_output().unwrap();
        assert!(end.status.success());
        let errors = String::from_utf8(end.stderr).unwrap();
        assert!(errors.contains("not a command: `explode 5`") && errors.contains("beam-blocked"), "{errors}");
        assert!(fs::symlink_metadata(&link).is_err(), "the link is gone");
        std::os::unix::fs::symlink(&port, &link).unwrap();
    }
}

#[test]
fn emulate_does_not_replace_a_file_that_is_not_a_link() {
    let file = tempfile::NamedTempFile::new().unwrap();
    let end = emulate(file.path()).wait_with_output().unwrap();
    assert_eq!(end.status.code(), Some(74));
    let errors = String::from_utf8(end.stderr).unwrap();
    assert!(
        errors.contains(file.path().to_str().unwrap()) && errors.contains("not a symbolic link"),
        "{errors}"
    );
    assert!(fs::symlink_metadata(file.path()).unwrap().is_file());
}
