//! Framing: COBS, one zero byte after each frame, CRC-32 at the end of each message.
//!
//! A zero byte occurs nowhere else, so that a receiver is synchronised again after the next one.

use alloc::vec::Vec;

/// Largest length of a message in bytes, checksum included; COBS then adds exactly one byte.
pub const MAX_MESSAGE: usize = 250;

/// Bytes that framing adds to the body of a message: type, version, checksum, COBS, delimiter.
pub const OVERHEAD: usize = 2 + CRC + 2;

/// Bytes of the checksum.
const CRC: usize = 4;

/// A damaged frame: invalid COBS, too long, or a wrong checksum.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("corrupted frame")]
pub struct Corrupted;

/// Appends a message (type, version, body) to `out`, with checksum, stuffing and delimiter.
pub fn encode(message: &[u8], out: &mut Vec<u8>) {
    debug_assert!(message.len() + CRC <= MAX_MESSAGE);
    let mut whole = Vec::with_capacity(message.len() + CRC);
    whole.extend_from_slice(message);
    whole.extend_from_slice(&crc32fast::hash(message).to_le_bytes());
    out.extend(cobs::encode_vec(&whole));
    out.push(0);
}

/// Splits a byte stream into messages. Needs memory for one frame.
#[derive(Clone, Debug)]
pub struct Deframer {
    buffer: [u8; MAX_MESSAGE + 1],
    /// Number of bytes of the current frame; greater than the buffer if the frame is too long.
    length: usize,
}

impl Default for Deframer {
    fn default() -> Self {
        Self { buffer: [0; MAX_MESSAGE + 1], length: 0 }
    }
}

impl Deframer {
    /// Takes bytes from the front of `bytes` up to the end of the next frame and returns its message
    /// (type, version, body), or `None` once all bytes are taken. Empty frames are skipped.
    ///
    /// # Errors
    /// The frame is damaged.
    pub fn next(&mut self, bytes: &mut &[u8]) -> Option<Result<&[u8], Corrupted>> {
        while let Some((&byte, rest)) = bytes.split_first() {
            *bytes = rest;
            if byte != 0 {
                self.push(byte);
            } else if self.length > 0 {
                let length = core::mem::take(&mut self.length);
                return Some(self.buffer.get_mut(..length).and_then(unpack).ok_or(Corrupted));
            }
        }
        None
    }

    fn push(&mut self, byte: u8) {
        if let Some(place) = self.buffer.get_mut(self.length) {
            *place = byte;
        }
        self.length = (self.length + 1).min(self.buffer.len() + 1);
    }
}

/// Unstuffs a frame in place and checks its checksum.
fn unpack(frame: &mut [u8]) -> Option<&[u8]> {
    let length = cobs::decode_in_place(frame).ok()?;
    let (message, crc) = frame[..length].split_last_chunk::<CRC>()?;
    (message.len() >= 2 && crc32fast::hash(message) == u32::from_le_bytes(*crc)).then_some(message)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// All messages of `stream` when it arrives in pieces of `piece` bytes.
    fn deframe(stream: &[u8], piece: usize) -> Vec<Result<Vec<u8>, Corrupted>> {
        let mut deframer = Deframer::default();
        let mut found = Vec::new();
        for mut bytes in stream.chunks(piece) {
            while let Some(message) = deframer.next(&mut bytes) {
                found.push(message.map(<[u8]>::to_vec));
            }
        }
        found
    }

    fn stream(messages: &[Vec<u8>]) -> Vec<u8> {
        let mut stream = Vec::new();
        for message in messages {
            encode(message, &mut stream);
        }
        stream
    }

    fn message() -> impl Strategy<Value = Vec<u8>> {
        prop::collection::vec(any::<u8>(), 2..=MAX_MESSAGE - CRC)
    }

    proptest! {
        #[test]
        fn every_message_survives_in_pieces_of_any_size(
            messages in prop::collection::vec(message(), 1..5), piece in 1_usize..300,
        ) {
            let found = deframe(&stream(&messages), piece);
            prop_assert_eq!(found, messages.into_iter().map(Ok).collect::<Vec<_>>());
        }

        #[test]
        fn a_damaged_frame_is_reported_and_the_next_one_is_whole(
            first in message(), second in message(), place in any::<prop::sample::Index>(), flip in 1_u8..,
        ) {
            let mut bytes = stream(std::slice::from_ref(&first));
            let place = place.index(bytes.len() - 1);
            bytes[place] ^= flip;
            bytes.extend(stream(std::slice::from_ref(&second)));
            let found = deframe(&bytes, 64);
            prop_assert!(found.len() >= 2);
            let (last, damaged) = found.split_last().expect("two or more");
            prop_assert_eq!(last, &Ok(second));
            prop_assert!(damaged.iter().all(|found| *found == Err(Corrupted)));
        }

        #[test]
        fn noise_never_panics_and_the_frame_after_it_is_found(
            noise in prop::collection::vec(any::<u8>(), 0..2000), message in message(),
        ) {
            let mut bytes = noise;
            bytes.push(0);
            bytes.extend(stream(std::slice::from_ref(&message)));
            prop_assert_eq!(deframe(&bytes, 77).pop(), Some(Ok(message)));
        }
    }

    #[test]
    fn a_frame_without_end_is_one_corrupted_frame() {
        let mut bytes = vec![1; 100_000];
        bytes.push(0);
        assert_eq!(deframe(&bytes, 4096), [Err(Corrupted)]);
    }

    #[test]
    fn the_overhead_of_framing_agrees_with_the_budget() {
        for body in 0..=MAX_MESSAGE - CRC - 2 {
            let mut out = Vec::new();
            encode(&vec![7; 2 + body], &mut out);
            assert_eq!(out.len(), body + OVERHEAD);
        }
    }
}
