//! Totals and means over all frames, so that a scrape misses none. Pure.

use prometheus_client::metrics::histogram::Histogram;
use trifacet_core::time::{Mono, NS_PER_S};
use trifacet_wire::{LockState, PoseFrame, Status};

use super::trend::Trend;

/// Bucket bounds of the delays, seconds.
const DELAYS_S: [f64; 16] =
    [1e-5, 2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0];
/// Bucket bounds of the distance between beam and apex, metres.
const OFFSETS_M: [f64; 10] = [1e-7, 3e-7, 1e-6, 2e-6, 3e-6, 5e-6, 1e-5, 3e-5, 1e-4, 3e-4];
/// Bucket bounds of the number of solver iterations.
const STEPS: [f64; 8] = [1.0, 2.0, 3.0, 4.0, 6.0, 10.0, 20.0, 40.0];

/// Totals since the start, and means of the last second.
#[derive(Debug)]
pub struct Tally {
    /// Frames with each status bit, in the order of [`Status::NAMES`].
    pub status: [u64; Status::NAMES.len()],
    /// Frames in each lock state, in the order of [`LockState::ALL`].
    pub lock: [u64; LockState::ALL.len()],
    /// Time from the sample to the solved pose, seconds; frames with samples only.
    pub solve_delay: Histogram,
    /// Time from the solved pose to its transmission, seconds.
    pub send_delay: Histogram,
    /// Iterations of the solver, in frames in which it ran.
    pub steps: Histogram,
    /// Distance between beam and apex, metres, if known.
    pub offset: Histogram,
    /// The last complete second.
    pub second: Second,
    /// Trend of the total power.
    pub trend: Trend,
    sums: Sums,
    /// Start of the current second.
    began: Mono,
}

/// Means of one second. A value that no frame contains is `None`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Second {
    /// Mean offset of the beam from the apex, x and y, metres.
    pub offset: Option<[f64; 2]>,
    /// Rms of the length of the offset, metres.
    pub offset_rms: Option<f64>,
    /// Smallest distance of a spot from the edge of PSD A, B, C, metres; negative beyond the edge.
    pub edge: [Option<f64>; 3],
    /// Mean power on PSD A, B, C, watts.
    pub powers: Option<[f64; 3]>,
    /// Mean power of A, B, C in frames with light on all three, watts.
    pub lit: Option<[f64; 3]>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    offsets: Mean<3>,
    edge: [Option<f64>; 3],
    powers: Mean<3>,
    lit: Mean<3>,
}

/// Sum and count of a mean.
#[derive(Clone, Copy, Debug)]
struct Mean<const N: usize> {
    sum: [f64; N],
    count: u32,
}

impl<const N: usize> Default for Mean<N> {
    fn default() -> Self {
        Self { sum: [0.0; N], count: 0 }
    }
}

impl<const N: usize> Mean<N> {
    /// Adds numbers if all of them are known.
    fn push(&mut self, numbers: [f64; N]) {
        if numbers.iter().all(|x| x.is_finite()) {
            self.sum.iter_mut().zip(numbers).for_each(|(sum, x)| *sum += x);
            self.count += 1;
        }
    }

    fn mean(&self) -> Option<[f64; N]> {
        (self.count > 0).then(|| self.sum.map(|sum| sum / f64::from(self.count)))
    }
}

impl Tally {
    /// A tally without frames.
    pub fn new(now: Mono) -> Self {
        Self {
            status: [0; _],
            lock: [0; _],
            solve_delay: Histogram::new(DELAYS_S),
            send_delay: Histogram::new(DELAYS_S),
            steps: Histogram::new(STEPS),
            offset: Histogram::new(OFFSETS_M),
            second: Second::default(),
            trend: Trend::default(),
            sums: Sums::default(),
            began: now,
        }
    }

    /// Takes every frame in turn. `half_m` is half the side of a PSD, metres.
    pub fn frame(&mut self, frame: &PoseFrame, half_m: f64) {
        let mut bits = frame.status.0;
        while bits != 0 {
            if let Some(count) = self.status.get_mut(bits.trailing_zeros() as usize) {
                *count += 1;
            }
            bits &= bits - 1;
        }
        self.lock[frame.lock as usize] += 1;
        if frame.averaged > 0 {
            self.solve_delay.observe(seconds(frame.solve_delay_ns));
            self.send_delay.observe(seconds(frame.send_delay_ns.saturating_sub(frame.solve_delay_ns)));
        }
        if frame.iterations > 0 {
            self.steps.observe(f64::from(frame.iterations));
        }
        self.optics(frame, half_m);
    }

