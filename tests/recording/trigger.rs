//! Recordings that begin before the fault.

use std::fmt::Write as _;

use trifacet::estimation::Status;

use crate::fixture::{Content, Daemon, recordings, same};

#[test]
fn a_fault_is_recorded_once_with_what_was_before() {
    let mut faults = String::from("twin.fault = [");
    // The second within the same episode.
    for at_s in [6.0, 6.4] {
        write!(faults, "{{ at_s = {at_s:.1}, for_s = 0.2, kind = \"beam-blocked\" }},").unwrap();
    }
    let mut daemon = Daemon::start(&format!(
        "acquisition.rate_hz = 1000\nrecording.mode = \"on-fault\"\nrecording.before_s = 2.0\n\
         recording.after_s = 1.0\n{faults}]"
    ));
    daemon.waits("without light", |frame| frame.status.has(Status::PSD_A_LOW));
    daemon.says("recorded");
    daemon.runs_for(1.5);
    let (code, answer, _) = daemon.ctl(&["record", "trigger"]);
    assert_eq!(code, 0, "{answer}");
    daemon.says("recorded");
    let stream = daemon.stop();
    let files = recordings(&daemon.folder());
    assert_eq!(files.len(), 2, "one for the episode, one that was asked for: {files:?}");
    let frames = Content::read(&files[0]).frames();
    same(&frames, &stream);
    let dark = stream.iter().find(|frame| frame.status.has(Status::PSD_A_LOW)).unwrap();
    let [before, after] = [dark.time_ns - frames[0].time_ns, frames.last().unwrap().time_ns - dark.time_ns];
    // Whole stretches of a second are kept, and what is too old goes with the next of them: 2 to 4 s.
    assert!(before > 1_900_000_000 && before < 5_000_000_000, "{before} ns of 6 s");
    assert!(after > 900_000_000, "{after} ns");
    let frames = Content::read(&files[1]).frames();
    same(&frames, &stream);
}
