//! The page of a daemon that replays a recording: its headline states that the data are not live.

use std::path::Path;

use serde_json::json;

use super::looks::{CONTRAST, MISFITS};
use super::{DESK, daemon};
use crate::testkit::{Browser, Daemon, Stream, on};

/// A daemon that replays `ms` milliseconds of the twin, and its page.
fn replayed(folder: &Path, ms: u32, how: &str) -> (Daemon, Stream, Browser) {
    let file = folder.join("a.mcap");
    let recorded = on(&["simulate", "--closed-loop", "--samples", &ms.to_string(), "--record"], &file);
    assert_eq!(recorded.code, 0, "{}", recorded.err);
    let (daemon, stream, at) = daemon(&format!(
        "acquisition.source = \"replay\"\nreplay.file = \"{}\"\n{how}\n\
         monitor.control = true\nmonitor.token = \"0123456789abcdef\"\n",
        file.display()
    ));
    (daemon, stream, Browser::open(&format!("http://{at}/"), DESK))
}

/// Waits for a headline.
fn says(page: &mut Browser, text: &str) {
    let whole = format!("Replay of a.mcap, recorded 1970-01-01 00:00:00 UTC: {text}");
    page.until(&format!("document.querySelector('#headline .text')?.textContent === '{whole}'"));
    assert_eq!(page.eval("document.querySelector('#headline').dataset.grade"), "note");
    assert_eq!(page.eval("document.body.classList.contains('stale')"), false, "frames arrive");
}

/// Checks both themes on a desktop and on a phone. The pictures are for inspection by eye.
fn fits(page: &mut Browser, name: &str) {
    for (size, width) in [(DESK, "1280"), ([390, 844], "390")] {
        page.size(size);
        for scheme in ["light", "dark"] {
            page.scheme(scheme);
            page.until(&format!("{MISFITS}.length === 0")); // charts follow the size when they are visible
            page.drawn();
            let picture = format!("{name}-{width}-{scheme}.png");
            page.picture(&Path::new(env!("CARGO_TARGET_TMPDIR")).join(picture));
            assert_eq!(page.eval(MISFITS), json!([]), "{name} {width} {scheme}");
            let worst = page.eval(CONTRAST);
            assert!(worst[0].as_f64().unwrap() >= 4.5, "{name} {width} {scheme}: {worst}");
        }
    }
}

#[test]
fn the_headline_states_the_replay_and_controls_are_disabled() {
    let folder = tempfile::tempdir().unwrap();
    let (_daemon, _stream, mut page) = replayed(folder.path(), 20_000, "replay.repeat = true");
    says(&mut page, "pose valid, beam locked");
    page.until("document.querySelectorAll('.strips canvas').length >= 6");
    let offered = page.eval("document.querySelectorAll('#control :is(button, input):not(:disabled)').length");
    assert_eq!(offered, 0);
    assert_eq!(
        page.eval("document.querySelector('#answer').textContent"),
        "◆ A recording is replayed: commands are not available"
    );
    let loops = page.eval(
        "[...document.querySelectorAll('#beam-facts div, #facts div')].map((e) => e.textContent).filter((t) => t.startsWith('loop'))",
    );
    assert_eq!(loops, json!(["loopnone: a replay", "loopnone: a replay"]));
    fits(&mut page, "replay");
    assert_eq!(page.complaints(), Vec::<String>::new());
}

#[test]
fn at_the_end_of_a_recording_the_headline_states_it() {
    let folder = tempfile::tempdir().unwrap();
    let (_daemon, _stream, mut page) = replayed(folder.path(), 2000, "");
    says(&mut page, "ended");
    page.until("document.querySelector('#beam-facts').innerText.includes('held')");
    fits(&mut page, "replay-end");
    assert_eq!(page.complaints(), Vec::<String>::new());
}
