//! Damaged files: all damage is reported, no data are wrong without a message, nothing crashes.

use std::collections::BTreeSet;
use std::fs::File;
use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use trifacet::core::time::Mono;
use trifacet::recording::Entry;
use trifacet::recording::codec::{EncodeError, Encoder};
use trifacet::recording::reader::{Read, Reader};
use trifacet::recording::writer::Writer;

use super::fixture::{EVENTFUL, Lab};
use crate::testkit::{on, run, trifacet};

#[derive(Debug, thiserror::Error)]
pub(crate) enum Broken {
    #[error(transparent)]
    Encode(#[from] EncodeError),
    #[error(transparent)]
    File(#[from] mcap::McapError),
}

pub(crate) fn entries(file: &Path) -> Vec<Entry> {
    let mut reader = Reader::open(file, Reader::REPLAY).unwrap();
    std::iter::from_fn(|| reader.read().unwrap())
        .filter_map(|read| if let Read::Entry(entry) = read { Some(entry) } else { None })
        .collect()
}

pub(crate) fn write(entries: &[Entry], file: &Path) {
    let mut writer = Writer::new(File::create_new(file).unwrap(), None).unwrap();
    let mut encoder = Encoder::new((Mono(0), 0));
    for entry in entries {
        encoder.encode(entry, |message| writer.put(message).map_err(Broken::from)).unwrap();
    }
    writer.finish().unwrap();
}

/// The same recording with one number wrong.
pub(crate) fn forge(file: &Path, forged: &Path) {
    let mut entries = entries(file);
    for entry in &mut entries {
        if let Entry::Frame { frame, .. } = entry
            && frame.sample_index == 250
        {
            frame.pose[1] = f64::from_bits(frame.pose[1].to_bits() ^ 1);
        }
    }
    write(&entries, forged);
}

/// Two files of one recording, divided at a keyframe in its middle.
pub(crate) fn split(file: &Path, first: &Path, second: &Path) {
    let entries = entries(file);
    let keyframe = |i: &usize| matches!(entries[*i], Entry::Keyframe(_));
    let middle = (entries.len() / 2..entries.len()).find(keyframe).unwrap();
    write(&entries[..middle], first);
    write(&entries[middle..], second);
}

/// All readable entries as text.
fn contents(file: &Path) -> (Vec<String>, usize, bool) {
    let mut reader = Reader::open(file, Reader::REPLAY).unwrap();
    let mut entries = Vec::new();
    while let Some(read) = reader.read().unwrap() {
        if let Read::Entry(entry) = read {
            entries.push(format!("{entry:?}"));
        }
    }
    (entries, reader.tally().damages.len(), reader.tally().whole())
}

#[test]
fn each_flipped_bit_is_reported_or_harmless() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", EVENTFUL, 5000);
    let good = std::fs::read(&file).unwrap();
    let (whole, damages, fine) = contents(&file);
    assert!(damages == 0 && fine && whole.len() > 8000);
    let known: BTreeSet<&String> = whole.iter().collect();
    let mut random = Pcg64Mcg::seed_from_u64(6);
    let mut reported = 0;
    // At random places, and in the first bytes with the definitions.
    for n in 0..64 {
        let at = random.random_range(0..if n < 48 { good.len() } else { 200 });
        let bit = random.random_range(0..8);
        let mut bad = good.clone();
        bad[at] ^= 1 << bit;
        let bad = lab.write("bad.mcap", &bad);
        let (entries, damages, fine) = contents(&bad);
        assert!(entries.iter().all(|entry| known.contains(entry)), "byte {at}, bit {bit}: wrong data");
        if fine {
            assert_eq!(entries, whole, "byte {at}, bit {bit}: entries are missing without a message");
        } else {
            reported += 1;
            // The undamaged entries are present, and the commands do not fail.
            assert!(
                damages > 0 && entries.len() > whole.len() / 4,
                "byte {at}, bit {bit}: {}",
                entries.len()
            );
            if n % 8 == 0 {
                let done = on(&["info"], &bad);
                assert_eq!(done.code, 65, "byte {at}, bit {bit}: {}", done.out);
                let done = on(&["replay"], &bad);
                assert!(done.code == 65, "byte {at}, bit {bit}: {}", done.err);
                assert!(done.err.contains("damage at byte"), "byte {at}, bit {bit}: {}", done.err);
            }
        }
    }
    assert!(reported > 20, "{reported} of 64");
}

#[test]
fn after_damage_to_the_configuration_a_replay_continues_within_ten_seconds() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "acquisition.rate_hz = 500", 12_500);
    let mut bad = std::fs::read(&file).unwrap();
    bad[10_000] ^= 1;
    let done = on(&["replay"], &lab.write("bad.mcap", &bad));
    assert_eq!(done.code, 65, "{}", done.err);
    assert!(
        done.err.contains("damage at byte")
            && done.err.contains("keyframes cannot be used: the configuration before them"),
        "{}",
        done.err
    );
    let same = done.out.split(' ').next().unwrap().parse::<u32>().unwrap();
    assert!((7_000..12_500).contains(&same), "{}", done.out);
    assert!(done.out.contains(&format!("{same} of {same} frames are identical")), "{}", done.out);
}

