//! Messages of the board protocol: requests of the host, answers of the board.
//!
//! Every message starts with its type and the version of the protocol. All numbers are little-endian.

use alloc::vec::Vec;

use super::error::MessageError;
use super::fields::{Reader, Writer};
use super::identity::BoardIdentity;
use crate::actuator::{Ack, LeaseAction, OutputCommand};
use crate::channel::MAX_CHANNELS;

mod kind {
    pub(super) const IDENTIFY: u8 = 0x01;
    pub(super) const START: u8 = 0x02;
    pub(super) const STOP: u8 = 0x03;
    pub(super) const STEER: u8 = 0x04;
    pub(super) const IDENTITY: u8 = 0x81;
    pub(super) const REPLY: u8 = 0x82;
    pub(super) const ACK: u8 = 0x83;
    pub(super) const SCAN: u8 = 0x84;
    pub(super) const ERROR: u8 = 0x85;
}

/// From host to board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Asks for the identity of the board.
    Identify,
    /// Starts scanning, from sequence number 0.
    Start {
        /// Scans per 1000 seconds.
        rate_mhz: u32,
        /// Parking position of the outputs, codes.
        park: [i32; 2],
    },
    /// Stops scanning.
    Stop,
    /// Moves the steering outputs.
    Steer(OutputCommand),
}

/// From board to host.
#[derive(Clone, Debug, PartialEq)]
pub enum Answer {
    /// Answer to `Identify`.
    Identity(BoardIdentity),
    /// Answer to `Start` and `Stop`.
    Reply(Reply),
    /// Answer to `Steer`.
    Ack {
        /// Id of the command.
        id: u32,
        /// Result of the command.
        result: SteerResult,
    },
    /// One scan.
    Scan(BoardScan),
    /// Answer to a frame that the board could not read.
    Error {
        /// The reason.
        reason: ErrorReason,
        /// Type of that message; 0 if the frame was corrupted.
        kind: u8,
    },
}

/// Answer to `Start` or `Stop`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reply {
    /// True for `Start`, false for `Stop`.
    pub start: bool,
    /// Result of the request.
    pub result: StartResult,
    /// The rate from now on, scans per 1000 seconds; 0 while stopped.
    pub rate_mhz: u32,
}

/// One scan, as sent by the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BoardScan {
    /// Counts the scans since `Start`, those not sent included; wraps.
    pub sequence: u32,
    /// Clock of the board at the scan, ticks; wraps.
    pub tick: u32,
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

