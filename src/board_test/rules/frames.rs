//! Frames and messages that the board does not understand.

use std::time::Duration;

use trifacet_wire::board::message::ErrorReason;
use trifacet_wire::board::{Answer, Request, framing};

use crate::board_test::bench::Bench;
use crate::board_test::line::within;
use crate::board_test::verdict::{Broken, fail};

/// The frame of a message.
fn frame(message: &[u8]) -> Vec<u8> {
    let mut frame = Vec::new();
    framing::encode(message, &mut frame);
    frame
}

fn error(reason: ErrorReason, kind: u8) -> Answer {
    Answer::Error { reason, kind }
}

/// A board that is still understood.
fn still_answers(bench: &mut Bench) -> Result<(), Broken> {
    match bench.ask(Request::Identify { minor: 0 })? {
        Some(Answer::Identity(_)) => Ok(()),
        other => fail(format!("then IDENTIFY: {other:?}"), "IDENTITY"),
    }
}

/// A stopped board sends nothing without a request.
pub(super) fn silence(bench: &mut Bench) -> Result<String, Broken> {
    let time = Duration::from_millis(500);
    match bench.next(within(time))? {
        Some(received) => fail(received.text(), "nothing without a request while stopped"),
        None => Ok(format!("nothing in {} ms", time.as_millis())),
    }
}

/// Damaged frames are dropped and answered.
pub(super) fn damaged(bench: &mut Bench) -> Result<String, Broken> {
    let mut wrong_bit = frame(&[0x01, 1]);
    wrong_bit[2] ^= 2;
    let corrupted = error(ErrorReason::Corrupted, 0);
    for (what, line) in [
        ("a wrong checksum", wrong_bit),
        ("wrong COBS encoding", vec![9, 1, 0]),
        ("random bytes", b"no frame at all\0".to_vec()),
        ("a frame of 1000 bytes", [vec![1; 1000], vec![0]].concat()),
    ] {
        bench.expect(what, &line, &corrupted)?;
        bench.expect_nothing(&format!("after {what}"), &[])?;
    }
    still_answers(bench)?;
    Ok("ERROR 1 to each".into())
}

/// Empty frames are ignored, and terminate an incomplete one.
pub(super) fn empty(bench: &mut Bench) -> Result<String, Broken> {
    bench.expect_nothing("empty frames", &[0, 0, 0, 0])?;
    bench.expect("an incomplete frame, then a zero", &[5, 1, 2, 0], &error(ErrorReason::Corrupted, 0))?;
    still_answers(bench)?;
    Ok("ignored".into())
}

/// Unknown types and versions, wrong lengths and values.
pub(super) fn not_understood(bench: &mut Bench) -> Result<String, Broken> {
    let steer = |on_expiry: u8| [&[0x04, 1][..], &[0; 12], &[200, 0, on_expiry]].concat();
    let steer_and_more = [steer(2), vec![0]].concat();
    for (what, message, reason) in [
        ("type 0x05", vec![0x05, 1], ErrorReason::Type),
        ("type 0x7f", vec![0x7f, 1, 1, 2, 3], ErrorReason::Type),
        ("version 2", vec![0x01, 2], ErrorReason::Version),
        ("version 2 of an unknown type", vec![0x7f, 2], ErrorReason::Version),
        ("STOP with a body", vec![0x03, 1, 0], ErrorReason::Length),
        ("STEER without its last byte", steer(0)[..16].to_vec(), ErrorReason::Length),
        ("STEER, too long and with a wrong value", steer_and_more, ErrorReason::Length),
        ("STEER with on_expiry 2", steer(2), ErrorReason::Value),
    ] {
        bench.expect(what, &frame(&message), &error(reason, message[0]))?;
    }
    still_answers(bench)?;
    Ok("ERROR 2, 3, 4, 5".into())
}

/// Messages of a board are dropped.
pub(super) fn echo(bench: &mut Bench) -> Result<String, Broken> {
    for message in [&[0x85, 1, 1, 0][..], &[0x83, 1, 1, 0, 0, 0, 0], &[0xff, 1], &[0x81, 2]] {
        bench.expect_nothing(&format!("an echo of type {:#04x}", message[0]), &frame(message))?;
    }
    still_answers(bench)?;
    Ok("dropped".into())
}
