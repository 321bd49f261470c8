//! Whether a board can be used.

use trifacet_core::signals::Identity;
use trifacet_wire::board::{BoardIdentity, required_baud};
use trifacet_wire::channel::{MAX_CHANNELS, SIGNALS};

use super::Settings;

/// The board's clock has to resolve the time of a scan, and its ticks have to be told apart.
const TICK_HZ: std::ops::RangeInclusive<u32> = 10_000..=1_000_000_000;

/// Bits of converters and outputs.
const BITS: std::ops::RangeInclusive<u8> = 8..=24;

/// Says what is wrong with the board, if anything is: what it has, and what is needed.
pub fn check(board: &BoardIdentity, settings: &Settings) -> Result<(), String> {
    let channels = board.roles.len();
    if !(SIGNALS.len()..=MAX_CHANNELS).contains(&channels) {
        return Err(format!("it has {channels} channels; 9 to {MAX_CHANNELS} can be used"));
    }
    for signal in SIGNALS {
        let count = board.roles.iter().filter(|role| **role == signal).count();
        if count != 1 {
            return Err(format!("{count} of its channels are {signal}; each signal is needed exactly once"));
        }
    }
    check_numbers(board)?;
    check_rate(board, settings)
}

fn check_numbers(board: &BoardIdentity) -> Result<(), String> {
    let (bits, output_bits) = (board.converter.bits, board.output_bits);
    if !BITS.contains(&bits) {
        return Err(format!("its converter has {bits} bits; 8 to 24 can be used"));
    }
    if !BITS.contains(&output_bits) {
        return Err(format!("its steering outputs have {output_bits} bits; 8 to 24 can be used"));
    }
    if board.converter.range_v <= 0.0 {
        return Err("its converter has a range of 0 V".into());
    }
    if !TICK_HZ.contains(&board.tick_hz) {
        return Err(format!("its clock ticks at {} Hz; 10 kHz to 1 GHz can be used", board.tick_hz));
    }
    Ok(())
}

fn check_rate(board: &BoardIdentity, settings: &Settings) -> Result<(), String> {
    let rate_hz = settings.rate_hz;
    let [slowest, fastest] = board.rate_mhz.map(|rate| f64::from(rate) * 1e-3);
    if !(slowest..=fastest).contains(&rate_hz) {
        return Err(format!("it samples at {slowest} to {fastest} Hz; acquisition.rate_hz is {rate_hz}"));
    }
    let (channels, needed) = (board.roles.len(), required_baud(board.roles.len(), rate_hz));
    if settings.baud < needed {
        return Err(format!(
            "its {channels} channels at {rate_hz} Hz need {needed} baud; acquisition.serial.baud is {}",
            settings.baud
        ));
    }
    Ok(())
}

/// As the rest of the house knows a source.
pub fn identity(board: &BoardIdentity, rate_hz: f64) -> Identity {
    Identity {
        name: board.name.clone(),
        rate_hz,
        converter: board.converter,
        roles: board.roles.clone(),
        skew_ns: board.skew_ns.clone(),
        output_bits: board.output_bits,
        simulated: board.simulated,
    }
}

/// The output codes of a position given in parts of full scale.
pub fn output_codes(board: &BoardIdentity, parts: [f64; 2]) -> [i32; 2] {
    let full = f64::from(1_u32 << (board.output_bits - 1));
    parts.map(|part| (part * full).round().clamp(-full, full - 1.0) as i32)
}
