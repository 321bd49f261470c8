//! `docs/board-protocol.md` agrees with the code: its examples decode to the described values and encode to
//! the same bytes, and its baud rates are those that the daemon requires.

use std::fmt::Debug;

use trifacet_wire::actuator::{LeaseAction, OutputCommand};
use trifacet_wire::board::message::{ErrorReason, Reply, StartResult, SteerResult};
use trifacet_wire::board::{
    Answer, BoardIdentity, BoardScan, ChannelUnit, Deframer, Extension, MINOR, MessageError, Request,
    ScanFormat, Unit, required_baud,
};
use trifacet_wire::channel::{Converter, MAX_CHANNELS, Role, SIGNALS};

const DOCUMENT: &str = include_str!("../../docs/board-protocol.md");

/// The message and the frame of the example in this section.
fn example(heading: &str) -> (Vec<u8>, Vec<u8>) {
    let (_, section) = DOCUMENT.split_once(&format!("\n### {heading}\n")).expect(heading);
    let (_, block) = section.split_once("```text\nmessage").expect(heading);
    let (message, rest) = block.split_once("frame").expect(heading);
    let (frame, _) = rest.split_once("```").expect(heading);
    (bytes(message), bytes(frame))
}

fn bytes(hex: &str) -> Vec<u8> {
    hex.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
}

/// Checks an example in both directions.
fn check<T: Debug + PartialEq>(
    heading: &str,
    expected: &T,
    decode: impl Fn(&[u8]) -> Result<T, MessageError>,
    encode: impl Fn(&T, &mut Vec<u8>),
) {
    let (message, frame) = example(heading);
    let mut deframer = Deframer::default();
    let found = deframer.next(&mut &frame[..]).expect(heading).expect(heading);
    assert_eq!(found, &message[..message.len() - 4], "{heading}: the frame holds the message");
    assert_eq!(decode(found).as_ref(), Ok(expected), "{heading}");
    let mut out = Vec::new();
    encode(expected, &mut out);
    assert_eq!(out, frame, "{heading}");
    // Cut to the length of its predecessor in version 1.0, a message is that predecessor.
    let decoded = (2..found.len()).filter(|length| decode(&found[..*length]).is_ok()).count();
    assert_eq!(decoded, usize::from(heading.ends_with("1.1")), "{heading}: lengths that are too short");
}

#[test]
fn the_examples_of_the_host_decode_and_encode() {
    let command = OutputCommand { id: 42, codes: [1000, -2000], lease_ms: 200, on_expiry: LeaseAction::Park };
    for (heading, request) in [
        ("0x01 IDENTIFY", Request::Identify { minor: 0 }),
        ("0x01 IDENTIFY of version 1.1", Request::Identify { minor: 1 }),
        ("0x02 START", Request::Start { rate_mhz: 1_000_000, park: [6554, -6554], minor: 0 }),
        ("0x02 START of version 1.1", Request::Start { rate_mhz: 1_000_000, park: [6554, -6554], minor: 1 }),
        ("0x03 STOP", Request::Stop),
        ("0x04 STEER", Request::Steer(command)),
    ] {
        check(heading, &request, |message| Request::decode(message, MINOR), Request::encode);
    }
}

#[test]
fn the_examples_of_the_board_decode_and_encode() {
    let mut roles = SIGNALS.to_vec();
    roles.extend([Role::Steering(0), Role::Steering(1)]);
    let identity = BoardIdentity {
        tick_hz: 1_000_000,
        converter: Converter { bits: 18, range_v: 10.0 },
        output_bits: 16,
        simulated: false,
        rate_mhz: [1_000, 20_000_000],
        roles,
        skew_ns: (0..11).map(|channel| channel * 4000).collect(),
        name: "Example board 1.0 #0007".into(),
        extensible: false,
        extension: None,
    };
    let busy = Answer::Busy { host: "192.168.1.5:50312".into() };
    check("0x87 BUSY", &busy, Answer::decode, Answer::encode);
    check("0x81 IDENTITY", &Answer::Identity(identity), Answer::decode, Answer::encode);
    let reply = Reply { start: true, result: StartResult::Done, rate_mhz: 1_000_000 };
    check("0x82 REPLY", &Answer::Reply(reply), Answer::decode, Answer::encode);
    let ack = Answer::Ack { id: 42, result: SteerResult::Accepted };
    check("0x83 ACK", &ack, Answer::decode, Answer::encode);
    let error = Answer::Error { reason: ErrorReason::Type, kind: 0x7f };
    check("0x85 ERROR", &error, Answer::decode, Answer::encode);
}

