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
    assert!(done.out.contains("2000 of 2000"), "{}", done.out);
}

#[test]
fn configurations_of_0_1_0_are_loaded_unchanged() {
    for name in ["default.toml", "serial-board.toml", "service.toml"] {
        let done = on(&["check"], &fixture(name));
        assert_eq!(done.code, 0, "{name}: {} {}", done.out, done.err);
    }
}
