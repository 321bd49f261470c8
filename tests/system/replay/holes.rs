//! Gaps in a recording, of any cause, are reported, and no frame is computed across them.

use std::fs::File;

use trifacet::core::time::Mono;
use trifacet::recording::Entry;
use trifacet::recording::codec::Encoder;
use trifacet::recording::writer::Writer;

use super::damage::{Broken, entries, split, write};
use super::fixture::Lab;
use crate::testkit::{Done, on, run, trifacet};

/// Checks that all computed frames are identical, and that some frames could not be computed.
fn not_all(done: &Done) {
    let same = done.out.split(' ').next().unwrap();
    assert!(
        done.out.contains(&format!("{same} of {same} frames are identical")),
        "{} {}",
        done.out,
        done.err
    );
    assert!(
        done.code == 65 && done.out.contains("not computed: the required data"),
        "{} {}",
        done.code,
        done.out
    );
}

#[test]
fn a_recovered_recording_reports_the_place_of_the_damage() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "acquisition.rate_hz = 5000", 20_000);
    let mut bad = std::fs::read(&file).unwrap();
    let middle = bad.len() / 2;
    bad[middle..middle + 64].fill(0xff);
    let bad = lab.write("bad.mcap", &bad);
    not_all(&on(&["replay"], &bad));
    assert_eq!(on(&["recover"], &bad).code, 0);
    let new = lab.path("bad.recovered.mcap");
    let info = on(&["info"], &new);
    assert!(
        info.code == 65 && info.out.contains("gap        damaged in the original file: at byte"),
        "{}",
        info.out
    );
    assert!(info.out.contains("closed properly") && !info.out.contains("\ndamage"), "{}", info.out);
    let replay = on(&["replay"], &new);
    not_all(&replay);
    assert!(replay.err.contains("gap: damaged in the original file"), "{}", replay.err);
    let export = on(&["export", "--format", "csv"], &new);
    assert!(export.code == 65 && export.err.contains("missing in the table: damaged"), "{}", export.err);
}

#[test]
fn the_output_of_a_damaged_recording_records_the_damage() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "acquisition.rate_hz = 5000", 20_000);
    let mut bad = std::fs::read(&file).unwrap();
    let middle = bad.len() / 2;
    bad[middle] ^= 1;
    let (bad, out) = (lab.write("bad.mcap", &bad), lab.path("out.mcap"));
    let done = run(trifacet(&["replay", "--output"]).arg(&out).arg(&bad));
    not_all(&done);
    let info = on(&["info"], &out);
    assert!(info.code == 65 && info.out.contains("damaged in the original recording"), "{}", info.out);
    let again = on(&["replay"], &out);
    assert!(again.code == 65 && again.err.contains("it has 1 gap"), "{}", again.err);
    assert!(again.out.starts_with(done.out.lines().next().unwrap()), "{}", again.out);
}

#[test]
fn a_gap_without_a_record_is_detected() {
    let lab = Lab::new();
    let all = entries(&lab.record("a.mcap", "", 5000));
    let nth = |from: usize, is: fn(&Entry) -> bool| (from..all.len()).find(|i| is(&all[*i])).unwrap();
    let sample = |e: &Entry| matches!(e, Entry::Sample { .. });
    let frame = |e: &Entry| matches!(e, Entry::Frame { .. });
    let cut = lab.path("cut.mcap");
    // Gaps between samples, and between samples and their frames.
    for is in [sample as fn(&Entry) -> bool, frame] {
        let (from, to) = (nth(3000, is), nth(5000, is));
        write(&[&all[..from], &all[to..]].concat(), &cut);
        let info = on(&["info"], &cut);
        assert!(info.code == 65 && info.out.contains("with no reason on record"), "{}", info.out);
        not_all(&on(&["replay"], &cut));
        std::fs::remove_file(&cut).unwrap();
    }
    // A gap up to a keyframe is reported too, although all remaining frames can be computed.
    let to = nth(3500, |e| matches!(e, Entry::Keyframe(_)));
    write(&[&all[..3000], &all[to..]].concat(), &cut);
    assert!(on(&["info"], &cut).out.contains("a keyframe after sample"));
    let done = on(&["replay"], &cut);
    assert!(
        done.code == 65 && done.err.contains("not everything was compared: 1 place"),
        "{} {}",
        done.code,
        done.err
    );
}

