//! From packets to scans: every scan is delivered, or counted as lost. Pure.

use trifacet_wire::channel::MAX_CHANNELS;

use super::stream::{Packet, StreamStatus};

/// Entries of the scan list before the inputs: the two halves of the timer.
pub const TIMER_ENTRIES: usize = 2;
/// The samples of the scan that separates old data from new after a recovery.
const SEPARATOR: u16 = u16::MAX;

/// A scan of the stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StreamScan {
    /// The timer of the device at the start of the scan.
    pub tick: u32,
    /// The samples of the inputs.
    pub samples: [u16; MAX_CHANNELS],
    /// Scans lost since the previous one, as the device counts them.
    pub lost: u32,
    /// The device has skipped scans since the previous one. It may count the separating scan too.
    pub skipped: bool,
}

/// What a packet has shown besides its scans.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Arrived {
    /// The packet has arrived before.
    pub repeated: bool,
    /// The device has begun to skip scans, because its buffer was full.
    pub overrun: bool,
}

/// Why the stream has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StreamEnd {
    /// Status 2942.
    #[error(
        "a scan was due before the one before was complete (scan overlap, 2942): lower acquisition.rate_hz, \
         settling_us or resolution_index"
    )]
    Overlap,
    /// Status 2943.
    #[error("it has skipped more scans than it can count (2943)")]
    Overflow,
    /// Status 2944.
    #[error("it has ended the stream as complete (2944), although a stream without end was requested")]
    Complete,
    /// Status 2945.
    #[error("its buffer was full, and it does not recover (2945)")]
    Full,
    /// Another status.
    #[error("it reports the unknown status {0}")]
    Unknown(u16),
    /// A packet that does not consist of whole scans.
    #[error("a packet has {samples} samples; a scan has {entries}")]
    Parts {
        /// Samples of the packet.
        samples: usize,
        /// Entries of the scan list.
        entries: usize,
    },
}

/// Makes scans of packets.
#[derive(Clone, Debug)]
pub struct Assembler {
    channels: usize,
    scans_per_packet: u32,
    /// Transaction number of the next packet.
    next: Option<u16>,
    /// Lost scans that have not been reported.
    lost: u32,
    skipped: bool,
    recovering: bool,
}

impl Assembler {
    /// For a stream of this number of inputs.
    pub fn new(channels: usize, scans_per_packet: u32) -> Self {
        Self { channels, scans_per_packet, next: None, lost: 0, skipped: false, recovering: false }
    }

    /// Takes a packet, and appends its scans.
    ///
    /// # Errors
    /// The stream has ended, or the packet is not one of this stream. Scans that it contains are appended all the
    /// same.
    pub fn take(&mut self, packet: &Packet, scans: &mut Vec<StreamScan>) -> Result<Arrived, StreamEnd> {
        let entries = TIMER_ENTRIES + self.channels;
        if !packet.samples.len().is_multiple_of(entries) {
            return Err(StreamEnd::Parts { samples: packet.samples.len(), entries });
        }
        let jump = self.next.map_or(0, |next| packet.transaction.wrapping_sub(next));
        if jump > u16::MAX / 2 {
            return Ok(Arrived { repeated: true, overrun: false });
        }
        self.next = Some(packet.transaction.wrapping_add(1));
        self.lost = self.lost.saturating_add(u32::from(jump) * self.scans_per_packet);
        let recovering = packet.status == StreamStatus::Recovering;
        let overrun = recovering && !std::mem::replace(&mut self.recovering, recovering);
        self.recovering = recovering;
        let separated = self.append(packet, entries, scans);
        if let (StreamStatus::Recovered { skipped }, false) = (packet.status, separated) {
            self.skip(skipped); // before the scans of the next packet
        }
        match packet.status {
            StreamStatus::Running | StreamStatus::Recovering | StreamStatus::Recovered { .. } => {
                Ok(Arrived { repeated: false, overrun })
            }
            StreamStatus::Overlap => Err(StreamEnd::Overlap),
            StreamStatus::Overflow => Err(StreamEnd::Overflow),
            StreamStatus::Complete => Err(StreamEnd::Complete),
            StreamStatus::Full => Err(StreamEnd::Full),
            StreamStatus::Unknown(code) => Err(StreamEnd::Unknown(code)),
        }
    }

