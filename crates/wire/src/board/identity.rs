//! The identity of a board, as sent on the line.

use alloc::borrow::ToOwned;
use alloc::string::String;
use alloc::vec::Vec;

use super::error::MessageError;
use super::fields::{Reader, Writer};
use super::scan::ScanFormat;
use super::unit::{ChannelUnit, MAX_UNITS};
use crate::channel::{Converter, Role, round};

/// The longest name of a board in bytes.
pub const MAX_NAME: usize = 64;

/// Bits of the flags.
mod flag {
    pub(super) const SIMULATED: u8 = 1;
    /// The board speaks version 1.1 or later.
    pub(super) const MINOR: u8 = 2;
}

/// What version 1.1 adds to an identity. A board sends it only to a host that states version 1.1 in IDENTIFY.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Extension {
    /// Highest minor version of the board; at least 1.
    pub minor: u8,
    /// The tick of LONG_SCAN has 64 bits instead of 32.
    pub wide_tick: bool,
    /// A number that differs from power-up to power-up.
    pub boot_id: u32,
    /// Units of the channels that carry no signal of the sensor; at most [`MAX_UNITS`].
    pub units: Vec<ChannelUnit>,
}

impl Extension {
    /// The scans of this board if they are started with minor version 1.
    pub fn scan_format(&self) -> ScanFormat {
        ScanFormat::Long { wide_tick: self.wide_tick }
    }

    fn write(&self, message: Writer) -> Writer {
        let units = &self.units[..self.units.len().min(MAX_UNITS)];
        let message = message
            .u8(self.minor)
            .u8(if self.wide_tick { 64 } else { 32 })
            .u32(self.boot_id)
            .u8(units.len() as u8);
        units.iter().fold(message, |message, unit| unit.write(message))
    }

    fn read(body: &mut Reader) -> Result<Self, MessageError> {
        let (minor, tick_bits, boot_id, count) = (body.u8()?, body.u8()?, body.u32()?, body.u8()?);
        let units = (0..count).map(|_| ChannelUnit::read(body)).collect::<Result<Vec<_>, _>>()?;
        if !body.rest.is_empty() {
            return Err(body.wrong_length());
        }
        let wide_tick = match tick_bits {
            32 => false,
            64 => true,
            _ => return Err(body.meaningless("width of the tick")),
        };
        if minor == 0 {
            return Err(body.meaningless("minor version"));
        }
        if units.len() > MAX_UNITS {
            return Err(body.meaningless("number of units"));
        }
        Ok(Self { minor, wide_tick, boot_id, units })
    }
}

/// The identity of a board.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardIdentity {
    /// Ticks of the board's clock per second.
    pub tick_hz: u32,
    /// The converter; its range is sent in whole millivolts.
    pub converter: Converter,
    /// Resolution of the steering outputs in bits, sign included.
    pub output_bits: u8,
    /// The light is simulated, not measured.
    pub simulated: bool,
    /// Slowest and fastest rate, scans per 1000 seconds.
    pub rate_mhz: [u32; 2],
    /// What each channel measures.
    pub roles: Vec<Role>,
    /// Sampling time of each channel after the tick of the scan, nanoseconds.
    pub skew_ns: Vec<u32>,
    /// Maker, model, firmware, serial number, in readable form.
    pub name: String,
    /// The board speaks version 1.1 or later.
    pub extensible: bool,
    /// What version 1.1 adds.
    pub extension: Option<Extension>,
}

impl BoardIdentity {
    pub(super) fn write(&self, message: Writer) -> Writer {
        let message = message
            .u32(self.tick_hz)
            .u8(self.converter.bits)
            .u8(self.output_bits)
            .u32(round(self.converter.range_v * 1e3) as u32)
            .u32(self.rate_mhz[0])
            .u32(self.rate_mhz[1])
            .u8(self.flags())
            .u8(self.roles.len() as u8);
        let message = self
            .roles
            .iter()
            .zip(&self.skew_ns)
            .fold(message, |message, (role, skew)| message.u8(role.number()).u32(*skew));
        let name = shortened(&self.name);
        let message = message.u8(name.len() as u8).bytes(name.as_bytes());
        self.extension.iter().fold(message, |message, extension| extension.write(message))
    }

    fn flags(&self) -> u8 {
        let speaks_more = self.extensible || self.extension.is_some();
        (u8::from(self.simulated) * flag::SIMULATED) | (u8::from(speaks_more) * flag::MINOR)
    }

    pub(super) fn read(body: &mut Reader) -> Result<Self, MessageError> {
        let tick_hz = body.u32()?;
        let bits = body.u8()?;
        let output_bits = body.u8()?;
        let range_v = f64::from(body.u32()?) * 1e-3;
        let rate_mhz = [body.u32()?, body.u32()?];
        let flags = body.u8()?;
        let channels = usize::from(body.u8()?);
        let mut roles = Vec::with_capacity(channels);
        let mut skew_ns = Vec::with_capacity(channels);
        for _ in 0..channels {
            roles.push(Role::of(body.u8()?));
            skew_ns.push(body.u32()?);
        }
        let length = usize::from(body.u8()?);
        let name = shortened(&String::from_utf8_lossy(body.bytes(length)?)).to_owned();
        let extension = if body.rest.is_empty() { None } else { Some(Extension::read(body)?) };
        Ok(Self {
            tick_hz,
            converter: Converter { bits, range_v },
            output_bits,
            simulated: flags & flag::SIMULATED != 0,
            rate_mhz,
            roles,
            skew_ns,
            name,
            extensible: flags & flag::MINOR != 0 || extension.is_some(),
            extension,
        })
    }
}

/// The name, shortened to the maximum length.
pub(super) fn shortened(name: &str) -> &str {
    &name[..name.floor_char_boundary(MAX_NAME)]
}
