//! The delay from a sample to the first scan that has its command applied, and whether the loop can bear it.

use std::fmt;

use crate::sent_commands::SentCommands;
use crate::time::Mono;

/// Number of commands of which the median is taken.
const BLOCK: usize = 64;
/// Largest number of commands that are remembered.
const MOST: usize = 1024;
/// A delay that is longer than the configured one by more than this part takes too much of the margins of a loop ...
const PART: f64 = 0.5;
/// ... unless it is longer by no more than this number of sample periods: the delay is known to one period.
const PERIODS: f64 = 2.0;

/// Measures the delay of commands by the ids in the scans.
///
/// The delay includes everything but the stage: conversion, transfer, computation, transfer, output, and the wait for the
/// next scan.
#[derive(Clone, Debug, Default)]
pub struct CommandDelay {
    /// Times of the samples from which the commands were computed.
    waiting: SentCommands<Mono>,
    /// The applied id in the last scan.
    seen: Option<u32>,
    /// The delays since the last median, seconds.
    block: Vec<f64>,
    median_s: Option<f64>,
}

impl CommandDelay {
    /// Records a command that was computed from the sample of this time.
    pub fn sent(&mut self, id: u32, sampled: Mono) {
        self.waiting.push(id, sampled, MOST);
    }

    /// Records a scan with its time and the last command that was applied in it.
    pub fn applied(&mut self, id: Option<u32>, time: Mono) {
        let before = std::mem::replace(&mut self.seen, id);
        if before == id || before.is_none() {
            return; // the same command, or perhaps one of a previous daemon
        }
        let Some(sampled) = id.and_then(|id| self.waiting.take(id)) else { return };
        self.block.push(time.seconds_since(sampled));
        if self.block.len() == BLOCK {
            let (_, median_s, _) = self.block.select_nth_unstable_by(BLOCK / 2, f64::total_cmp);
            self.median_s = Some(*median_s);
            self.block.clear();
        }
    }

    /// Forgets everything: the stage was replaced, or has acted on its own.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Median of the last complete block of commands, seconds.
    pub fn median_s(&self) -> Option<f64> {
        self.median_s
    }
}

/// The measured delay is so much longer than the configured one that the loop may swing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DelayDoubt {
    /// The measured delay, without the stage, seconds.
    pub measured_s: f64,
    /// The configured delay, which the gains are derived from, seconds.
    pub configured_s: f64,
}

impl DelayDoubt {
    /// The doubt about a configured delay, if there is one. A shorter delay is no reason: the stage adds to it, and the
    /// loop is only slower than it could be.
    pub fn of(measured_s: f64, configured_s: f64, period_s: f64) -> Option<Self> {
        let beyond =
            measured_s > configured_s * (1.0 + PART) && measured_s > configured_s + PERIODS * period_s;
        beyond.then_some(Self { measured_s, configured_s })
    }
}

impl fmt::Display for DelayDoubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [measured_ms, configured_ms] = [self.measured_s, self.configured_s].map(|seconds| seconds * 1e3);
        write!(
            f,
            "commands are applied {measured_ms:.1} ms after their sample, but the gains are those of a loop delay of \
             {configured_ms:.1} ms: measure it with `trifacet tune`, or set centering.loop_delay_ms"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    /// One command per millisecond, each applied in the scan `delay` periods later.
    fn run(delay: u32, scans: u32) -> CommandDelay {
        let mut commands = CommandDelay::default();
        for k in 0..scans {
            let time = Mono(i64::from(k) * MS);
            commands.applied(k.checked_sub(delay), time);
            commands.sent(k, time);
        }
        commands
    }

    #[test]
    fn the_median_of_a_block_of_commands_is_measured() {
        assert_eq!(run(3, 66).median_s(), None, "too few");
        assert!((run(3, 200).median_s().unwrap() - 3e-3).abs() < 1e-12);
        assert!((run(500, 900).median_s().unwrap() - 0.5).abs() < 1e-12);
        assert_eq!(run(3000, 9000).median_s(), None, "too many to remember");
    }

    #[test]
    fn commands_of_another_daemon_and_skipped_ones_are_not_measured() {
        let mut commands = CommandDelay::default();
        commands.sent(7, Mono(0));
        commands.applied(Some(7), Mono(MS));
        assert_eq!(commands.block.len(), 0, "it was applied before this daemon began");
        commands.sent(8, Mono(MS));
        commands.sent(9, Mono(2 * MS));
        commands.applied(Some(1234), Mono(3 * MS));
        commands.applied(Some(9), Mono(6 * MS));
        commands.applied(Some(9), Mono(7 * MS));
        commands.applied(Some(8), Mono(8 * MS));
        assert_eq!(commands.block, [4e-3]);
    }

    #[test]
    fn a_delay_is_doubted_beyond_half_of_it_and_two_periods() {
        assert_eq!(DelayDoubt::of(3.7e-3, 2.5e-3, 1e-3), None, "within two periods");
        assert_eq!(DelayDoubt::of(4.6e-3, 2.5e-3, 0.1e-3).map(|doubt| doubt.measured_s), Some(4.6e-3));
        assert_eq!(DelayDoubt::of(29e-3, 20e-3, 1e-3), None, "within half of it");
        assert_eq!(DelayDoubt::of(0.1e-3, 2.5e-3, 1e-3), None, "the stage adds to it");
        let text = DelayDoubt::of(9.04e-3, 2.5e-3, 1e-3).unwrap().to_string();
        assert!(
            text.contains("9.0 ms") && text.contains("2.5 ms") && text.contains("trifacet tune"),
            "{text}"
        );
    }
}
