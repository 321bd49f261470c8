//! `trifacet ctl record`, rotation, budget, and what is refused.

use std::{
    io::{Read as _, Write as _},
    net::TcpStream,
    process::Command,
};

use crate::fixture::{Content, Daemon, recordings, same};

#[test]
fn it_records_from_start_to_stop_and_says_so() {
    let mut daemon = Daemon::start("acquisition.rate_hz = 500");
    daemon.runs_for(0.2);
    let (code, answer, _) = daemon.ctl(&["record", "status"]);
    assert_eq!((code, &answer["recording"], &answer["mode"]), (0, &false.into(), &"off".into()));
    assert!(!daemon.folder().exists(), "nothing is recorded unless it is wanted");
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
    assert!(code != 0 && error.contains("on-fault"), "{error}");
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
fn files_follow_each_other_without_a_gap_and_the_oldest_go() {
    let mut daemon = Daemon::start(
        "acquisition.rate_hz = 4000\nrecording.mode = \"always\"\nrecording.compression = \"none\"\n\
         recording.rotate_mb = 4\nrecording.budget_gb = 0.013",
    );
    let mut foreign = None;
    for _ in 0..5 {
        daemon.says("recorded");
        foreign.get_or_insert_with(|| {
            let file = daemon.folder().join("aaa.mcap");
            std::fs::write(&file, "of somebody else").unwrap();
            file
        });
    }
    let stream = daemon.stop();
    assert!(foreign.unwrap().exists());
    let files: Vec<_> =
        recordings(&daemon.folder()).into_iter().filter(|f| !f.ends_with("aaa.mcap")).collect();
    assert!((2..=4).contains(&files.len()), "{files:?}");
    let bytes: u64 = files.iter().map(|file| file.metadata().unwrap().len()).sum();
    assert!(bytes < 18_000_000, "{bytes}");
    assert!(daemon.log.iter().any(|line| line.to_string().contains("deleted, to keep recording.budget_gb")));
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

#[test]
fn bad_values_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("bad.toml");
    for (text, key) in [
        ("folder = \"\"", "recording.folder"),
        ("mode = \"sometimes\"", "recording.mode"),
        ("compression = \"gzip\"", "recording.compression"),
        ("rotate_mb = 0", "recording.rotate_mb"),
        ("rotate_min = -1", "recording.rotate_min"),
        ("budget_gb = 1", "recording.budget_gb"),
        ("before_s = 1e9", "recording.before_s"),
        ("after_s = 0", "recording.after_s"),
    ] {
        std::fs::write(&file, format!("[recording]\n{text}\n")).unwrap();
        let output = Command::new(env!("CARGO_BIN_EXE_trifacet"))
            .args(["check", "--config"])
            .arg(&file)
            .output()
            .unwrap();
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(78), "{text}: {error}");
        assert!(
            error.contains(key) && (error.contains("allowed") || error.contains("expected one of")),
            "{text}: {error}"
        );
    }
}

const TOKEN: &str = "correct-horse-battery";

/// What the monitor answers.
fn http(at: &str, method: &str, path: &str, headers: &str, body: &str) -> String {
    let mut stream = TcpStream::connect(at).unwrap();
    let length = body.len();
    let head = format!("{method} {path} HTTP/1.1\r\nHost: {at}\r\n{headers}Content-Length: {length}");
    write!(stream, "{head}\r\nConnection: close\r\n\r\n{body}").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

#[test]
fn the_page_may_record_with_the_token_and_no_file_holds_it() {
    let mut daemon = Daemon::start(&format!(
        "acquisition.rate_hz = 500\nmonitor.listen = \"127.0.0.1:0\"\nmonitor.control = true\n\
         monitor.token = \"{TOKEN}\"\nrecording.compression = \"none\""
    ));
    let at = daemon.says("monitor is open")["url"].as_str().unwrap().replace("http://", "").replace('/', "");
    let order = |token: &str, what: &str| {
        let headers = format!("Content-Type: application/json\r\nAuthorization: Bearer {token}\r\n");
        http(&at, "POST", "/control", &headers, &format!("{{\"command\": \"record {what}\"}}"))
    };
    let gauge = || http(&at, "GET", "/metrics", "", "").contains("\ntrifacet_recording 1");
    assert!(order("another-secret-token", "start").contains(" 401 "));
    assert!(order(TOKEN, "trigger").contains(" 400 "), "not what the page has a button for");
    assert!(!gauge());
    assert!(order(TOKEN, "start").contains(" 200 "));
    assert!(gauge());
    daemon.runs_for(0.7);
    assert!(order(TOKEN, "stop").contains(" 200 "));
    assert!(!gauge());
    daemon.stop();
    let file = std::fs::read(&recordings(&daemon.folder())[0]).unwrap();
    let holds = |text: &str| file.windows(text.len()).any(|window| window == text.as_bytes());
    assert!(holds("rate_hz = 500") && !holds(TOKEN));
}
