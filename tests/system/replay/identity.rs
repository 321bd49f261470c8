//! A replay computes the same poses.

use trifacet::clock::SystemClock;
use trifacet::core::time::Clock;

use super::fixture::{EVENTFUL, Lab};
use crate::testkit::{on, run, trifacet};

#[test]
fn all_frames_are_identical_and_the_exit_code_is_0() {
    let lab = Lab::new();
    let means = "estimation.average = 7\nacquisition.rate_hz = 5000";
    for (name, config) in [("a.mcap", EVENTFUL), ("b.mcap", means), ("c.mcap", "estimation.model = 'ray'")] {
        let file = lab.record(name, config, 6000);
        let done = on(&["replay"], &file);
        assert_eq!(done.code, 0, "{config}: {}", done.err);
        let frames: Vec<u64> =
            done.out.split_ascii_whitespace().filter_map(|word| word.parse().ok()).take(2).collect();
        assert!(frames[0] == frames[1] && frames[0] > 800, "{}", done.out);
        assert!(
            done.out.contains("from 1 keyframe and"),
            "computed from the first keyframe only: {}",
            done.out
        );
    }
}

/// A recording contains its correction tables: it can be replayed on another machine.
#[test]
fn the_files_of_correction_tables_are_not_needed() {
    let lab = Lab::new();
    let corners = ["-0.007,-0.007", "0.007,-0.007", "-0.007,0.007", "0.007,0.007"];
    let rows: String = corners.iter().flat_map(|corner| [corner, ",5e-5,0\n"]).collect();
    let table = lab.write("a.csv", format!("u_m,v_m,du_m,dv_m\n{rows}"));
    let file = lab.record("a.mcap", "channels.a.correction = 'a.csv'", 2000);
    std::fs::remove_file(table).unwrap();
    let done = on(&["replay"], &file);
    assert_eq!(done.code, 0, "{}", done.err);
    assert!(done.out.contains("2000 of 2000 frames are identical"), "{}", done.out);
}

#[test]
fn another_configuration_gives_statistics_and_a_recording_of_its_own() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "", 3000);
    let other = lab.write("other.toml", "frames.tare.translation_mm = [0.1, 0, 0]\n");
    let new = lab.path("new.mcap");
    let command = &mut trifacet(&["replay", "--config"]);
    let done = run(command.arg(&other).arg("--output").arg(&new).arg(&file));
    assert_eq!(done.code, 0, "{}", done.err);
    let tx = done.out.lines().find(|line| line.starts_with("tx")).unwrap();
    let mean: f64 = tx.split_ascii_whitespace().nth(2).unwrap().parse().unwrap();
    assert!((mean + 100.0).abs() < 1e-3, "{}", done.out);
    // The output is a recording itself and can be replayed.
    let again = on(&["replay"], &new);
    assert_eq!(again.code, 0, "{} {}", again.out, again.err);
    assert!(again.out.contains("3000 of 3000"), "{}", again.out);
    // The same configuration from a cold start gives the same frames, because the recording began with a
    // cold start.
    let same = lab.write("same.toml", "");
    let done = run(trifacet(&["replay", "--config"]).arg(&same).arg(&file));
    assert!(done.out.contains("3000 are identical"), "{}", done.out);
    // For a configuration without valid poses, the reason is printed.
    let blind = lab.write("blind.toml", "channels.sum_threshold_v = 50.0");
    let done = run(trifacet(&["replay", "--config"]).arg(&blind).arg(&file));
    assert!(done.code == 0 && done.out.contains("3000 have PSD_A_LOW PSD_B_LOW PSD_C_LOW"), "{}", done.out);
    assert!(!done.out.contains("now minus then"), "{}", done.out);
}

#[test]
fn differences_are_reported_with_place_and_size() {
    // Frames of another recording with these samples, as from a program with a changed solver.
    let lab = Lab::new();
    let file = lab.record("a.mcap", "", 500);
    let table = lab.path("a.csv");
    assert_eq!(run(trifacet(&["replay", "--output"]).arg(&table).arg(&file)).code, 0);
    let text = std::fs::read_to_string(&table).unwrap();
    assert_eq!(text.lines().count(), 501);
    assert!(text.starts_with("sequence,sample_index,time,"));
    let forged = lab.path("forged.mcap");
    super::damage::forge(&file, &forged);
    let done = on(&["replay"], &forged);
    assert_eq!(done.code, 1, "{}", done.out);
    assert!(done.out.contains("499 of 500"), "{}", done.out);
    assert!(done.err.contains("sample 250: ty_m was") && done.err.contains(", by "), "{}", done.err);
}

#[test]
fn files_of_a_rotated_recording_replay_together_and_separately() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", EVENTFUL, 6000);
    let (first, second) = (lab.path("1.mcap"), lab.path("2.mcap"));
    super::damage::split(&file, &first, &second);
    for file in [&first, &second] {
        let done = on(&["replay"], file);
        assert_eq!(done.code, 0, "{}", done.err);
    }
    let done = run(trifacet(&["replay"]).args([&first, &second]));
    assert_eq!(done.code, 0, "{}", done.err);
    assert!(done.out.contains("from 1 keyframe and"), "{}", done.out);
}

#[test]
fn the_replay_speed_is_kept() {
    let lab = Lab::new();
    let file = lab.record("a.mcap", "", 1000);
    let start = SystemClock.now();
    let done = run(trifacet(&["replay", "--speed", "2"]).arg(&file));
    assert_eq!(done.code, 0, "{}", done.err);
    assert!(SystemClock.now().seconds_since(start) >= 0.499, "one second at double speed");
    let done = run(trifacet(&["replay", "--speed", "0"]).arg(&file));
    assert_eq!(done.code, 64, "{}", done.err);
    assert!(done.err.contains("--speed 0"), "{}", done.err);
}
