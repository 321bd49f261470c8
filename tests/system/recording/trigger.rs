//! Recordings triggered by a fault, with data from before it.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use trifacet_wire::Status;

use super::fixture::{Content, Recorder, recordings, same};

#[test]
fn a_fault_is_recorded_once_with_the_time_before_it() {
    let mut faults = String::from("twin.fault = [");
    // The second fault belongs to the same episode.
    for at_s in [6.0, 6.4] {
        write!(faults, "{{ at_s = {at_s:.1}, for_s = 0.2, kind = \"beam-blocked\" }},").unwrap();
    }
    let mut daemon = Recorder::start(&format!(
        "acquisition.rate_hz = 1000\nrecording.mode = \"on-fault\"\nrecording.before_s = 2.0\n\
         recording.after_s = 1.0\n{faults}]"
    ));
    daemon.waits("without light", |frame| frame.status.has(Status::PSD_A_LOW));
    daemon.message("recorded");
    daemon.runs_for(1.5);
    let (code, answer, _) = daemon.ctl(&["record", "trigger"]);
    assert_eq!(code, 0, "{answer}");
    daemon.message("recorded");
    let stream = daemon.stop();
    let files = recordings(&daemon.folder());
    assert_eq!(files.len(), 2, "one for the episode, one by command: {files:?}");
    let frames = Content::read(&files[0]).frames();
    same(&frames, &stream);
    let dark = stream.iter().find(|frame| frame.status.has(Status::PSD_A_LOW)).unwrap();
    let [before, after] = [dark.time_ns - frames[0].time_ns, frames.last().unwrap().time_ns - dark.time_ns];
    // The buffer keeps whole blocks of about a second and deletes an old block only as a whole: 2 to 4 s.
    assert!(before > 1_900_000_000 && before < 5_000_000_000, "{before} ns of 6 s");
    assert!(after > 900_000_000, "{after} ns");
    let frames = Content::read(&files[1]).frames();
    same(&frames, &stream);
}

/// The sequence numbers of all frames in all files.
fn recorded(daemon: &Recorder) -> BTreeSet<u64> {
    let files = recordings(&daemon.folder());
    files.iter().flat_map(|file| Content::read(file).frames()).map(|frame| frame.sequence).collect()
}

#[test]
fn faults_in_close_succession_are_all_recorded() {
    let mut faults = String::from("twin.fault = [");
    // While the first file is about to end, and shortly after the end of the next one.
    for at_s in [4.0, 5.05, 6.5] {
        write!(faults, "{{ at_s = {at_s:.2}, for_s = 0.1, kind = \"beam-blocked\" }},").unwrap();
    }
    let mut daemon = Recorder::start(&format!(
        "acquisition.rate_hz = 1000\nrecording.mode = \"on-fault\"\nrecording.before_s = 1.0\n\
         recording.after_s = 1.0\n{faults}]"
    ));
    daemon.waits("at all", |_| true);
    let start_ns = daemon.frames()[0].time_ns;
    daemon.waits("after everything", |frame| frame.time_ns - start_ns > 8_500_000_000);
    let stream = daemon.stop();
    let dark: Vec<_> = stream.iter().filter(|frame| frame.status.has(Status::PSD_A_LOW)).collect();
    let [from, to] = [dark[0].time_ns - 900_000_000, dark[dark.len() - 1].time_ns + 800_000_000];
    assert!(to - from > 4_000_000_000, "three faults");
    let recorded = recorded(&daemon);
    let missing: Vec<_> = stream
        .iter()
        .filter(|frame| (from..to).contains(&frame.time_ns) && !recorded.contains(&frame.sequence))
        .map(|frame| frame.sequence)
        .collect();
    assert!(missing.is_empty(), "{} frames, {:?} to {:?}", missing.len(), missing.first(), missing.last());
}

#[test]
fn there_is_no_gap_between_a_stop_and_a_trigger() {
    let mut daemon = Recorder::start(
        "acquisition.rate_hz = 1000\nrecording.mode = \"on-fault\"\nrecording.before_s = 1.0\n\
         recording.after_s = 0.5",
    );
    daemon.runs_for(2.3);
    assert_eq!(daemon.ctl(&["record", "start"]).0, 0);
    daemon.runs_for(0.2);
    for order in ["stop", "trigger"] {
        let (code, answer, error) = daemon.ctl(&["record", order]);
        assert_eq!(code, 0, "{answer} {error}");
    }
    daemon.message("recorded");
    daemon.message("recorded");
    daemon.stop();
    assert_eq!(recordings(&daemon.folder()).len(), 2);
    let recorded = recorded(&daemon);
    let [first, last] = [recorded.first().unwrap(), recorded.last().unwrap()];
    assert_eq!(last - first + 1, recorded.len() as u64, "samples are missing");
}
