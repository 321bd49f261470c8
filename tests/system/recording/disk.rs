//! A full disk, a missing folder, and failing writes.

use std::process::Command;

use trifacet_wire::Status;

use super::fixture::{Content, Recorder, recordings};
use crate::testkit::Folder;

/// A full disk: a small file system in memory in its own mount namespace.
#[test]
fn a_full_disk_does_not_disturb_the_stream_and_recording_resumes_with_free_space() {
    let home = Folder::new();
    let disk = home.path("recordings");
    std::fs::create_dir(&disk).unwrap();
    let script = "mount -t tmpfs -o size=12m,mode=0777 none \"$0\" && head -c 6000000 /dev/zero > \"$0/ballast\" && exec \"$@\"";
    let through =
        ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", script, disk.to_str().unwrap()];
    let mut daemon = Recorder::start_in(
        &home,
        "acquisition.rate_hz = 2000\nrecording.mode = \"always\"\nrecording.compression = \"none\"",
        &through,
    );
    daemon.waits("at all", |_| true);
    // The test accesses the disk through the root folder of the daemon in /proc.
    let pid = daemon.status()["pid"].as_u64().unwrap_or_else(|| panic!("a user namespace is needed here"));
    let inside = std::path::PathBuf::from(format!("/proc/{pid}/root{}", disk.display()));
    daemon.waits("with the fault", |frame| frame.status.has(Status::RECORDING_FAULT));
    let error = daemon.message("recording stopped");
    assert!(error["message"].as_str().unwrap().contains("recording.folder"), "{error}");
    let status = daemon.status();
    assert_eq!(status["counters"]["recording_faults"], 1, "{status}");
    assert!(status["recording"]["fault"].as_str().is_some(), "{status}");
    daemon.runs_for(1.5);
    let lost = daemon.status()["counters"]["recording_lost"].as_u64().unwrap();
    assert!(lost > 0);
    std::fs::remove_file(inside.join("ballast")).unwrap();
    daemon.waits("without the fault", |frame| !frame.status.has(Status::RECORDING_FAULT));
    daemon.message("recording continues");
    daemon.runs_for(0.7);
    let files = recordings(&inside);
    assert_eq!(files.len(), 2, "{files:?}");
    let [first, second] = [Content::read(&files[0]), Content::read(&files[1])];
    assert!(!first.frames().is_empty() && !second.frames().is_empty());
    assert_eq!((first.gaps, second.gaps), (0, 1), "the second file records the gap");
    let stream = daemon.stop();
    let lost: u64 = stream.iter().map(|frame| u64::from(frame.lost)).sum();
    assert_eq!(lost, 0);
    let valid = stream.iter().filter(|frame| frame.status.has(Status::RECORDING_FAULT | Status::POSE_VALID));
    assert!(valid.count() > 1000, "poses continue during the fault");
}

#[test]
fn a_folder_that_cannot_be_made_is_reported_and_used_as_soon_as_possible() {
    let mut daemon = Recorder::start(
        "acquisition.rate_hz = 200\nrecording.mode = \"always\"\nrecording.folder = \"missing/recordings\"",
    );
    daemon.waits("with the fault", |frame| frame.status.has(Status::RECORDING_FAULT));
    let (code, _, error) = daemon.ctl(&["record", "start"]);
    assert!(
        code == 74 && error.contains("missing/recordings"),
        "recording is enabled already and has a fault: {error}"
    );
    std::fs::create_dir(daemon.home.path("missing")).unwrap();
    daemon.waits("without the fault", |frame| !frame.status.has(Status::RECORDING_FAULT));
    daemon.runs_for(0.7);
    daemon.stop();
    let files = recordings(&daemon.home.path("missing/recordings"));
    assert_eq!(files.len(), 1);
    assert_eq!(Content::read(&files[0]).gaps, 1);
}

