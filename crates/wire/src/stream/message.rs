//! Messages on TCP: the pose frame, and five kinds in JSON.
//!
//! [`Decoder`] finds them in a byte stream, and resynchronises after damage.

use super::descriptor::{Answer, Descriptor, Heartbeat, LockEvent, Refusal};
use crate::frame::{FrameError, PoseFrame};
use crate::message::{CRC_SIZE, HEADER_SIZE, Header, Kind, MAJOR, crcs, header};

/// Free space that a [`Decoder`] reserves, bytes.
const ROOM: usize = 16 * 1024;

/// A message, as received by a client.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// A pose frame.
    Pose(PoseFrame),
    /// Description of the daemon and of the stream.
    Descriptor(Box<Descriptor>),
    /// Counters of frames and losses.
    Heartbeat(Heartbeat),
    /// A change of the lock state, for a client that requests events.
    Event(LockEvent),
    /// The answer to a query.
    Answer(Answer),
    /// The reason why the daemon closes the connection.
    Refusal(Refusal),
}

/// Reasons why an undamaged message cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum MessageError {
    /// The sender uses another major version.
    #[error("the sender uses version {major}.{minor} of the stream; this program reads {MAJOR}.x")]
    Version {
        /// Major version: layout.
        major: u8,
        /// Minor version: compatible additions.
        minor: u8,
    },
    /// An invalid pose frame.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// JSON with unexpected contents.
    #[error("a message of kind {kind} has unexpected contents: {source}")]
    Json {
        /// Magic of the message.
        kind: String,
        /// The error of the JSON parser.
        source: serde_json::Error,
    },
}

/// A message of this kind with `body` as JSON.
///
/// # Errors
/// The body cannot be serialised, or is longer than 65 523 bytes.
pub fn json<T: serde::Serialize>(kind: Kind, body: &T) -> Result<Vec<u8>, serde_json::Error> {
    use serde::ser::Error;
    let body = serde_json::to_vec(body)?;
    let size = u16::try_from(body.len() + HEADER_SIZE + CRC_SIZE)
        .map_err(|_| serde_json::Error::custom(format!("{} bytes do not fit into a message", body.len())))?;
    let mut message = Vec::with_capacity(size.into());
    message.extend(header(kind, size));
    message.extend(body);
    message.extend(crc32fast::hash(&message).to_le_bytes());
    Ok(message)
}

/// Finds messages in a byte stream. Pure: bytes in, messages out.
#[derive(Debug, Default)]
pub struct Decoder {
    buffer: Vec<u8>,
    /// Start of the unread part.
    start: usize,
    skipped: u64,
}

impl Decoder {
    /// Takes the next bytes of the stream.
    pub fn push(&mut self, bytes: &[u8]) {
        self.room().extend_from_slice(bytes);
    }

    /// The buffer to which the next bytes of the stream are appended, with free space reserved.
    pub fn room(&mut self) -> &mut Vec<u8> {
        self.buffer.drain(..self.start);
        self.start = 0;
        self.buffer.reserve(ROOM);
        &mut self.buffer
    }

    /// Number of bytes skipped so far because they belong to no undamaged message.
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    /// The next message, or `None` if more bytes are needed. Damaged bytes and unknown kinds of message are
    /// skipped.
    ///
    /// # Errors
    /// An undamaged message has another major version or invalid contents.
    pub fn next_message(&mut self) -> Option<Result<Message, MessageError>> {
        loop {
            let rest = self.buffer.get(self.start..)?;
            let header = Header::read(rest)?;
            let size = usize::from(header.size);
            if !header.plausible() {
                self.skip();
                continue;
            }
            let message = rest.get(..size)?;
            if crcs(message).is_none_or(|(expected, received)| expected != received) {
                self.skip();
                continue;
            }
            let read = read(header, message);
            self.start += size;
            if let Some(read) = read {
                return Some(read);
            }
        }
    }

    /// Moves to the next byte at which a message may begin.
    fn skip(&mut self) {
        let rest = self.buffer.get(self.start + 1..).unwrap_or_default();
        let step = 1 + rest.iter().position(|b| *b == b'T').unwrap_or(rest.len());
        self.start += step;
        self.skipped += step as u64;
    }
}