#[test]
fn a_truncated_file_is_readable_up_to_its_last_complete_chunk() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "acquisition.rate_hz = 5000", 10_000);
    let good = std::fs::read(&file).unwrap();
    let (whole, ..) = contents(&file);
    let mut random = Pcg64Mcg::seed_from_u64(7);
    let lengths = [9, 60, good.len() - 1, good.len() - 9, good.len() - 40, good.len() / 2];
    for length in lengths.into_iter().chain((0..20).map(|_| random.random_range(8..good.len()))) {
        let torn = lab.write("torn.mcap", &good[..length]);
        let (entries, _, fine) = contents(&torn);
        assert!(!fine, "{length} bytes accepted as the whole file");
        assert_eq!(entries, whole[..entries.len()], "{length} bytes");
    }
    let torn = lab.write("torn.mcap", &good[..good.len() / 2]);
    let done = on(&["info", "--json"], &torn);
    let info: serde_json::Value = serde_json::from_str(&done.out).unwrap();
    assert_eq!((done.code, &info["whole"], &info["finished"]), (65, &false.into(), &false.into()));
    assert!(info["torn_bytes"].as_u64().unwrap() > 0, "{info}");
    let done = on(&["replay"], &torn);
    assert_eq!(done.code, 65, "{}", done.err);
    assert!(done.err.contains("torn.mcap: not closed"), "{}", done.err);
    let lost = format!("not complete: {} bytes at its end are an incomplete chunk", info["torn_bytes"]);
    assert!(done.err.contains(&lost), "{}", done.err);
    let done = on(&["export", "--format", "csv"], &torn);
    assert!(done.code == 65 && done.err.contains("not closed"), "{}", done.err);
    let done = on(&["recover"], &torn);
    assert!(done.code == 0 && done.err.contains("bytes at the end: an incomplete chunk"), "{}", done.err);
    assert_eq!(on(&["replay"], &lab.path("torn.recovered.mcap")).code, 0, "the new file has no gap");
}

