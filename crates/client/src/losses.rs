//! Counts lost frames from their sequence numbers.

use trifacet_wire::PoseFrame;

/// Losses between daemon and client, counted by the client.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Losses {
    /// Frames missing in the sequence.
    pub missed_frames: u64,
    /// Frames received after a newer one, or twice (UDP only). They were counted as missed before.
    pub late_frames: u64,
    /// Bytes outside intact messages.
    pub skipped_bytes: u64,
}

/// Follows the sequence numbers.
#[derive(Debug, Default)]
pub(super) struct LossCounter {
    /// Session and sequence number of the newest frame.
    last: Option<(u32, u64)>,
    /// Step of the sequence numbers, if known.
    pub(super) step: Option<u64>,
    /// Estimate of an unknown step: all sequence numbers are multiples of it, so it is their common divisor.
    divisor: u64,
    pub(super) losses: Losses,
}

impl LossCounter {
    pub(super) fn new(step: Option<u64>) -> Self {
        Self { step, ..Self::default() }
    }

    pub(super) fn note(&mut self, frame: &PoseFrame) {
        match self.last {
            Some((session, last)) if session == frame.session => {
                if frame.sequence <= last {
                    self.losses.late_frames += 1;
                    return;
                }
                self.divisor = common_divisor(self.divisor, frame.sequence);
                let step = self.step.unwrap_or(self.divisor).max(1);
                self.losses.missed_frames += ((frame.sequence - last) / step).saturating_sub(1);
            }
            // The first frame, or the first one after a restart of the daemon.
            _ => self.divisor = frame.sequence,
        }
        self.last = Some((frame.session, frame.sequence));
    }
}

fn common_divisor(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { common_divisor(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn losses(step: Option<u64>, frames: &[(u32, u64)]) -> Losses {
        let mut losses = LossCounter::new(step);
        for &(session, sequence) in frames {
            losses.note(&PoseFrame { session, sequence, ..PoseFrame::example() });
        }
        losses.losses
    }

    #[test]
    fn gaps_are_counted_and_a_restart_is_not_a_gap() {
        let frames = [(1, 100), (1, 101), (1, 105), (1, 103), (1, 106), (2, 0), (2, 1), (2, 3)];
        for step in [None, Some(1)] {
            let expected = Losses { missed_frames: 4, late_frames: 1, skipped_bytes: 0 };
            assert_eq!(losses(step, &frames), expected);
        }
    }

    #[test]
    fn a_divided_sequence_has_no_gaps_but_its_own() {
        let frames = [(1, 700), (1, 710), (1, 720), (1, 750), (1, 760)];
        for step in [None, Some(10)] {
            assert_eq!(losses(step, &frames).missed_frames, 2, "{step:?}");
        }
    }
}
