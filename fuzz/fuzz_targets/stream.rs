//! Bytes of a stream: the frame decoder and the message decoder return, accepted frames are encoded to the
//! same bytes, and no byte of the stream is unaccounted for.

#![no_main]

use libfuzzer_sys::fuzz_target;
use trifacet_wire::PoseFrame;
use trifacet_wire::byte_order::big_endian;
use trifacet_wire::layout::FRAME_SIZE;
use trifacet_wire::stream::Decoder;

fuzz_target!(|bytes: &[u8]| {
    frame(bytes);
    if let Some(sealed) = sealed(bytes) {
        frame(&sealed);
        stream(&[bytes, &sealed, bytes].concat());
    }
    stream(bytes);
});

/// The bytes as a frame with correct magic, version, size and CRC, so that the fuzzer need not guess these.
fn sealed(bytes: &[u8]) -> Option<[u8; FRAME_SIZE]> {
    let mut frame: [u8; FRAME_SIZE] = *bytes.first_chunk()?;
    frame[..8].copy_from_slice(b"TFP1\x01\x00\xc0\x00");
    let crc = crc32fast::hash(&frame[..FRAME_SIZE - 4]);
    frame[FRAME_SIZE - 4..].copy_from_slice(&crc.to_le_bytes());
    Some(frame)
}

fn frame(bytes: &[u8]) {
    if let (Ok(frame), Ok(little)) = (PoseFrame::decode_either(bytes), PoseFrame::decode(bytes)) {
        assert_eq!(frame.encode(), little.encode());
        let turned = PoseFrame::decode_either(&big_endian(&frame.encode()));
        assert_eq!(turned.map(|frame| frame.encode()), Ok(little.encode()));
    }
    if let Ok(frame) = PoseFrame::decode(bytes) {
        let again = frame.encode();
        let minor = 5;
        assert_eq!(again[..minor], bytes[..minor]);
        assert_eq!(again[minor + 1..FRAME_SIZE - 4], bytes[minor + 1..FRAME_SIZE - 4]);
    }
}

fn stream(bytes: &[u8]) {
    let mut decoder = Decoder::default();
    let (start, rest) = bytes.split_at(bytes.len() / 2);
    for part in [start, rest] {
        decoder.push(part);
        while decoder.next_message().is_some() {}
    }
    assert!(decoder.skipped() <= bytes.len() as u64);
}
