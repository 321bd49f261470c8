//! Bytes of a LabJack T7: packets of its stream and answers of its registers, in any pieces; the session of the host
//! continues, and its scans have growing indices and times.

#![no_main]

use std::sync::Arc;

use libfuzzer_sys::fuzz_target;
use trifacet::acquisition::SourceEvent;
use trifacet::acquisition::labjack::modbus::Frames;
use trifacet::acquisition::labjack::scans::Assembler;
use trifacet::acquisition::labjack::stream::{MOST_SAMPLES, Packets};
use trifacet::acquisition::labjack::{Session, Settings};
use trifacet::config::Config;
use trifacet::core::time::Mono;

fuzz_target!(|bytes: &[u8]| {
    let mut packets = Packets::default();
    let (mut assembler, mut scans) = (Assembler::new(11, 1), Vec::new());
    for piece in bytes.chunks(37) {
        packets.push(piece);
        while let Ok(Some(packet)) = packets.next_packet() {
            assert!(packet.samples.len() <= MOST_SAMPLES);
            let mut again = Vec::new();
            packet.encode(&mut again);
            let _ = assembler.take(&packet, &mut scans);
        }
    }
    let mut frames = Frames::default();
    frames.push(bytes);
    while let Ok(Some(frame)) = frames.next_frame() {
        let _ = (frame.answer(3), frame.answer(16));
    }
    converse(bytes);
});

/// The session takes each piece from one of its connections.
fn converse(bytes: &[u8]) {
    let mut session = Session::new(Settings::from(&Config::default()), Arc::default());
    let (mut now, mut last) = (Mono(1_000_000_000), None);
    session.connected([127, 0, 0, 1].into(), now);
    for piece in bytes.chunks(23) {
        now = now + i64::from(piece[0]) * 1_000_000;
        let waiting = session.output(now).len();
        session.written(waiting);
        if piece[0] % 2 == 0 {
            session.answered(&piece[1..], now);
        } else {
            session.streamed(&piece[1..], now);
        }
        session.timed_out(now);
        while let Some(event) = session.event() {
            if let SourceEvent::Scan(scan) = event {
                assert!(last.is_none_or(|(index, time)| scan.index > index && scan.time > time));
                last = Some((scan.index, scan.time));
            }
        }
        if session.is_broken() {
            session.connected([127, 0, 0, 1].into(), now);
        }
    }
}
