//! Recent commands: the reference for the readback of the stage, and its position if there is no readback.

use std::collections::VecDeque;

use crate::steering::StagePosition;
use crate::time::{Mono, NS_PER_S};

/// The history is divided into this many intervals.
const PARTS: f64 = 64.0;

/// The recent commands.
#[derive(Clone, Debug, Default)]
pub struct CommandHistory {
    parts: VecDeque<Part>,
}

/// The commands of one interval.
#[derive(Clone, Copy, Debug)]
struct Part {
    from: Mono,
    last: StagePosition,
    least: StagePosition,
    most: StagePosition,
}

impl CommandHistory {
    /// Discards all commands.
    pub fn clear(&mut self) {
        self.parts.clear();
    }

    /// Records that the stage was sent to `position` after the sample of `time`. `span_s` is the length of
    /// the history, seconds.
    pub fn push(&mut self, position: StagePosition, time: Mono, span_s: f64) {
        match self.parts.back_mut() {
            Some(part) if time.seconds_since(part.from) < span_s / PARTS => {
                part.last = position;
                part.least = StagePosition([0, 1].map(|i| part.least[i].min(position[i])));
                part.most = StagePosition([0, 1].map(|i| part.most[i].max(position[i])));
            }
            _ => self.parts.push_back(Part { from: time, last: position, least: position, most: position }),
        }
        // Keeps the last interval before the span: the stage comes from there.
        while self.parts.get(1).is_some_and(|part| time.seconds_since(part.from) > span_s) {
            self.parts.pop_front();
        }
    }

    /// The command `delay_s` seconds before `time`; the oldest recorded one if all are younger.
    pub fn before(&self, time: Mono, delay_s: f64) -> Option<StagePosition> {
        let then = time + -((delay_s * NS_PER_S as f64) as i64);
        let part = self.parts.iter().rev().find(|part| part.from <= then).or(self.parts.front());
        part.map(|part| part.last)
    }

    /// Whether `position` is, to within `tolerance`, inside the range of the recorded commands on each axis.
    /// True if no command is recorded. Lengths in metres.
    pub fn leads_to(&self, position: StagePosition, tolerance: f64) -> bool {
        let axis = |i: usize| {
            let least = self.parts.iter().map(|part| part.least[i]).reduce(f64::min);
            let most = self.parts.iter().map(|part| part.most[i]).reduce(f64::max);
            least
                .zip(most)
                .is_none_or(|(least, most)| (least - tolerance..=most + tolerance).contains(&position[i]))
        };
        axis(0) && axis(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    /// One micrometre per millisecond along x, for 100 ms, with a history of 20 ms.
    fn ramp() -> CommandHistory {
        let mut history = CommandHistory::default();
        for k in 0..=100 {
            history.push(StagePosition([f64::from(k) * 1e-6, 0.0]), Mono(i64::from(k) * MS), 0.02);
        }
        history
    }

    #[test]
    fn the_history_returns_the_commanded_positions() {
        let at = |delay_s| ramp().before(Mono(100 * MS), delay_s).unwrap()[0];
        assert!((at(0.0) - 100e-6).abs() < 1e-12);
        assert!((at(0.01) - 90e-6).abs() < 1.5e-6, "{}", at(0.01));
        assert!((at(1.0) - 79e-6).abs() < 1.5e-6, "the oldest");
        assert_eq!(CommandHistory::default().before(Mono(0), 0.0), None);
    }

    #[test]
    fn a_moving_stage_follows_and_a_lagging_one_does_not() {
        let history = ramp();
        for (x, follows) in [(100e-6, true), (90e-6, true), (80e-6, true), (70e-6, false), (110e-6, false)] {
            assert_eq!(history.leads_to(StagePosition([x, 0.0]), 3e-6), follows, "{x}");
        }
        assert!(!history.leads_to(StagePosition([90e-6, 4e-6]), 3e-6));
        assert!(!history.leads_to(StagePosition([f64::NAN, 0.0]), 3e-6));
        assert!(CommandHistory::default().leads_to(StagePosition([1.0, 1.0]), 0.0));
    }

    #[test]
    fn the_length_of_the_history_is_limited() {
        let mut history = CommandHistory::default();
        for k in 0..1_000_000 {
            history.push(StagePosition([0.0; 2]), Mono(k * MS / 10), 10.0);
        }
        assert!(history.parts.len() < 70);
    }
}
