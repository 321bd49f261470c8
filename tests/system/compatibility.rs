//! Recordings and configurations of version 0.1.0, as that version wrote or shipped them
//! (`tests/fixtures/0.1.0`). The Python kit of that version is tested with the other kits.

use std::path::{Path, PathBuf};

use crate::testkit::{self, Folder, on};

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

/// The twin without a head of its own: the same seed gives the same codes, fault and loop included.
#[test]
fn the_twin_gives_the_scans_of_0_1_0_to_the_last_code() {
    let folder = Folder::new();
    let config = folder.write(
        "twin.toml",
        "[steering]\ndeviation_um = 1.5\n[estimation]\nfuse_steering = true\n[twin]\nchannel_skew_us = 20.0\n[[twin.motion]]\naxis = 'tx'\namount_um = 200.0\nkind = 'sine'\n\
         frequency_hz = 3.0\n[[twin.fault]]\nat_s = 0.4\nfor_s = 0.1\nkind = 'psd-dark'\npsd = 1\n",
    );
    let again = folder.path("again.mcap");
    let done = testkit::trifacet(&["simulate", "--closed-loop", "--samples", "800", "--config"])
        .arg(&config)
        .arg("--record")
        .arg(&again)
        .output()
        .unwrap();
    assert!(done.status.success(), "{done:?}");
    let codes = |file: &Path| {
        let table = on(&["export", "--format", "csv", "--what", "samples", "--output", "-"], file).out;
        let mut table = csv::Reader::from_reader(table.as_bytes());
        let header = table.headers().unwrap().clone();
        let codes = header.iter().enumerate().filter(|(_, name)| name.starts_with("code_"));
        let places: Vec<_> = codes.map(|(place, _)| place).collect();
        assert_eq!(places.len(), 16);
        let row = |row: csv::StringRecord| places.iter().map(|p| row[*p].to_owned()).collect::<Vec<_>>();
        table.records().map(|r| row(r.unwrap())).collect::<Vec<_>>()
    };
    let (then, now) = (codes(&fixture("recording.mcap")), codes(&again));
    assert_eq!((then.len(), now.len()), (800, 800));
    let first = then.iter().zip(&now).position(|(then, now)| then != now);
    assert_eq!(first, None, "the first scan that differs");
}
