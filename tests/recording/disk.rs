//! A disk that is full, and a folder that is not there.

use std::process::Command;

use trifacet::estimation::Status;

use crate::fixture::{Content, Daemon, recordings};

/// A full disk: a small file system in memory, in a namespace of its own.
#[test]
fn a_full_disk_harms_no_stream_and_recording_resumes_when_there_is_room() {
    let home = tempfile::tempdir().unwrap();
    let disk = home.path().join("recordings");
    std::fs::create_dir(&disk).unwrap();
    let script = "mount -t tmpfs -o size=12m,mode=0777 none \"$0\" && head -c 6000000 /dev/zero > \"$0/ballast\" && exec \"$@\"";
    let through =
        ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", script, disk.to_str().unwrap()];
    let mut daemon = Daemon::start_in(
        home,
        "acquisition.rate_hz = 2000\nrecording.mode = \"always\"\nrecording.compression = \"none\"",
        &through,
    );
    daemon.waits("at all", |_| true);
    // From outside, the disk is seen through the daemon's own eyes.
    let pid = daemon.status()["pid"].as_u64().unwrap_or_else(|| panic!("a user namespace is needed here"));
    let inside = std::path::PathBuf::from(format!("/proc/{pid}/root{}", disk.display()));
    daemon.waits("with the fault", |frame| frame.status.has(Status::RECORDING_FAULT));
    let error = daemon.says("nothing is recorded");
    assert!(error["message"].as_str().unwrap().contains("recording.folder"), "{error}");
    let status = daemon.status();
    assert_eq!(status["counters"]["recording_faults"], 1, "{status}");
    assert!(status["recording"]["fault"].as_str().is_some(), "{status}");
    daemon.runs_for(1.5);
    let lost = daemon.status()["counters"]["recording_lost"].as_u64().unwrap();
    assert!(lost > 0);
    std::fs::remove_file(inside.join("ballast")).unwrap();
    daemon.waits("without the fault", |frame| !frame.status.has(Status::RECORDING_FAULT));
    daemon.says("recording goes on");
    daemon.runs_for(0.7);
    let files = recordings(&inside);
    assert_eq!(files.len(), 2, "{files:?}");
    let [first, second] = [Content::read(&files[0]), Content::read(&files[1])];
    assert!(!first.frames().is_empty() && !second.frames().is_empty());
    assert_eq!((first.gaps, second.gaps), (0, 1), "the second says what is missing");
    let stream = daemon.stop();
    let lost: u64 = stream.iter().map(|frame| u64::from(frame.lost)).sum();
    assert_eq!(lost, 0);
    let valid = stream.iter().filter(|frame| frame.status.has(Status::RECORDING_FAULT | Status::POSE_VALID));
    assert!(valid.count() > 1000, "poses go on during the fault");
}

#[test]
fn a_folder_that_cannot_be_made_is_told_and_used_once_it_can() {
    let mut daemon = Daemon::start(
        "acquisition.rate_hz = 200\nrecording.mode = \"always\"\nrecording.folder = \"missing/recordings\"",
    );
    daemon.waits("with the fault", |frame| frame.status.has(Status::RECORDING_FAULT));
    let (code, _, error) = daemon.ctl(&["record", "start"]);
    assert_eq!(code, 0, "it is wanted already: {error}");
    std::fs::create_dir(daemon.home.path().join("missing")).unwrap();
    daemon.waits("without the fault", |frame| !frame.status.has(Status::RECORDING_FAULT));
    daemon.runs_for(0.7);
    daemon.stop();
    let files = recordings(&daemon.home.path().join("missing/recordings"));
    assert_eq!(files.len(), 1);
    assert_eq!(Content::read(&files[0]).gaps, 1);
}

#[test]
fn a_start_that_cannot_be_is_refused_with_the_reason() {
    let daemon = Daemon::start("acquisition.rate_hz = 200\nrecording.folder = \"/proc/recordings\"");
    daemon.runs_for(0.2);
    let (code, answer, error) = daemon.ctl(&["record", "start"]);
    assert!(code != 0 && error.contains("/proc/recordings"), "{answer} {error}");
    assert!(!daemon.waits("at all", |_| true).status.has(Status::RECORDING_FAULT), "nobody expects a file");
    // Nor is it tried behind everybody's back.
    let (_, status, _) = daemon.ctl(&["record", "status"]);
    assert_eq!(status["recording"], false);
    let check = Command::new("ls").arg("/proc/recordings").output().unwrap();
    assert!(!check.status.success());
}