#[test]
fn recovery_writes_a_whole_file_and_keeps_the_original() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "acquisition.rate_hz = 5000", 20_000);
    let mut bad = std::fs::read(&file).unwrap();
    bad.truncate(bad.len() * 9 / 10);
    // A replay does not read all chunks: damage one that it does.
    let (part, whole) = (bad.len() / 100, bad.clone());
    let damaged = (50..100).map(|k| {
        let mut bad = whole.clone();
        bad[k * part..k * part + 64].fill(0xff);
        lab.write("bad.mcap", &bad)
    });
    let seen = damaged.map(|bad| (contents(&bad), bad)).find(|((_, damages, _), _)| *damages > 0);
    let ((saved, ..), bad) = seen.expect("a damage that the replay sees");
    let before = std::fs::read(&bad).unwrap();
    let done = on(&["recover"], &bad);
    assert_eq!(done.code, 0, "{}", done.err);
    assert!(done.err.contains("saved") && done.err.contains("lost at byte"), "{}", done.err);
    assert_eq!(std::fs::read(&bad).unwrap(), before);
    let new = lab.path("bad.recovered.mcap");
    let (entries, _, fine) = contents(&new);
    assert_eq!(entries, saved);
    assert!(!fine, "the recovered file records the gap");
    let done = on(&["recover"], &bad);
    assert_eq!(done.code, 74, "the new file exists already: {}", done.err);
    assert!(done.err.contains("exists already"), "{}", done.err);
}

#[test]
fn other_files_are_refused_by_name() {
    let lab = Lab::new();
    let text = lab.write("notes.txt", "u_a_m,v_a_m\n".repeat(200));
    for command in ["info", "replay", "recover"] {
        let done = on(&[command], &text);
        assert!(
            done.code != 0 && done.err.contains("notes.txt is not an MCAP file"),
            "{command}: {}",
            done.err
        );
        let done = on(&[command], &lab.path("nothing.mcap"));
        assert!(
            done.code == 74 && done.err.contains("nothing.mcap"),
            "{command}: {} {}",
            done.code,
            done.err
        );
    }
    // An MCAP file of another program: valid, but without entries of trifacet.
    let foreign = lab.path("foreign.mcap");
    let mut writer = mcap::Writer::new(File::create_new(&foreign).unwrap()).unwrap();
    let schema = writer.add_schema("std_msgs/msg/String", "ros2msg", b"string data").unwrap();
    let channel = writer.add_channel(schema, "/chatter", "cdr", &std::collections::BTreeMap::new()).unwrap();
    let header =
        mcap::records::MessageHeader { channel_id: channel, sequence: 0, log_time: 5, publish_time: 5 };
    writer.write_to_known_channel(&header, &[0, 1, 0, 0, 1, 0, 0, 0, 0]).unwrap();
    writer.finish().unwrap();
    let info = on(&["info"], &foreign);
    assert!(info.code == 0 && info.out.contains("1 of other programs"), "{}{}", info.out, info.err);
    let done = on(&["replay"], &foreign);
    assert!(done.code == 65 && done.err.contains("is this a recording of trifacet"), "{}", done.err);
}

#[test]
fn the_state_of_another_version_is_not_used_and_this_is_reported() {
    let lab = Lab::new();
    let plain = lab.path("plain.mcap");
    write(&entries(&lab.record("a.mcap", "", 3000)), &plain);
    // The version is a text in each keyframe. The messages are written to a new file, so its
    // checksums are valid.
    let mut messages = Vec::new();
    let mut reader = Reader::open(&plain, &[]).unwrap();
    while reader.raw(|topic, time_ns, data| messages.push((topic, time_ns, data.to_vec()))).unwrap() {}
    let old = lab.path("old.mcap");
    let mut writer = Writer::new(File::create_new(&old).unwrap(), None).unwrap();
    let version = env!("CARGO_PKG_VERSION").as_bytes();
    for (topic, time_ns, mut data) in messages {
        if topic == trifacet::recording::Topic::Keyframe {
            let at = data.windows(version.len()).position(|w| w == version).unwrap();
            data[at] = b'7';
        }
        writer.put(trifacet::recording::codec::Encoded { topic, time_ns, data: &data }).unwrap();
    }
    writer.finish().unwrap();
    let done = run(trifacet(&["replay"]).arg(&old));
    assert_eq!(done.code, 0, "{}", done.err);
    assert!(done.err.contains("recorded by version 7") && done.err.lines().count() == 1, "{}", done.err);
    assert!(done.out.contains("of 3000 frames"), "{}", done.out);
}
