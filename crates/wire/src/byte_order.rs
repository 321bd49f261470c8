//! The pose frame in network byte order, for clients that request it: every field byte-swapped, the magic
//! bytes unchanged, the CRC over the bytes as sent.

use crate::frame::{FrameBytes, FrameError, PoseFrame};
use crate::layout::{FIELDS, FRAME_SIZE};
use crate::message::CRC_SIZE;

/// Offset of the size field, and its bytes in network order.
const SIZE_AT: usize = 6;
const SIZE: [u8; 2] = (FRAME_SIZE as u16).to_be_bytes();
const CRC_AT: usize = FRAME_SIZE - CRC_SIZE;

/// Encodes a frame in network order.
pub fn big_endian(little: &FrameBytes) -> FrameBytes {
    let mut bytes = turned(little);
    let crc = crc32fast::hash(&bytes[..CRC_AT]);
    bytes[CRC_AT..].copy_from_slice(&crc.to_be_bytes());
    bytes
}

impl PoseFrame {
    /// Decodes a frame in either byte order, detected by the size field.
    ///
    /// # Errors
    /// As [`PoseFrame::decode`].
    pub fn decode_either(bytes: &[u8]) -> Result<Self, FrameError> {
        let Ok(big) = FrameBytes::try_from(bytes) else { return Self::decode(bytes) };
        if big[SIZE_AT..SIZE_AT + 2] != SIZE {
            return Self::decode(&big);
        }
        let mut little = turned(&big);
        let expected = crc32fast::hash(&big[..CRC_AT]);
        let received = u32::from_le_bytes(core::array::from_fn(|i| little[CRC_AT + i]));
        if expected != received {
            return Err(FrameError::Crc { expected, received });
        }
        let crc = crc32fast::hash(&little[..CRC_AT]);
        little[CRC_AT..].copy_from_slice(&crc.to_le_bytes());
        Self::decode(&little)
    }
}

/// Swaps the byte order of every field.
fn turned(bytes: &FrameBytes) -> FrameBytes {
    let mut bytes = *bytes;
    for field in &FIELDS {
        let (start, width) = (usize::from(field.offset), field.width());
        let end = start + width * usize::from(field.count);
        bytes[start..end].chunks_exact_mut(width).for_each(<[u8]>::reverse);
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn network_order_survives_a_round_trip_and_damage_is_detected() {
        let frame = PoseFrame::example();
        let little = frame.encode();
        let big = big_endian(&little);
        assert_eq!(&big[..8], b"TFP1\x01\x01\x00\xc0");
        assert_eq!(f64::from_be_bytes(big[56..64].try_into().unwrap()), 1e-6);
        assert_eq!(u64::from_be_bytes(big[16..24].try_into().unwrap()), 9);
        assert_eq!(PoseFrame::decode_either(&big), Ok(frame));
        assert_eq!(PoseFrame::decode_either(&little), Ok(frame));
        assert_eq!(PoseFrame::decode(&big), Err(FrameError::Size(0xc000)));
        for at in 0..FRAME_SIZE {
            let mut damaged = big;
            damaged[at] ^= 0x10;
            assert!(PoseFrame::decode_either(&damaged).is_err(), "byte {at}");
        }
        assert_eq!(PoseFrame::decode_either(&big[1..]), PoseFrame::decode(&big[1..]));
    }
}
