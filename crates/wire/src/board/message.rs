//! Messages of the board protocol: requests of the host, answers of the board.
//!
//! Every message starts with its type and the version of the protocol. All numbers are little-endian.

use alloc::borrow::ToOwned;
use alloc::string::String;
use alloc::vec::Vec;

use super::error::{MINOR, MessageError};
use super::fields::{Reader, Writer};
use super::identity::{BoardIdentity, shortened};
use super::scan::{BoardScan, ScanFormat};
use crate::actuator::{Ack, LeaseAction, OutputCommand};

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
    pub(super) const LONG_SCAN: u8 = 0x86;
    pub(super) const BUSY: u8 = 0x87;
}

/// From host to board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Asks for the identity of the board.
    Identify {
        /// Highest minor version that the host understands.
        minor: u8,
    },
    /// Starts scanning, from sequence number 0.
    Start {
        /// Scans per 1000 seconds.
        rate_mhz: u32,
        /// Parking position of the outputs, codes.
        park: [i32; 2],
        /// Minor version of the scans: 0 for SCAN, 1 for LONG_SCAN.
        minor: u8,
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
    /// Only on a network: another host has the board, which closes this connection.
    Busy {
        /// The other host, in readable form; at most [`MAX_NAME`](super::identity::MAX_NAME) bytes.
        host: String,
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
            Self::Identify { minor } => Writer::new(kind::IDENTIFY).minor(minor),
            Self::Start { rate_mhz, park, minor } => {
                Writer::new(kind::START).u32(rate_mhz).i32(park[0]).i32(park[1]).minor(minor)
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

    /// Reads a message (type, version, body), as a board of version 1.`minor`.
    ///
    /// # Errors
    /// The version, type, length or a value is wrong.
    pub fn decode(message: &[u8], minor: u8) -> Result<Self, MessageError> {
        let mut body = Reader::new(message)?;
        let request = match body.kind {
            kind::IDENTIFY => Self::Identify { minor: body.minor(minor)? },
            kind::START => Self::Start {
                rate_mhz: body.u32()?,
                park: [body.i32()?, body.i32()?],
                minor: match body.minor(minor)? {
                    known @ 0..=MINOR => known,
                    _ => return Err(body.meaningless("minor version")),
                },
            },
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
            Self::Scan(scan) => scan.write(Writer::new(match scan.format {
                ScanFormat::Short => kind::SCAN,
                ScanFormat::Long { .. } => kind::LONG_SCAN,
            })),
            Self::Error { reason, kind } => Writer::new(kind::ERROR).u8(*reason as u8).u8(*kind),
            Self::Busy { host } => {
                let host = shortened(host);
                Writer::new(kind::BUSY).u8(host.len() as u8).bytes(host.as_bytes())
            }
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
            kind::SCAN => Self::Scan(BoardScan::read_short(&mut body)?),
            kind::LONG_SCAN => Self::Scan(BoardScan::read_long(&mut body)?),
            kind::ERROR => Self::Error {
                reason: ErrorReason::from_number(body.u8()?).ok_or_else(|| body.meaningless("reason"))?,
                kind: body.u8()?,
            },
            kind::BUSY => {
                let length = usize::from(body.u8()?);
                let host = String::from_utf8_lossy(body.bytes(length)?);
                Self::Busy { host: shortened(&host).to_owned() }
            }
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
            for minor in 0..=2 {
                let _ = Request::decode(&bytes, minor);
            }
            if let Ok(Answer::Scan(scan)) = Answer::decode(&bytes) {
                prop_assert_eq!(2 + scan.format.head_bytes() + 3 * usize::from(scan.channels), bytes.len());
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
