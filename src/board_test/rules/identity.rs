//! IDENTITY.

use trifacet_core::time::Clock;
use trifacet_wire::board::{Answer, BoardIdentity, MINOR, Request};
use trifacet_wire::channel::{MAX_CHANNELS, SIGNALS};

use crate::board_test::bench::Bench;
use crate::board_test::verdict::{Broken, fail};
use crate::clock::SystemClock;

/// Number of requests.
const TIMES: u32 = 5;
/// Longest time until the answer, seconds.
const ANSWER_S: f64 = 0.5;

fn ask(bench: &mut Bench, minor: u8) -> Result<BoardIdentity, Broken> {
    match bench.ask(Request::Identify { minor })? {
        Some(Answer::Identity(identity)) => Ok(identity),
        other => fail(format!("IDENTIFY: {other:?}"), "IDENTITY"),
    }
}

/// The answer comes in time, in every state, and is always the same.
pub(super) fn answered(bench: &mut Bench) -> Result<String, Broken> {
    let (first, mut fastest) = (ask(bench, 0)?, f64::INFINITY);
    for n in 0..TIMES {
        if n == TIMES - 1 {
            bench.start(0, [0; 2])?;
        }
        let asked = SystemClock.now();
        let again = ask(bench, 0)?;
        fastest = fastest.min(SystemClock.now().seconds_since(asked));
        if again != first {
            return fail(format!("first {first:?}, then {again:?}"), "the same IDENTITY to each IDENTIFY");
        }
    }
    if fastest > ANSWER_S {
        return fail(format!("an answer after {:.0} ms", fastest * 1e3), "an answer within 500 ms");
    }
    Ok(format!("{}, {} channels; answers after {:.1} ms", first.name, first.roles.len(), fastest * 1e3))
}

/// Its values are within their limits, and each signal has one channel.
pub(super) fn values(bench: &mut Bench) -> Result<String, Broken> {
    let board = bench.identity.clone();
    let [slowest, fastest] = board.rate_mhz;
    let limits = [
        ("tick_hz", board.tick_hz.into(), 10_000..=1_000_000_000_u64),
        ("converter_bits", board.converter.bits.into(), 8..=24),
        ("output_bits", board.output_bits.into(), 8..=24),
        ("range", (board.converter.range_v * 1e3).round() as u64, 1..=u32::MAX.into()),
        ("slowest", slowest.into(), 1..=fastest.into()),
        ("channels", board.roles.len() as u64, SIGNALS.len() as u64..=MAX_CHANNELS as u64),
    ];
    for (name, value, allowed) in limits {
        if !allowed.contains(&value) {
            return fail(format!("{name} is {value}"), format!("{} to {}", allowed.start(), allowed.end()));
        }
    }
    for signal in SIGNALS {
        let count = board.roles.iter().filter(|role| **role == signal).count();
        if count != 1 {
            return fail(
                format!("{count} channels carry {signal}"),
                "one channel for each of the nine signals",
            );
        }
    }
    let mut frame = Vec::new();
    Request::Identify { minor: 0 }.encode(&mut frame);
    let message = bench.answer_to(&frame)?.and_then(|received| received.message.ok());
    match message.as_deref().and_then(|message| message.get(20)) {
        Some(flags) if flags & !3 != 0 => fail(format!("flags {flags:#04x}"), "only bits 0 and 1"),
        _ => Ok(format!("{} to {} Hz, clock of {} Hz", slowest / 1000, fastest / 1000, board.tick_hz)),
    }
}

/// The boot id stays.
pub(super) fn boot_id(bench: &mut Bench) -> Result<String, Broken> {
    let Some(extension) = bench.identity.extension.clone() else {
        return Err(Broken::Skip("the board speaks version 1.0".into()));
    };
    for minor in [MINOR, u8::MAX, MINOR] {
        let again = ask(bench, minor)?.extension;
        if again.as_ref() != Some(&extension) {
            return fail(format!("first {extension:?}, then {again:?}"), "the same fields to each IDENTIFY");
        }
    }
    Ok(format!("{:#010x}", extension.boot_id))
}
