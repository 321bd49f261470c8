//! Header and CRC of the messages on TCP: an 8-byte header, a body, a CRC-32 of both.
//!
//! The header never changes, not even in a new major version, so that any reader can skip messages that it
//! does not know.

use crate::layout::FRAME_SIZE;

/// Major version of the stream: the layout of frames and messages.
pub const MAJOR: u8 = 1;
/// Minor version: additions that readers may ignore (new status bits, kinds of message, JSON keys).
pub const MINOR: u8 = 1;
/// Magic (4 bytes), major, minor, size (u16, of the whole message, little-endian).
pub const HEADER_SIZE: usize = 8;
/// The CRC at the end.
pub const CRC_SIZE: usize = 4;
/// The kinds of message that this version knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A pose frame.
    Pose,
    /// The descriptor, in JSON: the first message of every stream.
    Descriptor,
    /// A heartbeat, in JSON: once a second.
    Heartbeat,
    /// The answer to a query, as a string in JSON.
    Answer,
    /// The reason why the daemon closes the connection, in JSON.
    Refusal,
}

impl Kind {
    /// Every kind.
    pub const ALL: [Kind; 5] = [Kind::Pose, Kind::Descriptor, Kind::Heartbeat, Kind::Answer, Kind::Refusal];

    /// The first four bytes of such a message.
    pub const fn magic(self) -> [u8; 4] {
        match self {
            Kind::Pose => *b"TFP1",
            Kind::Descriptor => *b"TFD1",
            Kind::Heartbeat => *b"TFH1",
            Kind::Answer => *b"TFA1",
            Kind::Refusal => *b"TFE1",
        }
    }

    /// The key of such a message in JSON lines; `None` if the message has keys of its own.
    pub const fn key(self) -> Option<&'static str> {
        match self {
            Kind::Descriptor => Some("descriptor"),
            Kind::Heartbeat => Some("heartbeat"),
            Kind::Answer => Some("answer"),
            Kind::Pose | Kind::Refusal => None,
        }
    }
}

/// The first eight bytes of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// The kind of message.
    pub magic: [u8; 4],
    /// Major version.
    pub major: u8,
    /// Minor version.
    pub minor: u8,
    /// Bytes of the whole message, header and CRC included.
    pub size: u16,
}

impl Header {
    /// The header at the beginning of `bytes`, valid or not; `None` if there are too few bytes.
    pub fn read(bytes: &[u8]) -> Option<Self> {
        let &[a, b, c, d, major, minor, low, high] = bytes.first_chunk()?;
        Some(Self { magic: [a, b, c, d], major, minor, size: u16::from_le_bytes([low, high]) })
    }

    /// Whether these can be the first bytes of a message.
    pub fn plausible(self) -> bool {
        let size = usize::from(self.size);
        let pose = self.magic == Kind::Pose.magic() && self.major == MAJOR;
        self.magic.starts_with(b"TF") && size >= HEADER_SIZE + CRC_SIZE && (!pose || size == FRAME_SIZE)
    }
}

/// The header of a message of this version with a total of `size` bytes.
pub fn header(kind: Kind, size: u16) -> [u8; HEADER_SIZE] {
    let [a, b, c, d] = kind.magic();
    let [low, high] = size.to_le_bytes();
    [a, b, c, d, MAJOR, MINOR, low, high]
}

/// The computed and the received CRC of a complete message; `None` if it is too short.
pub fn crcs(message: &[u8]) -> Option<(u32, u32)> {
    let (body, received) = message.split_last_chunk::<CRC_SIZE>()?;
    Some((crc32fast::hash(body), u32::from_le_bytes(*received)))
}
