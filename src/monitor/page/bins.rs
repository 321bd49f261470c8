//! History of the six axes for strip charts: minimum, maximum and mean of each time interval (bin), so that
//! every pose is represented in any zoom level. Pure.

use std::collections::VecDeque;

use serde::ser::SerializeSeq;
use serde::{Serialize, Serializer};
use trifacet_core::time::NS_PER_S;
use trifacet_wire::PoseFrame;

/// Length of a bin in nanoseconds and number of bins kept, for one minute, ten minutes and six hours.
const LEVELS: [(i64, usize); 3] = [(FINE_NS, 3000), (NS_PER_S / 10, 6000), (NS_PER_S, 21_600)];
/// Length of the shortest bins, nanoseconds.
pub const FINE_NS: i64 = NS_PER_S / 50;
/// Approximate largest number of bins in a chart: more than its pixels can show.
const SHOWN: i64 = 600;
/// Longest history that can be requested, seconds.
pub const LONGEST_S: u32 = 21_600;

/// Values of the six axes in one time interval; metres and radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bin {
    /// Number of the bin: its time since 1970 divided by its length.
    pub k: i64,
    /// Number of poses; at least one.
    pub poses: u32,
    /// Smallest value of each axis.
    pub min: [f64; 6],
    /// Largest value of each axis.
    pub max: [f64; 6],
    /// Mean of each axis.
    pub mean: [f64; 6],
}

impl Bin {
    fn one(k: i64, pose: [f64; 6]) -> Self {
        Self { k, poses: 1, min: pose, max: pose, mean: pose }
    }

    fn add(&mut self, other: &Self) {
        self.poses += other.poses;
        let weight = f64::from(other.poses) / f64::from(self.poses);
        for axis in 0..6 {
            self.min[axis] = self.min[axis].min(other.min[axis]);
            self.max[axis] = self.max[axis].max(other.max[axis]);
            self.mean[axis] += (other.mean[axis] - self.mean[axis]) * weight;
        }
    }

    /// The same values as part of a bin that is `factor` times as long.
    fn within(self, factor: i64) -> Self {
        Self { k: self.k.div_euclid(factor), ..self }
    }
}

/// A row `[k, poses, min, max, mean of tx, min, ...]`.
impl Serialize for Bin {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut row = serializer.serialize_seq(Some(20))?;
        row.serialize_element(&self.k)?;
        row.serialize_element(&self.poses)?;
        for axis in 0..6 {
            for x in [self.min[axis], self.max[axis], self.mean[axis]] {
                row.serialize_element(&(x as f32))?; // 24 bits are more than a chart can show
            }
        }
        row.end()
    }
}

/// History for a chart.
#[derive(Debug, PartialEq, Serialize)]
pub struct History {
    /// Length of a bin.
    pub width_ms: i64,
    /// Number of the last short bin that is included.
    pub through: i64,
    /// Bins, oldest first; bins without a pose are omitted.
    pub bins: Vec<Bin>,
}

/// Bins of three lengths. The longer ones are computed from the shortest.
#[derive(Debug, Default)]
pub struct Past {
    open: Option<Bin>,
    levels: [VecDeque<Bin>; LEVELS.len()],
    /// Bins closed since the last call of [`Past::news`].
    news: Vec<Bin>,
}

impl Past {
    /// Takes every frame in turn; frames without a pose are ignored.
    pub fn frame(&mut self, frame: &PoseFrame) {
        let k = frame.time_ns.div_euclid(FINE_NS);
        if let Some(open) = self.open.filter(|open| open.k != k) {
            self.close(&open);
            self.open = None;
        }
        if frame.pose[0].is_nan() {
            return;
        }
        let pose = Bin::one(k, frame.pose);
        match &mut self.open {
            Some(open) => open.add(&pose),
            None => self.open = Some(pose),
        }
    }

    fn close(&mut self, bin: &Bin) {
        for (level, (width_ns, most)) in self.levels.iter_mut().zip(LEVELS) {
            let bin = bin.within(width_ns / FINE_NS);
            if level.back().is_some_and(|last| last.k > bin.k) {
                level.clear(); // the clock was set back: these bins lie in the future
            }
            match level.back_mut().filter(|last| last.k == bin.k) {
                Some(last) => last.add(&bin),
                None => level.push_back(bin),
            }
            if level.len() > most {
                level.pop_front();
            }
        }
        self.news.push(*bin);
    }

