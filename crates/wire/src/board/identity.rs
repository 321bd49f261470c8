//! The identity of a board, as sent on the line.

use alloc::borrow::ToOwned;
use alloc::string::String;
use alloc::vec::Vec;

use super::error::MessageError;
use super::fields::{Reader, Writer};
use crate::channel::{Converter, Role, round};

/// The longest name of a board in bytes.
pub const MAX_NAME: usize = 64;

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
            .u8(u8::from(self.simulated))
            .u8(self.roles.len() as u8);
        let message = self
            .roles
            .iter()
            .zip(&self.skew_ns)
            .fold(message, |message, (role, skew)| message.u8(role.number()).u32(*skew));
        let name = shortened(&self.name);
        message.u8(name.len() as u8).bytes(name.as_bytes())
    }

    pub(super) fn read(body: &mut Reader) -> Result<Self, MessageError> {
        let tick_hz = body.u32()?;
        let bits = body.u8()?;
        let output_bits = body.u8()?;
        let range_v = f64::from(body.u32()?) * 1e-3;
        let rate_mhz = [body.u32()?, body.u32()?];
        let simulated = body.u8()? & 1 != 0;
        let channels = usize::from(body.u8()?);
        let mut roles = Vec::with_capacity(channels);
        let mut skew_ns = Vec::with_capacity(channels);
        for _ in 0..channels {
            roles.push(Role::of(body.u8()?));
            skew_ns.push(body.u32()?);
        }
        let length = usize::from(body.u8()?);
        let name = shortened(&String::from_utf8_lossy(body.bytes(length)?)).to_owned();
        let converter = Converter { bits, range_v };
        Ok(Self { tick_hz, converter, output_bits, simulated, rate_mhz, roles, skew_ns, name })
    }
}

/// The name, shortened to the maximum length.
fn shortened(name: &str) -> &str {
    &name[..name.floor_char_boundary(MAX_NAME)]
}
