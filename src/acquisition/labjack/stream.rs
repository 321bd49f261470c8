//! Packets of the stream: from bytes to samples. Pure.
//!
//! Source: "3.2.4 Low-Level Stream" of the T-Series Datasheet.

/// Bytes of a packet before its samples.
const HEADER: usize = 16;
/// Function of a packet.
const FUNCTION: u8 = 76;
/// Type of a packet.
const TYPE: u8 = 16;
/// The length counts ten bytes in addition to the samples.
const COUNTED: usize = 10;
/// Largest number of samples in a packet.
pub const MOST_SAMPLES: usize = 512;

/// The status of a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StreamStatus {
    /// The stream runs.
    Running,
    /// The buffer was full: the device sends what it holds, and skips new scans.
    Recovering,
    /// The recovery has ended. A scan whose samples are all 65535 separates old data from new.
    Recovered {
        /// Number of scans that were skipped.
        skipped: u16,
    },
    /// A scan was due before the one before was complete. The stream has ended.
    Overlap,
    /// More scans were skipped than the device can count. The stream has ended.
    Overflow,
    /// The configured number of scans is complete.
    Complete,
    /// The buffer was full, and recovery is disabled. The stream has ended.
    Full,
    /// Another status.
    Unknown(u16),
}

impl StreamStatus {
    fn of(code: u16, information: u16) -> Self {
        match code {
            0 => Self::Running,
            2940 => Self::Recovering,
            2941 => Self::Recovered { skipped: information },
            2942 => Self::Overlap,
            2943 => Self::Overflow,
            2944 => Self::Complete,
            2945 => Self::Full,
            code => Self::Unknown(code),
        }
    }

    /// The code, and the additional information.
    pub fn code(self) -> (u16, u16) {
        match self {
            Self::Running => (0, 0),
            Self::Recovering => (2940, 0),
            Self::Recovered { skipped } => (2941, skipped),
            Self::Overlap => (2942, 0),
            Self::Overflow => (2943, 0),
            Self::Complete => (2944, 0),
            Self::Full => (2945, 0),
            Self::Unknown(code) => (code, 0),
        }
    }
}

/// A packet of the stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Packet {
    /// Counts the packets; wraps.
    pub transaction: u16,
    /// Bytes that the device still holds.
    pub backlog: u16,
    /// Status of the stream.
    pub status: StreamStatus,
    /// The samples.
    pub samples: Vec<u16>,
}

impl Packet {
    /// Appends the packet as bytes.
    pub fn encode(&self, out: &mut Vec<u8>) {
        let (status, information) = self.status.code();
        let length = (COUNTED + 2 * self.samples.len()) as u16;
        for number in [self.transaction, 0, length] {
            out.extend(number.to_be_bytes());
        }
        out.extend([1, FUNCTION, TYPE, 0]);
        for number in [self.backlog, status, information].iter().chain(&self.samples) {
            out.extend(number.to_be_bytes());
        }
    }
}

/// Bytes that are no packets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PacketError {
    /// The fixed bytes of the header differ.
    #[error(
        "a packet begins with protocol {protocol}, function {function}, type {kind} instead of 0, 76, 16"
    )]
    Header {
        /// Its protocol.
        protocol: u16,
        /// Its function.
        function: u8,
        /// Its type.
        kind: u8,
    },
    /// The length does not stand for 0 to 512 samples.
    #[error("a packet states a length of {length} bytes; possible are even ones from 10 to 1034")]
    Length {
        /// The length, bytes.
        length: u16,
    },
}

/// Cuts a stream of bytes into packets.
#[derive(Clone, Debug, Default)]
pub struct Packets {
    bytes: Vec<u8>,
}

