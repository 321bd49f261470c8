//! `trifacet ctl record`, rotation, budget, and what is refused.

use super::fixture::{Content, Recorder, recordings, same};
use crate::testkit::{Folder, http, on};

#[test]
fn recording_runs_from_start_to_stop_and_the_status_reports_it() {
    let mut daemon = Recorder::start("acquisition.rate_hz = 500");
    daemon.runs_for(0.2);
    let (code, answer, _) = daemon.ctl(&["record", "status"]);
    assert_eq!((code, &answer["recording"], &answer["mode"]), (0, &false.into(), &"off".into()));
    assert!(!daemon.folder().exists(), "the default is no recording");
    let (code, answer, _) = daemon.ctl(&["record", "start"]);
    assert_eq!(code, 0, "{answer}");
    daemon.runs_for(1.0);
    let status = daemon.status();
    let file = status["recording"]["file"].as_str().unwrap().to_owned();
    assert!(file.ends_with(".mcap.part") && status["recording"]["recording"] == true, "{status}");
    assert!(status["recording"]["free_bytes"].as_u64().unwrap() > 0, "{status}");
    let (code, answer, _) = daemon.ctl(&["record", "stop"]);
    assert_eq!((code, &answer["recording"]["recording"]), (0, &false.into()));
    daemon.runs_for(0.5);
    let (code, _, error) = daemon.ctl(&["record", "trigger"]);
    assert!(code == 65 && error.contains("on-fault"), "{error}");
    let counters = &daemon.status()["counters"];
    assert_eq!((&counters["recording_overflows"], &counters["recording_files"]), (&0.into(), &1.into()));
    let stream = daemon.stop();
    let files = recordings(&daemon.folder());
    assert_eq!(files.len(), 1);
    let content = Content::read(&files[0]);
    assert!(content.whole);
    same(&content.frames(), &stream);
    assert!(content.frames().len() < stream.len());
    let mode = std::os::unix::fs::PermissionsExt::mode(&files[0].metadata().unwrap().permissions());
    assert_eq!(mode & 0o137, 0, "{mode:o}");
}

#[test]
fn files_are_contiguous_and_the_oldest_are_deleted() {
    let mut daemon = Recorder::start(
        "acquisition.rate_hz = 4000\nrecording.mode = \"always\"\nrecording.compression = \"none\"\n\
         recording.rotate_mb = 1\nrecording.budget_gb = 0.003",
    );
    let mut foreign = None;
    for _ in 0..8 {
        let file = daemon.message("recorded");
        let exists = std::path::Path::new(file["file"].as_str().unwrap()).exists();
        assert!(exists, "the current name of the file: {file}");
        foreign.get_or_insert_with(|| {
            let file = daemon.folder().join("aaa.mcap");
            std::fs::write(&file, "of another program").unwrap();
            file
        });
    }
    let stream = daemon.stop();
    assert!(foreign.unwrap().exists());
    let files: Vec<_> =
        recordings(&daemon.folder()).into_iter().filter(|f| !f.ends_with("aaa.mcap")).collect();
    assert!((2..=3).contains(&files.len()), "{files:?}");
    let bad: Vec<_> = daemon.log.iter().filter(|line| line["level"] == "ERROR").collect();
    assert!(bad.is_empty(), "{bad:#?}");
    assert!(
        !daemon.log.iter().any(|line| line.to_string().contains("cannot be deleted")),
        "{:#?}",
        daemon.log
    );
    assert!(
        daemon.log.iter().any(|line| line.to_string().contains("deleted to stay within recording.budget_gb"))
    );
    let contents: Vec<Content> = files.iter().map(|file| Content::read(file)).collect();
    for pair in contents.windows(2) {
        let [before, after] = pair else { unreachable!() };
        let [end, begin] = [before.sample_indices(), after.sample_indices()];
        assert_eq!(end.last().unwrap() + 1, begin[0]);
    }
    for content in &contents {
        assert!(content.whole && matches!(content.entries[0], trifacet::recording::Entry::Keyframe(_)));
        same(&content.frames(), &stream);
    }
}

