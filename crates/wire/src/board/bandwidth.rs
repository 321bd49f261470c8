//! Required data rate of the serial line.

use super::framing::OVERHEAD;
use super::scan::ScanFormat;

/// Bits on the line per byte: start, eight data bits, stop.
const BITS_PER_BYTE: f64 = 10.0;

/// Largest fraction of the line that may be in use. The rest lets queues drain, and allows for different
/// clock rates at both ends.
const LOAD: f64 = 0.95;

/// Bytes of a frame with one scan.
pub fn scan_bytes(channels: usize, format: ScanFormat) -> usize {
    OVERHEAD + format.head_bytes() + 3 * channels
}

/// Bytes of a frame with an acknowledgement.
const ACK_BYTES: usize = OVERHEAD + 5;

/// The lowest baud rate at which a board with this number of channels can send `rate_hz` scans per second
/// while every scan is answered by a steering command. Both directions are in use at once. The direction from
/// the board is the busier one: a scan and an acknowledgement per command.
pub fn required_baud(channels: usize, rate_hz: f64, format: ScanFormat) -> u32 {
    let bytes = scan_bytes(channels, format) + ACK_BYTES;
    let bits_per_s = bytes as f64 * rate_hz * BITS_PER_BYTE / LOAD;
    let whole = bits_per_s as u32;
    whole.saturating_add(u32::from(f64::from(whole) < bits_per_s))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::actuator::{LeaseAction, OutputCommand};
    use crate::board::message::SteerResult;
    use crate::board::{Answer, BoardScan, Request};
    use crate::channel::MAX_CHANNELS;

    #[test]
    fn the_budget_agrees_with_the_sent_bytes() {
        let mut ack = Vec::new();
        Answer::Ack { id: 1, result: SteerResult::Accepted }.encode(&mut ack);
        assert_eq!(ack.len(), ACK_BYTES);
        let mut steer = Vec::new();
        let command = OutputCommand { id: 1, codes: [-1, 1], lease_ms: 200, on_expiry: LeaseAction::Park };
        Request::Steer(command).encode(&mut steer);
        let formats = [ScanFormat::Short, ScanFormat::LONG, ScanFormat::Long { wide_tick: true }];
        for (channels, format) in (9..=MAX_CHANNELS).flat_map(|n| formats.map(|format| (n, format))) {
            let mut scan = Vec::new();
            let channels_sent = channels as u8;
            Answer::Scan(BoardScan { channels: channels_sent, format, ..BoardScan::default() })
                .encode(&mut scan);
            assert_eq!(scan.len(), scan_bytes(channels, format));
            assert!(steer.len() < scan.len() + ack.len());
        }
    }

    #[test]
    fn the_default_baud_rate_carries_a_kilohertz_of_sixteen_channels() {
        assert!(required_baud(16, 1000.0, ScanFormat::Long { wide_tick: true }) <= 921_600);
        assert!(required_baud(9, 2000.0, ScanFormat::Short) > 921_600);
        assert_eq!(required_baud(11, 1000.0, ScanFormat::Short), 663_158);
    }
}
