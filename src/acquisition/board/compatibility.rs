//! Checks whether a board can be used with the configuration.

use trifacet_core::signals::Identity;
use trifacet_wire::board::{BoardIdentity, ScanFormat, required_baud};
use trifacet_wire::channel::{MAX_CHANNELS, Role, SIGNALS};

use super::Settings;

/// Range of the board's clock: fine enough for the time of a scan, and slow enough to distinguish its ticks.
const TICK_HZ: std::ops::RangeInclusive<u32> = 10_000..=1_000_000_000;

/// Resolution of converters and outputs, bits.
const BITS: std::ops::RangeInclusive<u8> = 8..=24;

/// A property of a board that is not supported.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum CompatibilityError {
    /// Number of channels.
    #[error("it has {channels} channels; supported: 9 to {MAX_CHANNELS}")]
    Channels {
        /// The number.
        channels: usize,
    },
    /// A signal is absent, or more than one channel carries it.
    #[error("{count} of its channels carry {signal}; exactly one is required")]
    Signal {
        /// The signal.
        signal: Role,
        /// Number of channels that carry it.
        count: usize,
    },
    /// Resolution of the converter.
    #[error("its converter has {bits} bits; supported: 8 to 24")]
    ConverterBits {
        /// The resolution, bits.
        bits: u8,
    },
    /// Resolution of the steering outputs.
    #[error("its steering outputs have {bits} bits; supported: 8 to 24")]
    OutputBits {
        /// The resolution, bits.
        bits: u8,
    },
    /// The converter has no range.
    #[error("its converter has a range of 0 V")]
    NoRange,
    /// Frequency of the clock.
    #[error("its clock runs at {tick_hz} Hz; supported: 10 kHz to 1 GHz")]
    Clock {
        /// The frequency, Hz.
        tick_hz: u32,
    },
    /// The configured sampling rate is outside the range of the board.
    #[error("it samples at {slowest_hz} to {fastest_hz} Hz; acquisition.rate_hz is {rate_hz}")]
    Rate {
        /// Lowest rate of the board, Hz.
        slowest_hz: f64,
        /// Highest rate of the board, Hz.
        fastest_hz: f64,
        /// `acquisition.rate_hz`.
        rate_hz: f64,
    },
    /// The link is too slow for the samples of the board.
    #[error(
        "its {channels} channels at {rate_hz} Hz need {needed} baud; the configured rate of the line is {baud} baud"
    )]
    Baud {
        /// Number of channels of the board.
        channels: usize,
        /// `acquisition.rate_hz`.
        rate_hz: f64,
        /// Lowest speed of the link that is sufficient, baud.
        needed: u32,
        /// The configured one.
        baud: u32,
    },
}

/// Checks a board.
///
/// # Errors
/// A property of the board is not supported, or the configured rate or baud rate does not suit the board.
pub fn check(board: &BoardIdentity, settings: &Settings) -> Result<(), CompatibilityError> {
    let channels = board.roles.len();
    if !(SIGNALS.len()..=MAX_CHANNELS).contains(&channels) {
        return Err(CompatibilityError::Channels { channels });
    }
    for signal in SIGNALS {
        let count = board.roles.iter().filter(|role| **role == signal).count();
        if count != 1 {
            return Err(CompatibilityError::Signal { signal, count });
        }
    }
    check_numbers(board)?;
    check_rate(board, settings)
}

fn check_numbers(board: &BoardIdentity) -> Result<(), CompatibilityError> {
    let (bits, output_bits) = (board.converter.bits, board.output_bits);
    if !BITS.contains(&bits) {
        return Err(CompatibilityError::ConverterBits { bits });
    }
    if !BITS.contains(&output_bits) {
        return Err(CompatibilityError::OutputBits { bits: output_bits });
    }
    if board.converter.range_v <= 0.0 {
        return Err(CompatibilityError::NoRange);
    }
    if !TICK_HZ.contains(&board.tick_hz) {
        return Err(CompatibilityError::Clock { tick_hz: board.tick_hz });
    }
    Ok(())
}

fn check_rate(board: &BoardIdentity, settings: &Settings) -> Result<(), CompatibilityError> {
    let Settings { rate_hz, baud, .. } = *settings;
    let [slowest_hz, fastest_hz] = board.rate_mhz.map(|rate| f64::from(rate) * 1e-3);
    if !(slowest_hz..=fastest_hz).contains(&rate_hz) {
        return Err(CompatibilityError::Rate { slowest_hz, fastest_hz, rate_hz });
    }
    let (channels, needed) =
        (board.roles.len(), required_baud(board.roles.len(), rate_hz, ScanFormat::Short));
    match baud {
        Some(baud) if baud < needed => Err(CompatibilityError::Baud { channels, rate_hz, needed, baud }),
        _ => Ok(()),
    }
}

/// The scans that the board is asked for: those of version 1.1 if it speaks that version and the line has room.
pub fn scan_format(board: &BoardIdentity, settings: &Settings) -> ScanFormat {
    let Some(extension) = &board.extension else { return ScanFormat::Short };
    let format = extension.scan_format();
    let needed = required_baud(board.roles.len(), settings.rate_hz, format);
    if let Some(baud) = settings.baud.filter(|baud| *baud < needed) {
        tracing::info!(baud, needed, "the line is too slow for scans of version 1.1; those of 1.0 are used");
        return ScanFormat::Short;
    }
    format
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