/// Reads an undamaged message; `None` if its kind is unknown.
fn read(header: Header, message: &[u8]) -> Option<Result<Message, MessageError>> {
    if header.major != MAJOR {
        return Some(Err(MessageError::Version { major: header.major, minor: header.minor }));
    }
    let kind = Kind::ALL.into_iter().find(|k| k.magic() == header.magic)?;
    let body = &message[HEADER_SIZE..message.len() - CRC_SIZE];
    let json_error = |source| MessageError::Json { kind: header.magic.escape_ascii().to_string(), source };
    Some(match kind {
        Kind::Pose => PoseFrame::decode(message).map(Message::Pose).map_err(MessageError::from),
        Kind::Descriptor => serde_json::from_slice(body).map(Message::Descriptor).map_err(json_error),
        Kind::Heartbeat => serde_json::from_slice(body).map(Message::Heartbeat).map_err(json_error),
        Kind::Event => serde_json::from_slice(body).map(Message::Event).map_err(json_error),
        Kind::Answer => serde_json::from_slice(body).map(Message::Answer).map_err(json_error),
        Kind::Refusal => serde_json::from_slice(body).map(Message::Refusal).map_err(json_error),
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn pose(sequence: u64) -> PoseFrame {
        PoseFrame { sequence, ..PoseFrame::example() }
    }

    fn sequences(decoder: &mut Decoder) -> Vec<u64> {
        let mut found = Vec::new();
        while let Some(message) = decoder.next_message() {
            match message.unwrap() {
                Message::Pose(frame) => found.push(frame.sequence),
                other => panic!("{other:?}"),
            }
        }
        found
    }

    #[test]
    fn messages_of_unknown_kind_are_skipped() {
        let mut unknown = json(Kind::Heartbeat, &"something new").unwrap();
        unknown[..4].copy_from_slice(b"TFX1");
        let at = unknown.len() - CRC_SIZE;
        let crc = crc32fast::hash(&unknown[..at]);
        unknown[at..].copy_from_slice(&crc.to_le_bytes());
        let mut decoder = Decoder::default();
        decoder.push(&unknown);
        decoder.push(&pose(4).encode());
        assert_eq!(sequences(&mut decoder), [4]);
        assert_eq!(decoder.skipped(), 0);
    }

    #[test]
    fn another_major_version_is_an_error_not_damage() {
        let mut bytes = json(Kind::Descriptor, &"another time").unwrap();
        bytes[4] = 9;
        let at = bytes.len() - CRC_SIZE;
        let crc = crc32fast::hash(&bytes[..at]);
        bytes[at..].copy_from_slice(&crc.to_le_bytes());
        let mut decoder = Decoder::default();
        decoder.push(&bytes);
        assert!(matches!(
            decoder.next_message(),
            Some(Err(MessageError::Version { major: 9, minor: crate::message::MINOR }))
        ));
    }

    #[test]
    fn too_much_json_is_refused() {
        assert!(json(Kind::Descriptor, &"x".repeat(65_521)).is_ok());
        assert!(json(Kind::Descriptor, &"x".repeat(65_522)).is_err());
    }

    proptest! {
        /// However the stream is split, and whatever bytes are between two frames, both frames are found and
        /// every byte in between is counted.
        #[test]
        fn resynchronises(junk in prop::collection::vec(prop_oneof![Just(b'T'), Just(b'F'), any::<u8>()], 0..300),
                          damaged in 0usize..192, piece in 1usize..400) {
            let mut stream = pose(1).encode().to_vec();
            stream.extend(&junk);
            let mut broken = pose(2).encode();
            broken[damaged] ^= 0x55;
            stream.extend(broken);
            // Enough complete frames for any size that a damaged header may give.
            stream.extend((3..400).flat_map(|n| pose(n).encode()));
            let mut decoder = Decoder::default();
            let mut found = Vec::new();
            for bytes in stream.chunks(piece) {
                decoder.push(bytes);
                found.extend(sequences(&mut decoder));
            }
            let expected: Vec<u64> = std::iter::once(1).chain(3..400).collect();
            prop_assert_eq!(found, expected);
            prop_assert_eq!(decoder.skipped(), junk.len() as u64 + 192);
        }

        #[test]
        fn no_bytes_make_the_decoder_panic(bytes in prop::collection::vec(any::<u8>(), 0..2000)) {
            let mut decoder = Decoder::default();
            decoder.push(&bytes);
            while let Some(_found) = decoder.next_message() {}
            prop_assert!(decoder.skipped() <= bytes.len() as u64);
        }
    }
}