macro_rules! numbered {
    ($(#[$doc:meta])* $name:ident { $($(#[$vdoc:meta])* $variant:ident = $number:literal),* $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum $name { $($(#[$vdoc])* $variant = $number),* }

        impl $name {
            fn from_number(number: u8) -> Option<Self> {
                match number { $($number => Some(Self::$variant),)* _ => None }
            }
        }
    };
}

numbered! {
    /// Result of a `Start` or `Stop`.
    StartResult {
        /// Done.
        Done = 0,
        /// The rate is outside the board's limits: nothing changed.
        RateOutOfRange = 1,
        /// A parking code is outside the range of the outputs: nothing changed.
        ParkOutOfRange = 2,
    }
}

numbered! {
    /// Result of a `Steer`.
    SteerResult {
        /// The outputs move.
        Accepted = 0,
        /// A code or the lease is out of range: nothing changed, and the previous lease continues.
        OutOfRange = 1,
        /// The board has not been started: nothing changed.
        NotStarted = 2,
    }
}

numbered! {
    /// Reason why the board could not read a frame.
    ErrorReason {
        /// Wrong checksum or stuffing.
        Corrupted = 1,
        /// Unknown type.
        Type = 2,
        /// Another version of the protocol.
        Version = 3,
        /// Wrong length for its type.
        Length = 4,
        /// A field has an undefined value.
        Value = 5,
    }
}

impl MessageError {
    /// The answer with which a board reports this error.
    pub fn to_answer(self) -> Answer {
        let (reason, kind) = match self {
            Self::Version { kind, .. } => (ErrorReason::Version, kind),
            Self::Type(kind) => (ErrorReason::Type, kind),
            Self::Length { kind, .. } => (ErrorReason::Length, kind),
            Self::Value { kind, .. } => (ErrorReason::Value, kind),
        };
        Answer::Error { reason, kind }
    }
}

impl Request {
    /// Appends the frame of this request to `out`.
    pub fn encode(&self, out: &mut Vec<u8>) {
        let message = match *self {
            Self::Identify => Writer::new(kind::IDENTIFY),
            Self::Start { rate_mhz, park } => {
                Writer::new(kind::START).u32(rate_mhz).i32(park[0]).i32(park[1])
            }
            Self::Stop => Writer::new(kind::STOP),
            Self::Steer(OutputCommand { id, codes, lease_ms, on_expiry }) => Writer::new(kind::STEER)
                .u32(id)
                .i32(codes[0])
                .i32(codes[1])
                .u16(lease_ms)
                .u8(u8::from(on_expiry == LeaseAction::Park)),
        };
        message.frame(out);
    }

    /// Reads a message (type, version, body).
    ///
    /// # Errors
    /// The version, type, length or a value is wrong.
    pub fn decode(message: &[u8]) -> Result<Self, MessageError> {
        let mut body = Reader::new(message)?;
        let request = match body.kind {
            kind::IDENTIFY => Self::Identify,
            kind::START => Self::Start { rate_mhz: body.u32()?, park: [body.i32()?, body.i32()?] },
            kind::STOP => Self::Stop,
            kind::STEER => Self::Steer(OutputCommand {
                id: body.u32()?,
                codes: [body.i32()?, body.i32()?],
                lease_ms: body.u16()?,
                on_expiry: match body.last_u8()? {
                    0 => LeaseAction::Hold,
                    1 => LeaseAction::Park,
                    _ => return Err(body.meaningless("action on expiry")),
                },
            }),
            unknown => return Err(MessageError::Type(unknown)),
        };
        body.end(request)
    }
}

impl Answer {
    /// Appends the frame of this answer to `out`.
    pub fn encode(&self, out: &mut Vec<u8>) {
        let message = match self {
            Self::Identity(identity) => identity.write(Writer::new(kind::IDENTITY)),
            Self::Reply(Reply { start, result, rate_mhz }) => Writer::new(kind::REPLY)
                .u8(if *start { kind::START } else { kind::STOP })
                .u8(*result as u8)
                .u32(*rate_mhz),
            Self::Ack { id, result } => Writer::new(kind::ACK).u32(*id).u8(*result as u8),
            Self::Scan(scan) => scan.write(Writer::new(kind::SCAN)),
            Self::Error { reason, kind } => Writer::new(kind::ERROR).u8(*reason as u8).u8(*kind),
        };
        message.frame(out);
    }

    /// Reads a message (type, version, body).
    ///
    /// # Errors
    /// The version, type, length or a value is wrong.
    pub fn decode(message: &[u8]) -> Result<Self, MessageError> {
        let mut body = Reader::new(message)?;
        let answer = match body.kind {
            kind::IDENTITY => Self::Identity(BoardIdentity::read(&mut body)?),
            kind::REPLY => Self::Reply(Reply {
                start: match body.u8()? {
                    kind::START => true,
                    kind::STOP => false,
                    _ => return Err(body.meaningless("request")),
                },
                result: StartResult::from_number(body.u8()?).ok_or_else(|| body.meaningless("result"))?,
                rate_mhz: body.u32()?,
            }),
            kind::ACK => Self::Ack {
                id: body.u32()?,
                result: SteerResult::from_number(body.u8()?).ok_or_else(|| body.meaningless("result"))?,
            },
            kind::SCAN => Self::Scan(BoardScan::read(&mut body)?),
            kind::ERROR => Self::Error {
                reason: ErrorReason::from_number(body.u8()?).ok_or_else(|| body.meaningless("reason"))?,
                kind: body.u8()?,
            },
            unknown => return Err(MessageError::Type(unknown)),
        };
        body.end(answer)
    }
}

impl From<SteerResult> for bool {
    fn from(result: SteerResult) -> bool {
        result == SteerResult::Accepted
    }
}

impl SteerResult {
    /// The acknowledgement of a command with this result.
    pub fn ack(self, id: u32) -> Ack {
        Ack { id, accepted: self.into() }
    }
}

impl BoardScan {
    fn write(&self, message: Writer) -> Writer {
        let status =
            u8::from(self.output_railed) | u8::from(self.lease_expired) << 1 | u8::from(self.overrun) << 2;
        let message = message.u32(self.sequence).u32(self.tick).u8(status);
        self.codes.iter().take(usize::from(self.channels)).fold(message, |message, code| message.i24(*code))
    }

    fn read(body: &mut Reader) -> Result<Self, MessageError> {
        let (sequence, tick, status) = (body.u32()?, body.u32()?, body.u8()?);
        let channels = body.rest.len() / 3;
        let mut codes = [0; MAX_CHANNELS];
        if channels > MAX_CHANNELS {
            return Err(body.wrong_length());
        }
        for code in &mut codes[..channels] {
            *code = body.i24()?;
        }
        Ok(Self {
            sequence,
            tick,
            output_railed: status & 1 != 0,
            lease_expired: status & 2 != 0,
            overrun: status & 4 != 0,
            channels: channels as u8,
            codes,
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::board::framing;

    proptest! {
        #[test]
        fn any_bytes_are_a_message_or_an_error(mut bytes in prop::collection::vec(any::<u8>(), 0..260)) {
            if let [kind, version, ..] = &mut bytes[..] {
                // Half of the messages get a valid type and version.
                (*kind, *version) = if *kind & 8 == 0 { (*kind & 0x87, crate::board::VERSION) } else { (*kind, *version) };
            }
            let _ = Request::decode(&bytes);
            if let Ok(Answer::Scan(scan)) = Answer::decode(&bytes) {
                prop_assert_eq!(11 + 3 * usize::from(scan.channels), bytes.len());
                prop_assert!(scan.codes.iter().all(|code| (-(1 << 23)..1 << 23).contains(code)));
            }
        }

        #[test]
        fn codes_of_24_bits_keep_their_sign(codes in prop::array::uniform16(-(1_i32 << 23)..1 << 23)) {
            let scan = BoardScan { channels: 16, codes, ..BoardScan::default() };
            let (mut frame, mut deframer) = (Vec::new(), framing::Deframer::default());
            Answer::Scan(scan).encode(&mut frame);
            let message = deframer.next(&mut &frame[..]).unwrap().unwrap();
            prop_assert_eq!(Answer::decode(message), Ok(Answer::Scan(scan)));
        }
    }
}