#[test]
fn the_example_of_a_scan_decodes() {
    let (message, frame) = example("0x84 SCAN");
    let mut codes = [0; MAX_CHANNELS];
    let some = [1, -1, 131_071, -131_072, 65_536, 40_000, 256, -256, 40_001, 12_345, -12_345];
    codes[..some.len()].copy_from_slice(&some);
    let scan = Answer::Scan(BoardScan {
        format: ScanFormat::Short,
        sequence: 258,
        tick: u32::MAX.into(),
        applied: None,
        output_railed: true,
        lease_expired: false,
        overrun: true,
        channels: 11,
        codes,
    });
    let body = &message[..message.len() - 4];
    assert_eq!(Answer::decode(body), Ok(scan.clone()));
    let mut out = Vec::new();
    scan.encode(&mut out);
    assert_eq!(out, frame);
    // A scan contains any number of complete codes, and nothing else.
    let cut = Answer::decode(&body[..body.len() - 1]);
    assert_eq!(cut, Err(MessageError::Length { kind: 0x84, length: body.len() - 1 }));
}

#[test]
fn the_examples_of_version_1_1_decode_and_encode() {
    let mut roles = SIGNALS.to_vec();
    roles.push(Role::Auxiliary);
    let temperature = ChannelUnit { channel: 9, unit: Unit::Celsius, scale: 7629, exponent: -6, zero: 6554 };
    let identity = BoardIdentity {
        tick_hz: 1_000_000,
        converter: Converter { bits: 18, range_v: 10.0 },
        output_bits: 16,
        simulated: false,
        rate_mhz: [1_000, 20_000_000],
        roles,
        skew_ns: vec![0; 10],
        name: "Example board 1.1 #0008".into(),
        extensible: true,
        extension: Some(Extension {
            minor: 1,
            wide_tick: true,
            boot_id: 0xc0de_5eed,
            units: vec![temperature],
        }),
    };
    check("0x81 IDENTITY of version 1.1", &Answer::Identity(identity), Answer::decode, Answer::encode);
    assert!((temperature.value(6554 + 3277) - 25.0).abs() < 1e-3, "{}", temperature.value(9831));
    let (_, frame) = example("0x86 LONG_SCAN");
    let codes = std::array::from_fn(|channel| if channel < 10 { [1, -1][channel % 2] } else { 0 });
    let scan = Answer::Scan(BoardScan {
        format: ScanFormat::Long { wide_tick: true },
        sequence: 259,
        tick: (1 << 32) + 999,
        applied: Some(42),
        output_railed: false,
        lease_expired: true,
        overrun: false,
        channels: 10,
        codes,
    });
    let message = Deframer::default().next(&mut &frame[..]).unwrap().unwrap().to_vec();
    assert_eq!(Answer::decode(&message), Ok(scan.clone()));
    let mut out = Vec::new();
    scan.encode(&mut out);
    assert_eq!(out, frame);
}

#[test]
fn the_baud_rates_are_those_that_the_daemon_requires() {
    let rates = [500.0, 1e3, 2e3, 5e3, 10e3];
    let (short, long) = (ScanFormat::Short, ScanFormat::Long { wide_tick: true });
    for (channels, format, name) in
        [9, 11, 16].into_iter().flat_map(|n| [(n, short, "1.0"), (n, long, "1.1")])
    {
        let row = rates.map(|rate_hz| grouped(required_baud(channels, rate_hz, format)));
        let row = format!("| {channels} | {name} | {} |", row.join(" | "));
        assert!(DOCUMENT.lines().any(|line| line == row), "the table needs {row}");
    }
}

/// A number with a space between its groups of three digits.
fn grouped(number: u32) -> String {
    let digits = number.to_string();
    let groups: Vec<_> =
        digits.as_bytes().rchunks(3).rev().map(|group| std::str::from_utf8(group).unwrap()).collect();
    groups.join(" ")
}

#[test]
fn messages_of_other_versions_and_invalid_values_are_distinguished() {
    assert_eq!(Request::decode(&[0x81, 1], MINOR), Err(MessageError::Type(0x81)));
    assert_eq!(Answer::decode(&[0x01, 1]), Err(MessageError::Type(0x01)));
    assert_eq!(Request::decode(&[0x01, 2], MINOR), Err(MessageError::Version { kind: 0x01, version: 2 }));
    assert_eq!(Request::decode(&[0x03, 1, 0], MINOR), Err(MessageError::Length { kind: 0x03, length: 3 }));
    let (mut steer, _) = example("0x04 STEER");
    steer.truncate(steer.len() - 4);
    *steer.last_mut().unwrap() = 2;
    assert_eq!(
        Request::decode(&steer, MINOR),
        Err(MessageError::Value { kind: 4, field: "action on expiry" })
    );
}
