//! Recordings and configurations of version 0.1.0, as that version wrote or shipped them
//! (`tests/fixtures/0.1.0`). The Python kit of that version is tested with the other kits.

use std::path::{Path, PathBuf};

use crate::testkit::on;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/0.1.0").join(name)
}

#[test]
fn a_recording_of_0_1_0_replays_bit_by_bit() {
    let done = on(&["replay"], &fixture("recording.mcap"));
    assert_eq!(done.code, 0, "{} {}", done.out, done.err);
    assert!(done.out.contains("800 of 800"), "{}", done.out);
}

/// The configuration id shows that head, channels and frames are unchanged.
#[test]
fn configurations_of_0_1_0_are_loaded_unchanged() {
    for (name, id) in
        [("default.toml", "d8b81aca"), ("serial-board.toml", "3717dd72"), ("service.toml", "d8b81aca")]
    {
        let done = on(&["check", "--config"], &fixture(name));
        assert_eq!(done.code, 0, "{name}: {} {}", done.out, done.err);
        assert!(done.out.contains(&format!("id {id}")), "{name}: {}", done.out);
    }
}