    /// Appends the scans of a packet; returns whether one of them separates old data from new.
    fn append(&mut self, packet: &Packet, entries: usize, scans: &mut Vec<StreamScan>) -> bool {
        let mut separated = false;
        for scan in packet.samples.chunks_exact(entries) {
            if let StreamStatus::Recovered { skipped } = packet.status
                && scan.iter().all(|sample| *sample == SEPARATOR)
            {
                self.skip(skipped);
                separated = true;
                continue;
            }
            let mut samples = [0; MAX_CHANNELS];
            for (sample, measured) in samples.iter_mut().zip(&scan[TIMER_ENTRIES..]) {
                *sample = *measured;
            }
            scans.push(StreamScan {
                tick: u32::from(scan[1]) << 16 | u32::from(scan[0]),
                samples,
                lost: std::mem::take(&mut self.lost),
                skipped: std::mem::take(&mut self.skipped),
            });
        }
        separated
    }

    fn skip(&mut self, skipped: u16) {
        self.lost = self.lost.saturating_add(skipped.into());
        self.skipped = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn packet(transaction: u16, status: StreamStatus, scans: &[u16]) -> Packet {
        let samples = scans.iter().flat_map(|n| [*n, 0x12, 100 + n, 200 + n]).collect();
        Packet { transaction, backlog: 0, status, samples }
    }

    /// The first samples of the scans with the scans lost before each.
    fn taken(assembler: &mut Assembler, packet: &Packet) -> (Vec<(u16, u32)>, Result<Arrived, StreamEnd>) {
        let mut scans = Vec::new();
        let arrived = assembler.take(packet, &mut scans);
        (scans.iter().map(|scan| (scan.samples[0] - 100, scan.lost)).collect(), arrived)
    }

    #[test]
    fn a_scan_has_the_timer_of_its_two_entries() {
        let mut scans = Vec::new();
        Assembler::new(2, 1).take(&packet(9, StreamStatus::Running, &[7]), &mut scans).unwrap();
        let [scan] = scans[..] else { panic!("{scans:?}") };
        assert_eq!((scan.tick, &scan.samples[..3], scan.lost), (0x0012_0007, &[107, 207, 0][..], 0));
    }

    #[test]
    fn jumps_of_the_transaction_number_are_lost_packets() {
        let (mut assembler, running) = (Assembler::new(2, 2), StreamStatus::Running);
        assert_eq!(taken(&mut assembler, &packet(u16::MAX, running, &[1, 2])).0, [(1, 0), (2, 0)]);
        assert_eq!(taken(&mut assembler, &packet(3, running, &[9, 10])).0, [(9, 6), (10, 0)]);
        let (scans, arrived) = taken(&mut assembler, &packet(2, running, &[7, 8]));
        assert!(scans.is_empty() && arrived.unwrap().repeated);
        assert_eq!(taken(&mut assembler, &packet(4, running, &[11, 12])).0, [(11, 0), (12, 0)]);
    }

    #[test]
    fn skipped_scans_are_counted_at_the_separating_scan() {
        let mut assembler = Assembler::new(2, 1);
        let (scans, arrived) = taken(&mut assembler, &packet(0, StreamStatus::Recovering, &[1]));
        assert!(scans == [(1, 0)] && arrived.unwrap().overrun);
        assert!(!taken(&mut assembler, &packet(1, StreamStatus::Recovering, &[2])).1.unwrap().overrun);
        let mut ended = packet(2, StreamStatus::Recovered { skipped: 50 }, &[3]);
        ended.samples.extend([u16::MAX; 4]);
        ended.samples.extend([54, 0x12, 154, 254]);
        assert_eq!(taken(&mut assembler, &ended).0, [(3, 0), (54, 50)]);
        // Without a separating scan, the skipped scans precede the next packet.
        assert_eq!(
            taken(&mut assembler, &packet(3, StreamStatus::Recovered { skipped: 4 }, &[5])).0,
            [(5, 0)]
        );
        assert_eq!(taken(&mut assembler, &packet(4, StreamStatus::Running, &[6])).0, [(6, 4)]);
    }

    #[test]
    fn every_other_status_ends_the_stream_with_its_reason() {
        for (status, end) in [
            (StreamStatus::Overlap, StreamEnd::Overlap),
            (StreamStatus::Overflow, StreamEnd::Overflow),
            (StreamStatus::Complete, StreamEnd::Complete),
            (StreamStatus::Full, StreamEnd::Full),
            (StreamStatus::Unknown(2999), StreamEnd::Unknown(2999)),
        ] {
            assert_eq!(taken(&mut Assembler::new(2, 1), &packet(0, status, &[1])), (vec![(1, 0)], Err(end)));
        }
        let mut torn = packet(0, StreamStatus::Running, &[1]);
        torn.samples.pop();
        assert_eq!(
            taken(&mut Assembler::new(2, 1), &torn).1,
            Err(StreamEnd::Parts { samples: 3, entries: 4 })
        );
    }
}
