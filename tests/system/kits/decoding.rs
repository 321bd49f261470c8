//! All decoders compared on the same datagrams.

use std::io::{Seek, Write};
use std::process::Command;

use serde_json::{Value, json};
use trifacet::client::{FrameError, PoseFrame};

use super::fixture::{daemon, datagrams, frames_over_tcp};
use super::tools::{compile, python, succeeded};

/// Undefined behaviour aborts the program.
const UNDEFINED_TRAPS: [&str; 2] = ["-fsanitize=undefined", "-fsanitize-undefined-trap-on-error"];

/// The output of the decoder of a kit for these datagrams.
fn decoded_by(program: &mut Command, datagrams: &[Vec<u8>]) -> Vec<Value> {
    let mut file = tempfile::tempfile().unwrap();
    for datagram in datagrams {
        file.write_all(&(datagram.len() as u16).to_le_bytes()).unwrap();
        file.write_all(datagram).unwrap();
    }
    file.rewind().unwrap();
    let output = succeeded(program.stdin(file), "decoding");
    let lines = std::str::from_utf8(&output.stdout).unwrap().lines();
    lines.map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// A frame as the Rust client decodes it, with floating-point numbers as bits.
fn expected(frame: &PoseFrame) -> Value {
    let bits = |x: &[f32]| x.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    let long_bits = |x: &[f64]| x.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    json!({
        "session": frame.session, "config": frame.config, "sequence": frame.sequence,
        "sample_index": frame.sample_index, "time_ns": frame.time_ns,
        "solve_delay_ns": frame.solve_delay_ns, "send_delay_ns": frame.send_delay_ns,
        "status": frame.status.0, "clock_quality": frame.clock_quality,
        "lock": frame.lock as u8, "iterations": frame.iterations,
        "position": long_bits(&frame.pose[..3]), "rotation": long_bits(&frame.pose[3..]),
        "sd_position": bits(&frame.deviations[..3]), "sd_rotation": bits(&frame.deviations[3..]),
        "beam_offset": bits(&frame.beam_offset), "steering_residual": frame.steering_residual.to_bits(),
        "averaged": frame.averaged, "lost": frame.lost,
        "spot_a": bits(&frame.spots[..2]), "spot_b": bits(&frame.spots[2..4]), "spot_c": bits(&frame.spots[4..]),
        "power_a": frame.powers[0].to_bits(), "power_b": frame.powers[1].to_bits(),
        "power_c": frame.powers[2].to_bits(),
        "steering_x": frame.steering[0].to_bits(), "steering_y": frame.steering[1].to_bits(),
    })
}

/// For every datagram, every kit must return the same frame as the Rust client, or refuse it for the same
/// reason.
fn compare(datagrams: &[Vec<u8>]) {
    let (_place, c) = compile("tests/system/kits/decode.c", &UNDEFINED_TRAPS);
    let kits = [
        ("Python", decoded_by(&mut python("tests/system/kits/decode.py"), datagrams)),
        ("C", decoded_by(&mut Command::new(c), datagrams)),
    ];
    for (kit, values) in kits {
        assert_eq!(values.len(), datagrams.len(), "{kit}");
        for (value, bytes) in values.iter().zip(datagrams) {
            match PoseFrame::decode(bytes) {
                Ok(frame) => assert_eq!(*value, expected(&frame), "{kit}"),
                Err(error) => {
                    let told =
                        value["error"].as_str().unwrap_or_else(|| panic!("{kit}: {error}, but {value}"));
                    assert!(told.contains(reason(&error)), "{kit}: \"{told}\" for {error}");
                }
            }
        }
    }
}

/// A word that the error message of a kit must contain.
fn reason(error: &FrameError) -> &'static str {
    match error {
        FrameError::Length(_) | FrameError::Size(_) => "bytes",
        FrameError::Magic(_) => "TFP1",
        FrameError::Version { .. } => "version",
        FrameError::Crc { .. } => "CRC",
        FrameError::Lock(_) => "lock state",
    }
}

#[test]
fn datagrams_of_a_daemon_are_decoded_bit_by_bit() {
    let datagrams = datagrams();
    let frames: Vec<_> = datagrams.iter().map(|d| PoseFrame::decode(d).unwrap()).collect();
    let valid = frames.iter().filter(|f| f.status.0 & 1 != 0).count();
    assert!((100..600).contains(&valid), "with and without light: {valid}");
    // Without a valid pose, every number of the pose is NaN.
    for frame in frames.iter().filter(|f| f.status.0 & 1 == 0) {
        assert!(frame.pose.iter().all(|x| x.is_nan()) && frame.deviations.iter().all(|x| x.is_nan()));
    }
    compare(datagrams);
}

#[test]
fn frames_over_tcp_are_decoded_bit_by_bit() {
    let mut daemon = daemon(&[]);
    compare(&frames_over_tcp(daemon.address(), 50));
}

fn sealed(mut bytes: Vec<u8>) -> Vec<u8> {
    let crc = crc32fast::hash(&bytes[..188]);
    bytes[188..192].copy_from_slice(&crc.to_le_bytes());
    bytes
}

/// Whether a number is a signalling NaN. No daemon sends one; Python converts it to a quiet NaN.
fn signals(frame: &PoseFrame) -> bool {
    let singles = frame.deviations.iter().chain(&frame.spots).chain(&frame.powers).chain(&frame.beam_offset);
    let mut singles = singles.chain(&frame.steering).chain([&frame.steering_residual]);
    singles.any(|x| x.is_nan() && x.to_bits() & 1 << 22 == 0)
}

#[test]
fn extreme_frames_are_decoded_and_damaged_ones_refused() {
    let good = datagrams()[0].clone();
    let with = |at: usize, value: u8| {
        let mut bytes = good.clone();
        bytes[at] = value;
        bytes
    };
    let mut cases =
        vec![good.clone(), vec![], b"TFP1".to_vec(), good[..191].to_vec(), [&good[..], &[0]].concat()];
    // Every byte set to the largest and to the smallest value, and every byte damaged.
    for (at, byte) in good.iter().enumerate() {
        cases.extend([0, 1, 0x7f, 0x80, 0xff].map(|value| sealed(with(at, value))));
        cases.push(with(at, byte ^ 1 << (at % 8)));
    }
    let extremes = [f64::MAX, f64::MIN_POSITIVE / 4.0, -0.0, f64::INFINITY, f64::NEG_INFINITY, f64::NAN];
    for x in extremes {
        let frame = PoseFrame::decode(&good).unwrap();
        let (x32, n) = (x as f32, u64::MAX);
        let frame = PoseFrame { pose: [x; 6], deviations: [x32; 6], spots: [x32; 6], sequence: n, ..frame };
        cases.push(PoseFrame { time_ns: i64::MIN, sample_index: 1 << 63, ..frame }.encode().to_vec());
    }
    assert!(cases.iter().any(|c| matches!(PoseFrame::decode(c), Err(FrameError::Lock(_)))));
    cases.retain(|c| PoseFrame::decode(c).map_or(true, |frame| !signals(&frame)));
    compare(&cases);
}
