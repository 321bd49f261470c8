//! Recordings of the closed-loop simulation are reproduced bit by bit.

use trifacet_core::estimation::EstimatorState;
use trifacet_wire::Status;

use super::{Comparison, Engine};
use crate::closed_loop_sim::ClosedLoopSim;
use crate::config::{Config, parse};
use crate::recording::Entry;

fn config(text: &str) -> Config {
    parse(text, None).unwrap()
}

/// Entries that the twin records in this number of scans.
fn recorded(config: &Config, scans: u64) -> Vec<Entry> {
    let (mut sim, mut receiver) = ClosedLoopSim::recorded(config).unwrap();
    let mut entries = Vec::new();
    for _ in 0..scans {
        sim.step();
        entries.extend(std::iter::from_fn(|| receiver.entries.try_recv().ok()));
    }
    entries
}

fn replayed(entries: &[Entry]) -> (Engine, Comparison) {
    let (mut engine, mut comparison) = (Engine::new(), Comparison::default());
    for entry in entries {
        engine.take(entry).unwrap();
        comparison.take(entry, engine.report());
    }
    (engine, comparison)
}

fn frames(entries: &[Entry]) -> u64 {
    entries.iter().filter(|entry| matches!(entry, Entry::Frame { .. })).count() as u64
}

const EVERYTHING: &str = "
    acquisition.rate_hz = 2000
    twin.channel_skew_us = 20
    [[twin.motion]]
    axis = 'tx'
    kind = 'sine'
    amount_um = 200
    frequency_hz = 3
    [[twin.fault]]
    kind = 'stalled'
    at_s = 0.7
    for_s = 0.2
    [[twin.fault]]
    kind = 'beam-blocked'
    at_s = 1.6
    for_s = 0.3
";

#[test]
fn every_frame_is_computed_again_identically() {
    let fused = "estimation.fuse_steering = true\ntwin.steering.readback_noise_um = 0.1\n";
    for text in [
        "",
        EVERYTHING,
        "estimation.average = 7",
        &format!("{fused}{EVERYTHING}"),
        "estimation.model = 'ray'",
    ] {
        let entries = recorded(&config(text), 6000);
        let (engine, comparison) = replayed(&entries);
        assert_eq!(
            (comparison.same, comparison.other),
            (frames(&entries), 0),
            "{text}: {:?}",
            comparison.first
        );
        assert_eq!((comparison.unrecorded, comparison.unrepeated), (0, 0));
        assert_eq!((engine.taken_up, engine.passed_over), (1, 0), "{text}: no further keyframe is needed");
    }
}

#[test]
fn nothing_is_computed_across_a_gap_without_a_record() {
    let entries = recorded(&config("twin.channel_skew_us = 20"), 3000);
    let sample =
        |from: usize| (from..entries.len()).find(|i| matches!(entries[*i], Entry::Sample { .. })).unwrap();
    let (from, to) = (sample(1000), sample(1500));
    let cut = [&entries[..from], &entries[to..]].concat();
    let (engine, comparison) = replayed(&cut);
    assert_eq!(comparison.other, 0, "{:?}", comparison.first);
    assert!(comparison.unrepeated > 0 && comparison.same > 2000, "{comparison:?}");
    assert_eq!((engine.taken_up, engine.passed_over), (2, comparison.unrepeated));
}

/// Powers that are not known to a fifth of themselves.
const NOISY: &str = "
    twin.power_noise = 0.25
    centering.mode = 'off'
";

#[test]
fn frames_from_before_power_noisy_are_equal_except_for_the_name_of_the_bit() {
    let mut entries = recorded(&config(NOISY), 2000);
    let mut noisy = 0;
    for entry in &mut entries {
        if let Entry::Frame { frame, .. } = entry
            && frame.status.has(Status::POWER_NOISY)
        {
            noisy += 1;
            frame.status = Status(frame.status.0 & !Status::POWER_NOISY.0) | Status::PSD_B_LOW;
        }
    }
    let (_, comparison) = replayed(&entries);
    assert!(noisy > 0, "the noise is too small");
    assert_eq!((comparison.renamed, comparison.other), (noisy, 0), "{:?}", comparison.first);
    // Any other difference remains one.
    for entry in &mut entries {
        if let Entry::Frame { frame, .. } = entry {
            frame.status = Status(frame.status.0 ^ Status::UNBALANCED.0);
        }
    }
    let (_, comparison) = replayed(&entries);
    assert_eq!((comparison.renamed, comparison.same), (0, 0));
}

#[test]
fn a_state_from_before_covered_areas_is_read() {
    let entries = recorded(&config("estimation.average = 7"), 3000);
    let memory = entries.iter().rev().find_map(|entry| match entry {
        Entry::Keyframe(keyframe) => Some(&keyframe.memory),
        _ => None,
    });
    let memory = memory.unwrap();
    let bytes = postcard::to_stdvec(memory).unwrap();
    // The coverage, and no systematic part that depends on the pose.
    assert!(memory.has_coverage() && bytes.ends_with(&[1, 0, 0]), "the coverage is at the end");
    let earlier: EstimatorState = postcard::from_bytes(&bytes[..bytes.len() - 3]).unwrap();
    assert!(!earlier.has_coverage());
    let as_then = postcard::to_stdvec(&memory.as_far_as(&earlier)).unwrap();
    assert_eq!(as_then, postcard::to_stdvec(&earlier).unwrap());
}

/// A laser that is displaced by less than the limit of one residual: only the mean shows it.
const DISPLACED: &str = "twin.laser_offset_um = [6.5, 0]\ntwin.motion = []";

#[test]
fn frames_from_before_the_mean_residual_are_equal_except_for_inconsistent() {
    let mut entries = recorded(&config(DISPLACED), 4000);
    let (engine, comparison) = replayed(&entries);
    assert_eq!((engine.taken_up, comparison.untested, comparison.other), (1, 0, 0), "{:?}", comparison.first);
    let mut contradicted = 0;
    for entry in &mut entries {
        match entry {
            Entry::Frame { frame, .. } => {
                contradicted += u64::from(frame.status.has(Status::INCONSISTENT));
                frame.status = Status(frame.status.0 & !Status::INCONSISTENT.0);
            }
            Entry::Keyframe(keyframe) => {
                keyframe.memory = keyframe.memory.as_far_as(&EstimatorState::default());
            }
            _ => {}
        }
    }
    let (engine, comparison) = replayed(&entries);
    assert!(contradicted > 2000, "{contradicted}");
    assert_eq!((comparison.untested, comparison.other), (contradicted, 0), "{:?}", comparison.first);
    assert_eq!(engine.taken_up, 1, "the mean goes on beyond keyframes that do not include it");
    // Any other difference remains one.
    for entry in &mut entries {
        if let Entry::Frame { frame, .. } = entry {
            frame.status = Status(frame.status.0 ^ Status::UNBALANCED.0);
        }
    }
    let (_, comparison) = replayed(&entries);
    assert_eq!((comparison.untested, comparison.same), (0, 0));
}
