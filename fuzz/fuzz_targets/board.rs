//! Bytes on the serial line: host and board consume every byte, decoded messages survive a round trip, and
//! the session of the host continues.

#![no_main]

use std::{fmt::Debug, sync::Arc, time::Duration};

use libfuzzer_sys::fuzz_target;
use trifacet::acquisition::SourceEvent;
use trifacet::acquisition::board::{Session, Settings};
use trifacet::core::time::Mono;
use trifacet::core::telemetry::Counters;
use trifacet_wire::board::{Answer, Deframer, MINOR, MessageError, Request, framing as frame};
use trifacet_wire::channel::MAX_CHANNELS;

fuzz_target!(|bytes: &[u8]| {
    // The line as it is, and cut into messages with correct checksums, which the fuzzer cannot guess.
    let sealed: Vec<u8> = bytes.split(|byte| *byte == 0xa5).flat_map(seal).collect();
    for line in [bytes, &sealed] {
        for minor in 0..=MINOR {
            understand(line, |message| Request::decode(message, minor), Request::encode);
        }
        understand(line, Answer::decode, encode_answer);
        converse(line);
    }
});

fn seal(message: &[u8]) -> Vec<u8> {
    let mut frame = Vec::new();
    frame::encode(&message[..message.len().min(frame::MAX_MESSAGE - 4)], &mut frame);
    frame
}

/// A board with more channels than allowed is decoded (and refused later), but cannot be encoded.
fn encode_answer(answer: &Answer, out: &mut Vec<u8>) {
    match answer {
        Answer::Identity(board) if board.roles.len() > MAX_CHANNELS => {}
        answer => answer.encode(out),
    }
}

/// A decoded message is equal after a round trip.
fn understand<T: Debug + PartialEq>(
    mut line: &[u8],
    decode: impl Fn(&[u8]) -> Result<T, MessageError>,
    encode: impl Fn(&T, &mut Vec<u8>),
) {
    let mut deframer = Deframer::default();
    while let Some(found) = deframer.next(&mut line) {
        let Ok(Ok(message)) = found.map(&decode) else { continue };
        let mut frame = Vec::new();
        encode(&message, &mut frame);
        if let Some(again) = Deframer::default().next(&mut &frame[..]) {
            assert_eq!(again.map(&decode), Ok(Ok(message)));
        }
    }
    assert!(line.is_empty());
}

/// A host receives the line in pieces while time passes.
fn converse(line: &[u8]) {
    let settings = Settings { rate_hz: 1000.0, baud: Some(921_600), latency_ns: 0, park: [0.0; 2], silence: Duration::from_millis(20), most_in_flight: 3 };
    let mut session = Session::new(settings, Arc::<Counters>::default());
    let mut now = Mono(1_000_000_000_000);
    session.connected(now);
    let mut time = None;
    for piece in line.chunks(64) {
        session.received(piece, now);
        while let Some(event) = session.event() {
            if let SourceEvent::Scan(scan) = event {
                assert!(time.is_none_or(|time| time < scan.time), "time goes back");
                time = Some(scan.time);
            }
        }
        let output = session.output().len();
        session.written(output);
        now = now + i64::from(piece[0]) * 1_000_000;
        session.timed_out(now);
    }
}
