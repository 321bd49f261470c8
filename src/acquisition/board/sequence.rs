//! From sequence numbers to an index that never wraps and never decreases.

/// Number of sequence numbers remembered, to distinguish repeated frames from late ones.
const MEMORY: u32 = 64;

/// Classification of a frame by its sequence number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// Newer than all previous ones.
    New {
        /// Counts all scans since the start of the daemon.
        index: u64,
        /// Number of scans between this one and the previous one that have not arrived.
        lost: u32,
    },
    /// The frame has arrived before.
    Repeated,
    /// A newer frame arrived before; this one has been counted as lost.
    Late,
}

/// Tracks the sequence numbers of a board through wraps and restarts.
#[derive(Clone, Debug, Default)]
pub struct Sequence {
    /// Index of the next scan if nothing is lost.
    index: u64,
    /// Sequence number of that scan.
    expected: u32,
    /// Bit k: the frame with the number `expected - 1 - k` has arrived.
    seen: u64,
    /// Scans missed while the board was disconnected, not yet reported.
    missed: u64,
}

impl Sequence {
    /// The board restarts at number 0, about `missed` scans after the last one that arrived.
    pub fn restart(&mut self, missed: u64) {
        self.index += missed;
        self.missed += missed;
        self.expected = 0;
        self.seen = 0;
    }

    /// Classifies a number. A number up to half the range ahead is new.
    pub fn arrived(&mut self, sequence: u32) -> Arrival {
        let ahead = sequence.wrapping_sub(self.expected);
        if ahead > u32::MAX / 2 {
            return self.older(self.expected.wrapping_sub(sequence) - 1);
        }
        let lost = std::mem::take(&mut self.missed) + u64::from(ahead);
        let index = self.index + u64::from(ahead);
        self.index = index + 1;
        self.expected = sequence.wrapping_add(1);
        self.seen = self.seen.checked_shl(ahead.saturating_add(1)).unwrap_or(0) | 1;
        Arrival::New { index, lost: u32::try_from(lost).unwrap_or(u32::MAX) }
    }

    fn older(&mut self, age: u32) -> Arrival {
        if age >= MEMORY {
            return Arrival::Late;
        }
        let bit = 1 << age;
        let seen = self.seen & bit != 0;
        self.seen |= bit;
        if seen { Arrival::Repeated } else { Arrival::Late }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn new(index: u64, lost: u32) -> Arrival {
        Arrival::New { index, lost }
    }

    #[test]
    fn lost_repeated_and_late_scans_are_distinguished() {
        let mut sequence = Sequence::default();
        assert_eq!(sequence.arrived(0), new(0, 0));
        assert_eq!(sequence.arrived(3), new(3, 2));
        assert_eq!(sequence.arrived(3), Arrival::Repeated);
        assert_eq!(sequence.arrived(2), Arrival::Late);
        assert_eq!(sequence.arrived(2), Arrival::Repeated);
        assert_eq!(sequence.arrived(0), Arrival::Repeated);
        assert_eq!(sequence.arrived(4), new(4, 0));
        assert_eq!(sequence.arrived(1000), new(1000, 995));
        assert_eq!(sequence.arrived(900), Arrival::Late);
    }

    #[test]
    fn numbers_wrap_and_the_index_does_not() {
        let mut sequence = Sequence { expected: u32::MAX - 1, index: 5, ..Sequence::default() };
        assert_eq!(sequence.arrived(u32::MAX - 1), new(5, 0));
        assert_eq!(sequence.arrived(1), new(8, 2));
        assert_eq!(sequence.arrived(u32::MAX), Arrival::Late);
        assert_eq!(sequence.arrived(2), new(9, 0));
    }

    #[test]
    fn after_a_restart_the_index_grows_and_the_loss_is_known() {
        let mut sequence = Sequence::default();
        sequence.arrived(0);
        sequence.restart(500);
        assert_eq!(sequence.arrived(1), new(502, 501));
        assert_eq!(sequence.arrived(2), new(503, 0));
    }

    proptest! {
        #[test]
        fn every_number_is_accounted_for(steps in prop::collection::vec(0_u32..200, 1..100)) {
            let (mut sequence, mut number, mut lost, mut found) = (Sequence::default(), 0_u32, 0, 0);
            for step in steps {
                number += step;
                match sequence.arrived(number) {
                    Arrival::New { index, lost: n } => {
                        prop_assert_eq!(index, u64::from(number));
                        (lost, found) = (lost + n, found + 1);
                    }
                    arrival => prop_assert!(step == 0 && arrival == Arrival::Repeated),
                }
            }
            prop_assert_eq!(lost + found, number + 1);
        }
    }
}