#[test]
fn one_gap_record_covers_a_later_gap_of_the_recorder() {
    let lab = Lab::new();
    let all = entries(&lab.record("a.mcap", "", 5000));
    let keyframe = |from: usize| (from..all.len()).find(|i| matches!(all[*i], Entry::Keyframe(_))).unwrap();
    let (early, to) = (keyframe(2000), keyframe(6000));
    let file = lab.path("behind.mcap");
    let mut writer = Writer::new(File::create_new(&file).unwrap(), None).unwrap();
    let mut encoder = Encoder::new((Mono(0), 0));
    // The queue was full with entries still waiting: the gap record precedes the missing entries.
    for (i, entry) in all.iter().enumerate().filter(|(i, _)| !(4500..to).contains(i)) {
        if i == early {
            let told = encoder.gap(1000, "too slow", |message| writer.put(message).map_err(Broken::from));
            told.unwrap();
        }
        encoder.encode(entry, |message| writer.put(message).map_err(Broken::from)).unwrap();
    }
    writer.finish().unwrap();
    let info = on(&["info"], &file);
    let told = info.out.contains("gap        1000 entries were not recorded: too slow");
    assert!(told && !info.out.contains("damage"), "{}", info.out);
    let done = on(&["replay"], &file);
    assert!(
        !done.err.contains("difference") && done.out.contains("from 3 keyframes"),
        "{} {}",
        done.out,
        done.err
    );
}

#[test]
fn after_a_change_of_configuration_in_a_damaged_part_the_replay_waits_for_the_new_one() {
    let lab = Lab::new();
    let before = entries(&lab.record("a.mcap", "", 30_000));
    let after = entries(&lab.record("b.mcap", "frames.tare.translation_mm = [0.1, 0, 0]", 30_000));
    let keyframe = (9000..before.len()).find(|i| matches!(before[*i], Entry::Keyframe(_))).unwrap();
    let file = lab.path("c.mcap");
    let to = File::create_new(&file).unwrap();
    let mut writer = Writer::new(to.try_clone().unwrap(), None).unwrap();
    let mut encoder = Encoder::new((Mono(0), 0));
    let mut place = [0; 2];
    for (i, entry) in before[..keyframe].iter().chain(&after[keyframe..]).enumerate() {
        // The keyframe with the new configuration has its own chunk, together with its sample.
        if i == keyframe || i == keyframe + 3 {
            writer.flush().unwrap();
            place[usize::from(i > keyframe)] = to.metadata().unwrap().len() as usize;
        }
        encoder.encode(entry, |message| writer.put(message).map_err(Broken::from)).unwrap();
    }
    writer.finish().unwrap();
    let good = on(&["replay"], &file);
    assert!(good.code == 0 && good.out.contains("30000 of 30000"), "{} {}", good.out, good.err);
    let mut bad = std::fs::read(&file).unwrap();
    bad[place[0] + 200] ^= 1;
    let done = on(&["replay"], &lab.write("bad.mcap", &bad));
    not_all(&done);
    assert!(done.err.contains("the configuration has changed in a part that cannot be read"), "{}", done.err);
    let same: u32 = done.out.split(' ').next().unwrap().parse().unwrap();
    assert!(same > 15_000, "the replay continues at the next configuration: {}", done.out);
}

#[test]
fn files_that_are_not_contiguous_are_reported() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "", 9000);
    let [one, rest, two, three] = ["1.mcap", "rest.mcap", "2.mcap", "3.mcap"].map(|name| lab.path(name));
    split(&file, &one, &rest);
    split(&rest, &two, &three);
    let replay = |files: &[&std::path::Path]| run(trifacet(&["replay"]).args(files));
    let right = replay(&[&one, &two, &three]);
    assert!(
        right.code == 0 && right.err.is_empty() && right.out.contains("from 1 keyframe and"),
        "{}",
        right.err
    );
    for (files, told) in [
        (vec![&*two, &*one], "1.mcap begins with sample 0, but "),
        (vec![&*one, &*one], "give each file once, in order"),
        (vec![&*one, &*three], "samples are missing"),
    ] {
        let done = replay(&files);
        assert!(done.code == 0 && done.err.contains(told), "{files:?}: {} {}", done.code, done.err);
        assert!(done.out.contains("from 2 keyframes"), "{}", done.out);
    }
    // Another run of the daemon starts its count again with another session number.
    let mut other = entries(&one);
    for entry in &mut other {
        if let Entry::Frame { frame, .. } = entry {
            frame.session = 7;
        }
    }
    let stranger = lab.path("stranger.mcap");
    write(&other, &stranger);
    let done = replay(&[&two, &stranger]);
    assert!(done.err.contains("stranger.mcap was recorded in another run of the daemon"), "{}", done.err);
}

#[test]
fn the_output_of_a_replay_has_the_time_of_the_recording_from_the_first_message_on() {
    let lab = Lab::new();
    let mut then = entries(&lab.record("a.mcap", "estimation.average = 7", 2000));
    for entry in &mut then {
        if let Entry::Frame { frame, .. } = entry {
            frame.time_ns += 1_800_000_000_000_000_000;
        }
    }
    let (file, out) = (lab.path("then.mcap"), lab.path("out.mcap"));
    write(&then, &file);
    assert_eq!(run(trifacet(&["replay", "--output"]).arg(&out).arg(&file)).code, 0);
    let info: serde_json::Value = serde_json::from_str(&on(&["info", "--json"], &out).out).unwrap();
    assert!(info["start"].as_str().unwrap().starts_with("2027-01-15T08:00:00"), "{info}");
    assert!(info["seconds"].as_f64().unwrap() < 2.1, "{info}");
}