#[test]
fn a_start_that_fails_is_refused_with_the_reason() {
    let daemon = Recorder::start("acquisition.rate_hz = 200\nrecording.folder = \"/proc/recordings\"");
    daemon.runs_for(0.2);
    let (code, answer, error) = daemon.ctl(&["record", "start"]);
    assert!(code == 74 && error.contains("/proc/recordings"), "{answer} {error}");
    assert!(
        !daemon.waits("at all", |_| true).status.has(Status::RECORDING_FAULT),
        "a fault without a request"
    );
    // The daemon does not retry a refused start.
    let (_, status, _) = daemon.ctl(&["record", "status"]);
    assert_eq!(status["recording"], false);
    let check = Command::new("ls").arg("/proc/recordings").output().unwrap();
    assert!(!check.status.success());
}

#[test]
fn a_folder_that_is_moved_away_is_detected_and_made_again() {
    let mut daemon = Recorder::start("acquisition.rate_hz = 500\nrecording.mode = \"always\"");
    daemon.runs_for(0.8);
    let moved = daemon.home.path("moved");
    std::fs::rename(daemon.folder(), &moved).unwrap();
    daemon.waits("with the fault", |frame| frame.status.has(Status::RECORDING_FAULT));
    let error = daemon.message("recording stopped");
    assert!(error["message"].as_str().unwrap().contains("moved"), "{error}");
    daemon.waits("without the fault", |frame| !frame.status.has(Status::RECORDING_FAULT));
    daemon.runs_for(0.7);
    daemon.stop();
    let [old, new] = [moved, daemon.folder()].map(|folder| recordings(&folder));
    let ([old], [new]) = (old.as_slice(), new.as_slice()) else { panic!("{old:?} {new:?}") };
    assert!(!Content::read(old).frames().is_empty());
    let new = Content::read(new);
    assert!(new.whole && new.gaps == 1, "the second file records the gap");
}

#[test]
fn a_deleted_file_is_not_reported_as_recorded() {
    let mut daemon = Recorder::start("acquisition.rate_hz = 500");
    daemon.runs_for(0.2);
    assert_eq!(daemon.ctl(&["record", "start"]).0, 0);
    daemon.runs_for(0.2);
    let [file] = &recordings(&daemon.folder())[..] else { panic!("no file") };
    std::fs::remove_file(file).unwrap();
    let (code, answer, error) = daemon.ctl(&["record", "stop"]);
    assert!(code == 74 && error.contains("deleted"), "{answer} {error}");
    daemon.stop();
    assert!(!daemon.log.iter().any(|line| line["message"] == "recorded"), "{:#?}", daemon.log);
    assert!(recordings(&daemon.folder()).is_empty());
}

/// A write that fails late, at the limit of the system for the size of a file.
#[test]
fn a_failed_write_is_reported_with_its_reason_and_the_next_file_records_the_gap() {
    let script = "ulimit -f 3000; exec \"$@\"";
    let mut daemon = Recorder::start_in(
        &Folder::new(),
        "acquisition.rate_hz = 1000\nrecording.mode = \"always\"\nrecording.compression = \"none\"",
        &["sh", "-c", script, "sh"],
    );
    let error = daemon.message("recording stopped");
    assert!(error["message"].as_str().unwrap().contains("File too large"), "{error}");
    assert!(error["message"].as_str().unwrap().contains("reduce recording.rotate_mb"), "{error}");
    daemon.message("recording continues");
    let lost: u64 = daemon.stop().iter().map(|frame| u64::from(frame.lost)).sum();
    assert_eq!(lost, 0, "the stream continues");
    let files = recordings(&daemon.folder());
    assert!(files.len() >= 2, "{files:?}");
    let [first, second] = [&files[0], &files[1]].map(|file| Content::read(file));
    assert_eq!((first.gaps, second.gaps), (0, 1));
    let [end, begin] = [first.sample_indices(), second.sample_indices()];
    let missing = begin[0] - end.last().unwrap() - 1;
    // Two entries for each sample, the sample and its frame, and the keyframes.
    assert!(
        (2 * missing..2 * missing + 10).contains(&second.missing),
        "{missing} samples: {}",
        second.missing
    );
}
