//! How rarely frames come, so that time limits can follow.

use std::collections::VecDeque;
use std::time::Duration;

use tokio::time::Instant;
use trifacet_wire::stream::Descriptor;

/// Number of the latest intervals that are taken into account. After a break of the reader, frames that have
/// waited arrive without an interval.
const INTERVALS: usize = 8;

/// Follows the descriptors and the arrival of frames.
#[derive(Debug, Default)]
pub(super) struct FramePeriod {
    described: Option<Duration>,
    last: Option<Instant>,
    intervals: VecDeque<Duration>,
}

impl FramePeriod {
    /// Takes the period from a descriptor.
    pub(super) fn describe(&mut self, descriptor: &Descriptor) {
        let rate_hz = descriptor.stream.as_ref().map_or(descriptor.rate_hz, |stream| stream.rate_hz);
        let speed = descriptor.replay.as_ref().map_or(1.0, |replay| replay.speed);
        self.described = Duration::try_from_secs_f64(1.0 / (rate_hz * speed)).ok();
    }

    /// Registers a frame that has arrived now.
    pub(super) fn frame(&mut self) {
        let now = Instant::now();
        if let Some(last) = self.last.replace(now) {
            self.intervals.truncate(INTERVALS - 1);
            self.intervals.push_front(now - last);
        }
    }

    /// Starts again after a break of the link.
    pub(super) fn restart(&mut self) {
        self.last = None;
    }

    /// The period, if it is known.
    pub(super) fn get(&self) -> Option<Duration> {
        self.described.or_else(|| self.intervals.iter().max().copied())
    }
}
