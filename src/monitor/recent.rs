//! What the frames of the last moments had: status bits, and standard uncertainties. Pure.

use trifacet_core::time::{Mono, NS_PER_S};
use trifacet_wire::{PoseFrame, Status};

use crate::grade::HOLD_S;

/// The periods of the status bits. A period ends [`HOLD_S`] after the last frame with the bit.
#[derive(Debug, Default)]
pub struct RecentStatus([Option<Period>; Status::NAMES.len()]);

#[derive(Clone, Copy, Debug)]
struct Period {
    /// Time of its first frame, nanoseconds of UTC since 1970.
    since_ns: i64,
    /// Time at which its newest frame was seen.
    last: Mono,
}

impl RecentStatus {
    /// Takes every frame in turn, seen at the time `now`.
    pub fn frame(&mut self, frame: &PoseFrame, now: Mono) {
        let mut bits = frame.status.0;
        while bits != 0 {
            if let Some(period) = self.0.get_mut(bits.trailing_zeros() as usize) {
                let since_ns =
                    period.filter(|period| holds(period, now)).map_or(frame.time_ns, |p| p.since_ns);
                *period = Some(Period { since_ns, last: now });
            }
            bits &= bits - 1;
        }
    }

    /// All bits whose period has not ended.
    pub fn bits(&self, now: Mono) -> Status {
        self.periods(now).fold(Status::default(), |bits, (bit, _)| bits | bit)
    }

    /// Begin of the first period of these bits, nanoseconds of UTC since 1970.
    pub fn since_ns(&self, set: Status, now: Mono) -> Option<i64> {
        self.periods(now).filter(|(bit, _)| set.has(*bit)).map(|(_, period)| period.since_ns).min()
    }

    fn periods(&self, now: Mono) -> impl Iterator<Item = (Status, Period)> {
        let all = Status::NAMES.iter().map(|(bit, _)| *bit).zip(self.0);
        all.filter_map(move |(bit, period)| Some((bit, period.filter(|period| holds(period, now))?)))
    }
}

fn holds(period: &Period, now: Mono) -> bool {
    now.seconds_since(period.last) <= HOLD_S
}

/// A standard uncertainty above this multiple of the smallest one limits the use of the pose.
const LARGE: f64 = 3.0;

/// Names of the axes.
const AXES: [&str; 6] = ["tx", "ty", "tz", "roll", "pitch", "yaw"];

/// Compares the standard uncertainties of each second with the best second since the start or the last change of
/// the configuration. It shows a weak beam or a bad position, whose poses are valid.
#[derive(Debug, Default)]
pub struct UncertaintyTrend {
    /// Session and configuration of the frames.
    of: Option<(u32, u32)>,
    /// Time of the first frame of this second.
    began_ns: i64,
    sum: [f64; 6],
    count: u32,
    newest: Option<[f64; 6]>,
    best: Option<[f64; 6]>,
}

impl UncertaintyTrend {
    /// Takes every frame in turn.
    pub fn frame(&mut self, frame: &PoseFrame) {
        if self.of != Some((frame.session, frame.config)) {
            let of = Some((frame.session, frame.config));
            *self = Self { of, began_ns: frame.time_ns, ..Self::default() };
        }
        if (frame.time_ns - self.began_ns).abs() >= NS_PER_S {
            self.end_second();
            self.began_ns = frame.time_ns;
        }
        if frame.status.has(Status::POSE_VALID) && frame.deviations.iter().all(|sd| sd.is_finite()) {
            self.sum.iter_mut().zip(frame.deviations).for_each(|(sum, sd)| *sum += f64::from(sd));
            self.count += 1;
        }
    }

    fn end_second(&mut self) {
        let mean = self.sum.map(|sum| sum / f64::from(self.count));
        self.newest = (self.count > 0).then_some(mean);
        (self.sum, self.count) = ([0.0; 6], 0);
        if let Some(mean) = self.newest {
            let best = self.best.unwrap_or(mean);
            self.best = Some(std::array::from_fn(|axis| best[axis].min(mean[axis])));
        }
    }

    /// The axis with the largest ratio of its newest uncertainty to its smallest one, in words, if the ratio is
    /// large.
    pub fn finding(&self) -> Option<String> {
        let (newest, best) = (self.newest?, self.best?);
        let ratio = |axis: usize| newest[axis] / best[axis];
        let worst = (0..6).max_by(|a, b| ratio(*a).total_cmp(&ratio(*b)))?;
        let text = || {
            format!(
                "the standard uncertainty of {} is {:.1} times that of the best second of this configuration",
                AXES[worst],
                ratio(worst)
            )
        };
        (ratio(worst) > LARGE).then(text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(ms: i64, status: Status, sd: f32) -> PoseFrame {
        PoseFrame { time_ns: ms * 1_000_000, status, deviations: [sd; 6], ..PoseFrame::example() }
    }

    fn at(s: f64) -> Mono {
        Mono((s * 1e9) as i64)
    }

    #[test]
    fn a_bit_that_comes_and_goes_is_one_period() {
        let mut recent = RecentStatus::default();
        for n in 0..10 {
            let status = if n % 2 == 0 { Status::PSD_B_LOW } else { Status::POSE_VALID };
            recent.frame(&frame(100 * n, status, 1e-6), at(0.1 * n as f64));
        }
        assert!(recent.bits(at(1.0)).has(Status::PSD_B_LOW | Status::POSE_VALID));
        assert_eq!(recent.since_ns(Status::PSD_B_LOW | Status::PSD_A_LOW, at(1.0)), Some(0));
        assert_eq!(recent.since_ns(Status::PSD_A_LOW, at(1.0)), None);
        assert_eq!(recent.bits(at(0.8 + HOLD_S + 0.001)), Status::POSE_VALID);
        recent.frame(&frame(9000, Status::PSD_B_LOW, 1e-6), at(9.0));
        assert_eq!(recent.since_ns(Status::PSD_B_LOW, at(9.0)), Some(9_000_000_000));
    }

    #[test]
    fn uncertainties_that_grow_are_found_and_forgotten_with_the_configuration() {
        let mut trend = UncertaintyTrend::default();
        let mut second = |s: i64, sd: f32| {
            for n in 0..10 {
                trend.frame(&frame(1000 * s + 100 * n, Status::POSE_VALID, sd));
            }
            trend.finding()
        };
        assert_eq!(second(0, 1e-6), None);
        assert_eq!(second(1, 1e-6), None);
        assert_eq!(second(2, 5e-6), None, "the second has not ended");
        let found = second(3, 5e-6).unwrap();
        assert!(found.ends_with("5.0 times that of the best second of this configuration"), "{found}");
        trend.frame(&PoseFrame { config: 99, ..frame(4000, Status::POSE_VALID, 5e-6) });
        assert_eq!(trend.finding(), None);
    }
}
