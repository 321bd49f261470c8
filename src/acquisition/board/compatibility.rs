//! Checks whether a board can be used with the configuration.

use trifacet_core::signals::Identity;
use trifacet_wire::board::{BoardIdentity, required_baud};
use trifacet_wire::channel::{MAX_CHANNELS, SIGNALS};

use super::Settings;

/// Range of the board's clock: fine enough for the time of a scan, and slow enough to distinguish its ticks.
const TICK_HZ: std::ops::RangeInclusive<u32> = 10_000..=1_000_000_000;

/// Resolution of converters and outputs, bits.
const BITS: std::ops::RangeInclusive<u8> = 8..=24;

/// Checks a board.
///
/// # Errors
/// A text with the property of the board that is not supported, and the supported range.
pub fn check(board: &BoardIdentity, settings: &Settings) -> Result<(), String> {
    let channels = board.roles.len();
    if !(SIGNALS.len()..=MAX_CHANNELS).contains(&channels) {
        return Err(format!("it has {channels} channels; supported: 9 to {MAX_CHANNELS}"));
    }
    for signal in SIGNALS {
        let count = board.roles.iter().filter(|role| **role == signal).count();
        if count != 1 {
            return Err(format!("{count} of its channels carry {signal}; exactly one is required"));
        }
    }
    check_numbers(board)?;
    check_rate(board, settings)
}

fn check_numbers(board: &BoardIdentity) -> Result<(), String> {
    let (bits, output_bits) = (board.converter.bits, board.output_bits);
    if !BITS.contains(&bits) {
        return Err(format!("its converter has {bits} bits; supported: 8 to 24"));
    }
    if !BITS.contains(&output_bits) {
        return Err(format!("its steering outputs have {output_bits} bits; supported: 8 to 24"));
    }
    if board.converter.range_v <= 0.0 {
        return Err("its converter has a range of 0 V".into());
    }
    if !TICK_HZ.contains(&board.tick_hz) {
        return Err(format!("its clock runs at {} Hz; supported: 10 kHz to 1 GHz", board.tick_hz));
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

/// The identity of the board as a source.
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

/// The output codes for a position given as a fraction of full scale.
pub fn output_codes(board: &BoardIdentity, parts: [f64; 2]) -> [i32; 2] {
    let full = f64::from(1_u32 << (board.output_bits - 1));
    parts.map(|part| (part * full).round().clamp(-full, full - 1.0) as i32)
}
