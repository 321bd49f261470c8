//! The recording of a daemon that is killed.

use super::fixture::{Content, Recorder, recordings, same};

/// In the time of the stream: a flush each half second, and the same again for a busy machine.
const MOST_LOST_S: f64 = 1.0;

#[test]
fn a_killed_daemon_loses_at_most_the_last_second() {
    // 20 times that are not related to the flushes, the same in each run.
    for n in 0..20_u32 {
        let after_s = 0.7 + f64::from(n * 7919 % 1000) / 1000.0;
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
