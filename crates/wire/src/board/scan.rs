//! One scan, as sent on the line: SCAN of version 1.0, LONG_SCAN of version 1.1.

use super::error::MessageError;
use super::fields::{Reader, Writer};
use crate::channel::MAX_CHANNELS;

/// Bits of the status.
mod status {
    pub(super) const RAILED: u8 = 1;
    pub(super) const LEASE_EXPIRED: u8 = 2;
    pub(super) const OVERRUN: u8 = 4;
    /// LONG_SCAN only: a command has been applied since power-up.
    pub(super) const APPLIED: u8 = 8;
    /// LONG_SCAN only: the tick has 64 bits.
    pub(super) const WIDE_TICK: u8 = 16;
}

/// The message that carries a scan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ScanFormat {
    /// SCAN, with a tick of 32 bits.
    #[default]
    Short,
    /// LONG_SCAN, with the id of the last applied command.
    Long {
        /// The tick has 64 bits instead of 32.
        wide_tick: bool,
    },
}

impl ScanFormat {
    /// LONG_SCAN with a tick of 32 bits.
    pub const LONG: Self = Self::Long { wide_tick: false };

    /// Bytes of the body before the codes.
    pub fn head_bytes(self) -> usize {
        match self {
            Self::Short => 9,
            Self::Long { wide_tick: false } => 13,
            Self::Long { wide_tick: true } => 17,
        }
    }

    /// Width of the tick, bits.
    pub fn tick_bits(self) -> u32 {
        if self == (Self::Long { wide_tick: true }) { 64 } else { 32 }
    }
}

/// One scan, as sent by the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BoardScan {
    /// The message.
    pub format: ScanFormat,
    /// Counts the scans since `Start`, those not sent included; wraps.
    pub sequence: u32,
    /// Clock of the board at the scan, ticks; wraps at the width of the format.
    pub tick: u64,
    /// Id of the last command that the outputs had taken over when the scan was taken. `None` if there was none
    /// since power-up, and in a short scan.
    pub applied: Option<u32>,
    /// The outputs are at a limit of the stage.
    pub output_railed: bool,
    /// The lease of the last command has expired, and the outputs hold or park.
    pub lease_expired: bool,
    /// The board read its converter too late just before this scan.
    pub overrun: bool,
    /// Number of codes.
    pub channels: u8,
    /// The codes; zero beyond the last channel.
    pub codes: [i32; MAX_CHANNELS],
}

impl BoardScan {
    pub(super) fn write(&self, message: Writer) -> Writer {
        let bit = |is: bool, bit: u8| if is { bit } else { 0 };
        let status = bit(self.output_railed, status::RAILED)
            | bit(self.lease_expired, status::LEASE_EXPIRED)
            | bit(self.overrun, status::OVERRUN);
        let message = message.u32(self.sequence);
        let message = match self.format {
            ScanFormat::Short => message.u32(self.tick as u32).u8(status),
            ScanFormat::Long { wide_tick } => {
                let status =
                    status | bit(self.applied.is_some(), status::APPLIED) | bit(wide_tick, status::WIDE_TICK);
                let message = message.u8(status).u32(self.applied.unwrap_or(0));
                if wide_tick { message.u64(self.tick) } else { message.u32(self.tick as u32) }
            }
        };
        self.codes.iter().take(usize::from(self.channels)).fold(message, |message, code| message.i24(*code))
    }

    pub(super) fn read_short(body: &mut Reader) -> Result<Self, MessageError> {
        let (sequence, tick, status) = (body.u32()?, body.u32()?, body.u8()?);
        Self { sequence, tick: tick.into(), ..Self::default() }.with_status(status).with_codes(body)
    }

    pub(super) fn read_long(body: &mut Reader) -> Result<Self, MessageError> {
        let (sequence, status, applied) = (body.u32()?, body.u8()?, body.u32()?);
        let wide_tick = status & status::WIDE_TICK != 0;
        let tick = if wide_tick { body.u64()? } else { body.u32()?.into() };
        let scan = Self {
            format: ScanFormat::Long { wide_tick },
            sequence,
            tick,
            applied: (status & status::APPLIED != 0).then_some(applied),
            ..Self::default()
        };
        scan.with_status(status).with_codes(body)
    }

    fn with_status(self, status: u8) -> Self {
        Self {
            output_railed: status & status::RAILED != 0,
            lease_expired: status & status::LEASE_EXPIRED != 0,
            overrun: status & status::OVERRUN != 0,
            ..self
        }
    }

    fn with_codes(mut self, body: &mut Reader) -> Result<Self, MessageError> {
        let channels = body.rest.len() / 3;
        if channels > MAX_CHANNELS {
            return Err(body.wrong_length());
        }
        for code in &mut self.codes[..channels] {
            *code = body.i24()?;
        }
        self.channels = channels as u8;
        Ok(self)
    }
}