/// Recordings of a time when the clock of the machine was wrong.
#[test]
fn names_from_the_future_are_deleted_before_any_other() {
    let home = Folder::new();
    let recordings = home.path("recordings");
    std::fs::create_dir(&recordings).unwrap();
    let names = ["20010101T000000.000Z", "20990102T000000.000Z", "20990101T000000.000Z"];
    let [old, later, sooner] = names.map(|time| {
        let path = recordings.join(format!("trifacet-{time}.mcap"));
        std::fs::write(&path, vec![0; 900_000]).unwrap();
        path.display().to_string()
    });
    let mut daemon = Recorder::start_in(
        &home,
        "acquisition.rate_hz = 4000\nrecording.mode = \"always\"\nrecording.compression = \"none\"\n\
         recording.rotate_mb = 1\nrecording.budget_gb = 0.003",
        &[],
    );
    let warning = daemon.message("recordings have names later than the present time");
    assert_eq!((&warning["files"], warning["first"].as_str()), (&2.into(), Some(&*sooner)), "{warning}");
    let mut deleted = Vec::new();
    for _ in 0..5 {
        let line = daemon.message("deleted to stay within recording.budget_gb");
        deleted.push(line["file"].as_str().unwrap().to_owned());
    }
    daemon.stop();
    assert_eq!(deleted[..3], [sooner, later, old], "{deleted:?}");
    assert!(deleted[3] < deleted[4], "today's in their order: {deleted:?}");
}

#[test]
fn the_name_of_a_file_is_the_time_of_its_start() {
    let mut daemon = Recorder::start("acquisition.rate_hz = 500");
    for _ in 0..2 {
        // The recorder receives no command in this time.
        daemon.runs_for(1.5);
        assert_eq!(daemon.ctl(&["record", "start"]).0, 0);
        daemon.runs_for(0.3);
        assert_eq!(daemon.ctl(&["record", "stop"]).0, 0);
    }
    daemon.stop();
    let files = recordings(&daemon.folder());
    assert_eq!(files.len(), 2);
    for file in files {
        let name = file.file_stem().unwrap().to_str().unwrap();
        let named = jiff::fmt::strtime::parse("trifacet-%Y%m%dT%H%M%S.%3fZ", name).unwrap();
        let named = named.to_datetime().unwrap().to_zoned(jiff::tz::TimeZone::UTC).unwrap().timestamp();
        let late_s =
            (i128::from(Content::read(&file).frames()[0].time_ns) - named.as_nanosecond()) as f64 * 1e-9;
        assert!(late_s.abs() < 1.0, "{name} begins {late_s} s later");
    }
}

#[test]
fn a_file_without_samples_is_deleted() {
    let mut daemon = Recorder::start("acquisition.rate_hz = 1");
    daemon.waits("at all", |_| true);
    for _ in 0..3 {
        for order in ["start", "stop"] {
            let (code, answer, error) = daemon.ctl(&["record", order]);
            assert_eq!(code, 0, "{answer} {error}");
        }
    }
    daemon.stop();
    // Occasionally a sample arrives between the two commands.
    assert!(
        daemon.log.iter().any(|line| line.to_string().contains("no samples received")),
        "{:#?}",
        daemon.log
    );
    for file in recordings(&daemon.folder()) {
        assert!(!Content::read(&file).frames().is_empty(), "{}", file.display());
    }
}

#[test]
fn two_daemons_in_one_folder_do_not_touch_each_others_files() {
    let mut first = Recorder::start(
        "acquisition.rate_hz = 2000\nrecording.mode = \"always\"\nrecording.compression = \"none\"",
    );
    first.message("recording");
    // More than the budget of the second daemon, and older than its own files.
    first.runs_for(2.5);
    let mut second = Recorder::start(&format!(
        "acquisition.rate_hz = 2000\nrecording.mode = \"always\"\nrecording.compression = \"none\"\n\
         recording.rotate_mb = 1\nrecording.budget_gb = 0.003\nrecording.folder = {:?}",
        first.folder()
    ));
    second.message("recorded");
    second.message("recording");
    second.stop();
    assert!(
        !second.log.iter().any(|line| line.to_string().contains("unfinished recording")),
        "{:#?}",
        second.log
    );
    let stream = first.stop();
    let content = Content::read(&recordings(&first.folder())[0]);
    assert!(content.whole && !first.log.iter().any(|line| line["level"] == "ERROR"), "{:#?}", first.log);
    same(&content.frames(), &stream);
}