    fn optics(&mut self, frame: &PoseFrame, half_m: f64) {
        let [x, y] = frame.beam_offset.map(f64::from);
        let square = x * x + y * y;
        self.sums.offsets.push([x, y, square]);
        if square.is_finite() {
            self.offset.observe(square.sqrt());
        }
        for (edge, spot) in self.sums.edge.iter_mut().zip(frame.spots.as_chunks::<2>().0) {
            let [u, v] = spot.map(f64::from);
            if u.is_finite() && v.is_finite() {
                let distance = half_m - u.abs().max(v.abs());
                *edge = Some(edge.map_or(distance, |least| least.min(distance)));
            }
        }
        let powers = frame.powers.map(f64::from);
        self.sums.powers.push(powers);
        if frame.spots.iter().all(|x| x.is_finite()) {
            self.sums.lit.push(powers);
        }
    }

    /// Closes the second if it is over.
    pub fn tick(&mut self, now: Mono) {
        if now - self.began < NS_PER_S {
            return;
        }
        let Sums { offsets, edge, powers, lit } = std::mem::take(&mut self.sums);
        let offset = offsets.mean();
        self.second = Second {
            offset: offset.map(|[x, y, _]| [x, y]),
            offset_rms: offset.map(|[.., square]| square.sqrt()),
            edge,
            powers: powers.mean(),
            lit: lit.mean(),
        };
        if let Some(powers) = self.second.lit {
            self.trend.push(now, powers.iter().sum());
        }
        self.began = now;
    }
}

fn seconds(ns: u32) -> f64 {
    f64::from(ns) * 1e-9
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-6 * b.abs()
    }

    #[test]
    fn a_second_has_the_means_of_its_own_frames() {
        let frame = |x: f32, u: f32, power: f32| PoseFrame {
            beam_offset: [x, 0.0],
            spots: [u, 0.0, 0.0, 0.0, 0.0, -1e-3],
            powers: [power, 2e-4, 1e-4],
            ..PoseFrame::example()
        };
        let mut tally = Tally::new(Mono(0));
        tally.frame(&frame(3e-6, 1e-3, 1e-4), 6.5e-3);
        tally.tick(Mono(NS_PER_S - 1));
        assert_eq!(tally.second, Second::default(), "the second is not over");
        tally.frame(&frame(-1e-6, -6e-3, 3e-4), 6.5e-3);
        let dark = PoseFrame { spots: [f32::NAN; 6], beam_offset: [f32::NAN; 2], ..frame(0.0, 0.0, 0.0) };
        tally.frame(&dark, 6.5e-3);
        tally.tick(Mono(NS_PER_S));
        let second = tally.second;
        assert!(close(second.offset.unwrap()[0], 1e-6));
        assert!(close(second.offset_rms.unwrap(), 5e-12_f64.sqrt()));
        assert!(close(second.edge[0].unwrap(), 0.5e-3) && close(second.edge[2].unwrap(), 5.5e-3));
        assert!(close(second.powers.unwrap()[0], 4e-4 / 3.0), "dark frames have a power");
        assert!(close(second.lit.unwrap()[0], 2e-4), "and do not count as lit");
        tally.tick(Mono(2 * NS_PER_S));
        assert_eq!(tally.second, Second::default(), "values without a frame are None");
    }

    #[test]
    fn a_spot_with_one_coordinate_has_no_distance() {
        let mut tally = Tally::new(Mono(0));
        let frame = PoseFrame::example();
        tally.frame(&PoseFrame { spots: [0.0, f32::NAN, f32::NAN, 0.0, 0.0, 0.0], ..frame }, 6.5e-3);
        tally.tick(Mono(NS_PER_S));
        assert_eq!(tally.second.edge, [None, None, Some(6.5e-3)]);
    }

    #[test]
    fn bits_and_states_are_counted_and_unknown_bits_do_no_harm() {
        let mut tally = Tally::new(Mono(0));
        let status = Status(Status::SOURCE_DOWN.0 | 1 << 31 | 1);
        let frame = PoseFrame { status, lock: LockState::Held, ..PoseFrame::example() };
        tally.frame(&frame, 6.5e-3);
        assert_eq!((tally.status[0], tally.status[16], tally.status.iter().sum::<u64>()), (1, 1, 2));
        assert_eq!((tally.lock[7], tally.lock.iter().sum::<u64>()), (1, 1));
    }
}
