//! The recording of a daemon that is killed.

use super::fixture::{Content, Recorder, recordings, same};
use crate::testkit::on;

/// In the time of the stream: a flush each half second, and the same again for a busy machine.
const MOST_LOST_S: f64 = 1.0;

#[test]
fn a_killed_daemon_loses_at_most_the_last_second() {
    // 20 times that are not related to the flushes, the same in each run; four daemons at a time.
    let times = (0..20_u32).map(|n| 0.7 + f64::from(n * 7919 % 1000) / 1000.0).collect::<Vec<_>>();
    for times in times.chunks(4) {
        std::thread::scope(|scope| {
            for after_s in times {
                scope.spawn(|| killed_after(*after_s));
            }
        });
    }
}

fn killed_after(after_s: f64) {
    let mut daemon = Recorder::start("acquisition.rate_hz = 1000\nrecording.mode = \"always\"");
    daemon.runs_for(after_s);
    daemon.kill();
    let stream = daemon.frames();
    let files = recordings(&daemon.folder());
    let [file] = files.as_slice() else { panic!("{files:?}") };
    assert!(file.to_str().unwrap().ends_with(".mcap.part"), "{}", file.display());
    let content = Content::read(file);
    assert!(!content.whole);
    let frames = content.frames();
    same(&frames, &stream);
    let lost_s = (stream.last().unwrap().time_ns - frames.last().unwrap().time_ns) as f64 * 1e-9;
    assert!(lost_s <= MOST_LOST_S, "{lost_s} s are missing after {after_s} s");
    let samples = content.sample_indices();
    assert!(samples.windows(2).all(|pair| pair[1] == pair[0] + 1), "a sample is missing");
}

#[test]
fn the_next_daemon_reports_unfinished_files() {
    let config = "acquisition.rate_hz = 200\nrecording.mode = \"always\"";
    let mut daemon = Recorder::start(config);
    daemon.runs_for(1.0);
    daemon.kill();
    let mut next = Recorder::start_in(&daemon.home, config, &[]);
    let line = next.message("trifacet recover");
    assert!(line["file"].as_str().unwrap().ends_with(".mcap.part"), "{line}");
    next.runs_for(0.7);
    next.stop();
    let files = recordings(&next.folder());
    let finished = files.iter().filter(|file| file.extension().unwrap() == "mcap").count();
    assert_eq!((files.len(), finished), (2, 1), "the unfinished file is not changed: {files:?}");
}

/// The beginning of a recording, up to its first data.
fn without_data(bytes: &[u8]) -> &[u8] {
    const MAGIC: usize = 8;
    const CHUNK: u8 = 6;
    let mut at = MAGIC;
    while bytes[at] != CHUNK {
        at += 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
    }
    &bytes[..at]
}

#[test]
fn unfinished_files_without_data_are_deleted_and_unreadable_ones_are_named() {
    let config = "acquisition.rate_hz = 200\nrecording.mode = \"always\"";
    let mut daemon = Recorder::start(config);
    daemon.runs_for(1.0);
    daemon.kill();
    let [good] = &recordings(&daemon.folder())[..] else { panic!("one file") };
    let bytes = std::fs::read(good).unwrap();
    let begun = without_data(&bytes).to_vec();
    let torn = [&begun[..], &[6, 255, 0, 0, 0, 0, 0, 0, 0, 1, 2, 3]].concat();
    let left =
        [("1", Vec::new(), "empty"), ("2", begun, "nothing to restore"), ("3", torn, "incomplete chunk")];
    let file = |n: &str| daemon.folder().join(format!("trifacet-2026010{n}T000000.000Z.mcap.part"));
    for (n, bytes, why) in &left {
        std::fs::write(file(n), bytes).unwrap();
        for command in ["info", "recover"] {
            let done = on(&[command], &file(n));
            assert_eq!(done.code, 65, "{}", done.err);
            assert!(command == "info" || done.err.lines().count() == 1, "the reason, once: {}", done.err);
            assert!((done.out + &done.err).contains(why), "{command} {n}");
        }
    }
    let mut next = Recorder::start_in(&daemon.home, config, &[]);
    for (n, message) in [
        ("1", "deleted an unfinished recording without data"),
        ("2", "deleted an unfinished recording without data"),
        ("3", "of which nothing can be read; delete it"),
    ] {
        let line = next.message(message);
        assert_eq!(line["file"], file(n).to_str().unwrap());
        assert_eq!(file(n).exists(), n == "3");
    }
    assert_eq!(next.message("trifacet recover")["file"], good.to_str().unwrap());
    next.runs_for(0.7);
    next.stop();
}