#[test]
fn invalid_values_are_refused_by_name() {
    let folder = Folder::new();
    for (text, key) in [
        ("folder = \"\"", "recording.folder"),
        ("mode = \"sometimes\"", "recording.mode"),
        ("compression = \"gzip\"", "recording.compression"),
        ("rotate_mb = 0", "recording.rotate_mb"),
        ("rotate_min = -1", "recording.rotate_min"),
        ("budget_gb = 2.9", "recording.budget_gb = 2.9: allowed is at least 3"),
        ("budget_gb = 0", "recording.budget_gb"),
        ("budget_gb = nan", "recording.budget_gb"),
        ("before_s = 1e9", "recording.before_s"),
        ("after_s = 0", "recording.after_s"),
    ] {
        let done = on(&["check", "--config"], &folder.write("bad.toml", format!("[recording]\n{text}\n")));
        let error = done.err;
        assert_eq!(done.code, 78, "{text}: {error}");
        assert!(
            error.contains(key) && (error.contains("allowed") || error.contains("expected one of")),
            "{text}: {error}"
        );
        assert_eq!(error.lines().count(), 1, "one line: {error}");
    }
}

#[test]
fn check_describes_the_recording_and_notes_an_unusable_folder() {
    let home = Folder::new();
    let check = |text: &str| {
        let done = on(&["check", "--config"], &home.write("lab.toml", format!("[recording]\n{text}\n")));
        assert_eq!(done.code, 0, "{}", done.err);
        done.out
    };
    let told =
        check("mode = \"on-fault\"\nfolder = \"here\"\nbefore_s = 12\nrotate_mb = 77\nbudget_gb = 3.5");
    for part in ["12 s before", "/here", "77 MB", "3.5 GB"] {
        assert!(told.contains(part), "{part}: {told}");
    }
    assert!(!told.contains("recording.folder"), "the folder is made later: {told}");
    assert!(!home.path("here").exists(), "check does not make the folder");
    let told = check("mode = \"always\"\nfolder = \"missing/here\"");
    assert!(
        told.contains("note")
            && told.contains("recording.folder")
            && told.contains("/missing does not exist"),
        "{told}"
    );
    home.write("taken", "");
    let told = check("mode = \"always\"\nfolder = \"taken\"");
    assert!(told.contains("it is not a folder"), "{told}");
    assert!(check("").contains("off until"));
}

const TOKEN: &str = "correct-horse-battery";

#[test]
fn the_page_can_record_with_the_token_and_no_file_contains_the_token() {
    let mut daemon = Recorder::start(&format!(
        "acquisition.rate_hz = 500\nmonitor.listen = \"127.0.0.1:0\"\nmonitor.control = true\n\
         monitor.token = \"{TOKEN}\"\nrecording.compression = \"none\""
    ));
    let at = daemon.monitor();
    let order = |token: &str, what: &str| {
        let headers = format!("Content-Type: application/json\r\nAuthorization: Bearer {token}\r\n");
        http::post(at, "/control", &headers, &format!("{{\"command\": \"record {what}\"}}")).code
    };
    let gauge = || http::get(at, "/metrics").body.contains("\ntrifacet_recording 1");
    assert_eq!(order("another-secret-token", "start"), 401);
    assert_eq!(order(TOKEN, "trigger"), 400, "the page has no button for this");
    assert!(!gauge());
    assert_eq!(order(TOKEN, "start"), 200);
    assert!(gauge());
    daemon.runs_for(0.7);
    assert_eq!(order(TOKEN, "stop"), 200);
    assert!(!gauge());
    daemon.stop();
    let file = std::fs::read(&recordings(&daemon.folder())[0]).unwrap();
    let holds = |text: &str| file.windows(text.len()).any(|window| window == text.as_bytes());
    assert!(holds("rate_hz = 500") && !holds(TOKEN));
}