impl Packets {
    /// Takes bytes that have arrived.
    pub fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend(bytes);
    }

    /// The next complete packet.
    ///
    /// # Errors
    /// The bytes are no packet. Where the next packet begins is then unknown.
    pub fn next_packet(&mut self) -> Result<Option<Packet>, PacketError> {
        let Some(header) = self.bytes.first_chunk::<HEADER>() else { return Ok(None) };
        let number = |at: usize| u16::from_be_bytes([header[at], header[at + 1]]);
        let (protocol, length, function, kind) = (number(2), number(4), header[7], header[8]);
        if (protocol, function, kind) != (0, FUNCTION, TYPE) {
            return Err(PacketError::Header { protocol, function, kind });
        }
        let data = usize::from(length).wrapping_sub(COUNTED);
        if data % 2 != 0 || data > 2 * MOST_SAMPLES {
            return Err(PacketError::Length { length });
        }
        let Some(samples) = self.bytes.get(HEADER..HEADER + data) else { return Ok(None) };
        let packet = Packet {
            transaction: number(0),
            backlog: number(10),
            status: StreamStatus::of(number(12), number(14)),
            samples: samples.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect(),
        };
        self.bytes.drain(..HEADER + data);
        Ok(Some(packet))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_packet_has_the_bytes_of_the_data_sheet() {
        let bytes = [0x12, 0x34, 0, 0, 0, 14, 1, 76, 16, 0, 0, 26, 0x0b, 0x7d, 0, 5, 0xab, 0xcd, 0x00, 0x07];
        let mut packets = Packets::default();
        packets.push(&bytes);
        let status = StreamStatus::Recovered { skipped: 5 };
        let packet = Packet { transaction: 0x1234, backlog: 26, status, samples: vec![0xabcd, 7] };
        assert_eq!(packets.next_packet(), Ok(Some(packet.clone())));
        assert_eq!(packets.next_packet(), Ok(None));
        let mut encoded = Vec::new();
        packet.encode(&mut encoded);
        assert_eq!(encoded, bytes);
    }

    #[test]
    fn other_bytes_are_refused() {
        let header = |at: usize, byte: u8| {
            let mut bytes = [0, 0, 0, 0, 0, 12, 1, 76, 16, 0, 0, 0, 0, 0, 0, 0, 1, 1];
            bytes[at] = byte;
            let mut packets = Packets::default();
            packets.push(&bytes);
            packets.next_packet()
        };
        assert!(matches!(header(0, 0), Ok(Some(_))));
        assert!(matches!(header(3, 1), Err(PacketError::Header { .. })));
        assert!(matches!(header(7, 16), Err(PacketError::Header { .. })));
        assert!(matches!(header(8, 17), Err(PacketError::Header { .. })));
        for length in [[0, 9], [0, 11], [0xff, 0xf0], [4, 12]] {
            let mut packets = Packets::default();
            packets.push(&[0, 0, 0, 0, length[0], length[1], 1, 76, 16, 0, 0, 0, 0, 0, 0, 0]);
            assert!(matches!(packets.next_packet(), Err(PacketError::Length { .. })), "{length:?}");
        }
    }

    proptest! {
        #[test]
        fn packets_survive_any_division_into_pieces(
            sent in prop::collection::vec((any::<u16>(), any::<u16>(), 2939_u16..2947, prop::collection::vec(any::<u16>(), 0..30)), 1..10),
            pieces in prop::collection::vec(1_usize..100, 1..50),
        ) {
            let sent: Vec<_> = sent
                .into_iter()
                .map(|(transaction, backlog, status, samples)| {
                    Packet { transaction, backlog, status: StreamStatus::of(status, 0), samples }
                })
                .collect();
            let mut bytes = Vec::new();
            for packet in &sent {
                packet.encode(&mut bytes);
            }
            let (mut packets, mut found, mut rest) = (Packets::default(), Vec::new(), &bytes[..]);
            for piece in pieces.iter().cycle() {
                let (now, later) = rest.split_at((*piece).min(rest.len()));
                packets.push(now);
                while let Some(packet) = packets.next_packet().unwrap() {
                    found.push(packet);
                }
                rest = later;
                if rest.is_empty() {
                    break;
                }
            }
            prop_assert_eq!(found, sent);
        }
    }
}