    /// The short bins closed since the last call.
    pub fn news(&mut self) -> Vec<Bin> {
        std::mem::take(&mut self.news)
    }

    /// The history of the last `span_s` seconds.
    pub fn history(&self, span_s: u32) -> History {
        let span_ns = i64::from(span_s.clamp(1, LONGEST_S)) * NS_PER_S;
        let fits = |level: &&(i64, usize)| span_ns <= level.0 * level.1 as i64;
        let (width_ns, _) = LEVELS.iter().find(fits).unwrap_or(&LEVELS[2]);
        let level = LEVELS.iter().position(|(w, _)| w == width_ns).unwrap_or_default();
        let factor = span_ns.div_euclid(width_ns * SHOWN).max(1);
        let newest = self.levels[level].back().map_or(0, |bin| bin.k);
        let mut bins: Vec<Bin> = Vec::new();
        for bin in self.levels[level].iter().filter(|bin| (newest - bin.k) * width_ns <= span_ns) {
            let bin = bin.within(factor);
            match bins.last_mut().filter(|last| last.k == bin.k) {
                Some(last) => last.add(&bin),
                None => bins.push(bin),
            }
        }
        let through = self.levels[0].back().map_or(0, |bin| bin.k);
        History { width_ms: width_ns * factor * 1000 / NS_PER_S, through, bins }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(time_ns: i64, x: f64) -> PoseFrame {
        PoseFrame { time_ns, pose: [x; 6], ..PoseFrame::example() }
    }

    /// Frames of a saw tooth with a spike, and without poses from the fourth to the sixth second.
    fn past(seconds: i64, rate: i64) -> Past {
        let mut past = Past::default();
        for i in 0..seconds * rate {
            let x = match i {
                54_321 => 1e3,
                i if (4 * rate..6 * rate).contains(&i) => f64::NAN,
                i => (i % 7) as f64,
            };
            past.frame(&frame(i * (NS_PER_S / rate), x));
        }
        past
    }

    #[test]
    fn every_pose_is_in_every_history_once() {
        let mut past = past(100, 1000);
        for (span_s, width_ms, poses) in [(10, 20, 10_000), (60, 100, 60_000), (600, 1000, 97_900)] {
            let history = past.history(span_s);
            assert_eq!(history.width_ms, width_ms, "{span_s}");
            let n: u32 = history.bins.iter().map(|bin| bin.poses).sum();
            assert!(n.abs_diff(poses) <= 120, "{span_s}: {n}");
            assert!(history.bins.len() <= SHOWN as usize + 2);
        }
        let all = past.history(LONGEST_S);
        let most = all.bins.iter().flat_map(|bin| bin.max).fold(0.0, f64::max);
        assert!((most - 1e3).abs() < 1e-9, "{most}");
        let n: u32 = past.news().iter().map(|bin| bin.poses).sum();
        assert_eq!(n, 98_000 - 20, "all but the open bin");
        assert!(past.news().is_empty());
    }

    #[test]
    fn a_single_spike_is_visible_after_six_hours_and_the_mean_covers_all_samples() {
        let mut past = Past::default();
        let seconds = i64::from(LONGEST_S);
        for i in 0..seconds * 10 {
            past.frame(&frame(i * NS_PER_S / 10, if i == 7 { 1e-3 } else { 1e-6 }));
        }
        let history = past.history(LONGEST_S);
        assert_eq!(history.width_ms, 36_000);
        let first = history.bins[0];
        assert!((first.max[3] - 1e-3).abs() < 1e-15 && (first.min[3] - 1e-6).abs() < 1e-15);
        let mean = (359.0 * 1e-6 + 1e-3) / 360.0;
        assert!((first.mean[0] - mean).abs() < 1e-12, "{first:?}");
        let kept: Vec<usize> = past.levels.iter().map(VecDeque::len).collect();
        assert!(kept.iter().zip(LEVELS).all(|(kept, (_, most))| *kept <= most), "{kept:?}");
    }

    #[test]
    fn a_clock_that_is_set_back_starts_a_new_history() {
        let mut past = past(3, 100);
        for i in 0..30 {
            past.frame(&frame(-NS_PER_S + i * FINE_NS, 1.0));
        }
        let history = past.history(10);
        assert!(history.bins.iter().all(|bin| bin.k < 0), "{history:?}");
        assert_eq!(history.bins.len(), 29);
    }
}
