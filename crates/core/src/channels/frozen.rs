//! Detects channels that repeat the same code although their signal has noise.
//!
//! The noise of a healthy channel changes its code. A code that repeats for so long that the noise makes it less
//! likely than [`LIKELY`] is not measured: the converter, its multiplexer or the board repeats an old value. How
//! long that is depends on the step of the converter and on the noise: some ten scans if the noise is five times
//! the step (16 bits), some hundreds if it is a third (12 bits), and never where it is far below the step.
//!
//! Motion looks like noise. Therefore the noise is the smaller of two: that of the channel itself before, and that
//! of the other channels of its kind (positions or sums) while the code repeats. If all of them are quiet, the
//! mirror is at rest. If no code changes at all, the whole scan is repeated.

use trifacet_wire::channel::SIGNALS;

/// A repeat that is less likely than this is a fault.
const LIKELY: f64 = 1e-10;
/// Number of scans in a block, of which the noise of a channel is computed.
const BLOCK: u32 = 256;
/// Weight of a block in the running mean of the noise.
const WEIGHT: f64 = 1.0 / 16.0;
/// The noise is taken as this part of its estimate, which has an uncertainty of its own.
const CAREFUL: f64 = 0.9;
/// A channel that has never changed is compared with this part of the noise of the others.
const UNKNOWN: f64 = 1.0 / 3.0;
/// A converter is coarse if the variance is below this part of its squared step.
const COARSE: f64 = 1.0;
/// Fewest repeats after which the noise of the other channels is known.
const FEWEST: u32 = 5;
/// A scan that is repeated as a whole is a fault after this many repeats. No other channel shows then whether the
/// mirror is at rest.
const WHOLE: u32 = 200;
const N: usize = SIGNALS.len();

/// The nine channels, in the order of [`SIGNALS`]: u, v and sum of A, B and C.
#[derive(Clone, Debug)]
pub struct FrozenChannels {
    channels: [Channel; N],
    /// Which of them are frozen.
    frozen: [bool; N],
    /// The bits that have changed in any channel. The lowest one is the true step of the converter, also where
    /// the low bits are dead.
    changed: i32,
}

#[derive(Clone, Debug, Default)]
struct Channel {
    /// The last two codes.
    last: Option<[i32; 2]>,
    /// Number of repeats of the last code.
    repeats: u32,
    /// Sum of the squares of all second differences; wraps.
    squares: u64,
    /// The sums of all channels after two repeats.
    squares_then: [u64; N],
    /// Number of second differences in the block, and the sum at its begin.
    block: (u32, u64),
    /// Running mean of the variance of the code, apart from motion that is slow against a scan.
    variance: Option<f64>,
}

impl FrozenChannels {
    /// Nothing is known yet.
    pub fn new() -> Self {
        Self { channels: Default::default(), frozen: [false; N], changed: 0 }
    }

    /// Scans were lost: differences across the gap have no meaning.
    pub fn gap(&mut self) {
        for channel in &mut self.channels {
            channel.interrupt();
        }
    }

    /// Takes the codes of a scan; returns whether any channel is frozen. `usable` is false while a PSD is dark or
    /// clipped: its codes may then repeat.
    pub fn push(&mut self, codes: [i32; N], usable: [bool; 3]) -> bool {
        let mut any = false;
        for (i, code) in codes.into_iter().enumerate() {
            let channel = &mut self.channels[i];
            if usable[i / 3] {
                self.changed |= channel.push(code);
            } else {
                channel.interrupt();
                channel.repeats = 0;
            }
            // Nearly always: noise changes the code.
            if channel.repeats == 0 {
                self.frozen[i] = false;
            } else {
                any |= self.repeated(i);
            }
        }
        any
    }

    /// Judges a channel that has repeated its code.
    #[cold]
    fn repeated(&mut self, i: usize) -> bool {
        let repeats = self.channels[i].repeats;
        if repeats == 2 {
            self.channels[i].squares_then = std::array::from_fn(|k| self.channels[k].squares);
        } else if repeats >= FEWEST && !self.frozen[i] {
            self.frozen[i] = f64::from(repeats) * self.log_of_repeat(i) < LIKELY.ln();
        }
        if self.frozen[i] {
            self.channels[i].begin_block(); // a block with a frozen code says nothing about the noise
        }
        self.frozen[i]
    }

    /// Whether this channel is frozen.
    pub fn frozen(&self, channel: usize) -> bool {
        self.frozen[channel]
    }

    /// Logarithm of the probability that the code repeats once, at most: with the signal in the middle of a
    /// step.
    fn log_of_repeat(&self, channel: usize) -> f64 {
        let step = f64::from(1_u32 << self.changed.trailing_zeros().min(31));
        let noise = |variance: f64| (variance - step * step / 12.0).max(0.0).sqrt(); // without that of the steps
        let Some(own) = self.channels[channel].variance else { return 0.0 };
        let [smallest, median] = if self.whole_scan_repeats() { [own; 2] } else { self.others(channel) };
        // With a coarse converter, the variance depends on where in its step a signal lies.
        let coarse = own.min(median) < COARSE * step * step;
        let others = if coarse { smallest } else { median };
        let sigma = if own > 0.0 { noise(own.min(others)) } else { UNKNOWN * noise(others) };
        libm::erf(0.5 * step / (CAREFUL * sigma * std::f64::consts::SQRT_2)).ln() // 0 without noise
    }

    fn whole_scan_repeats(&self) -> bool {
        self.channels.iter().all(|channel| channel.repeats >= WHOLE)
    }

    /// The smallest variance and the median of the other channels of the same kind since the code repeats. Of two
    /// sums, the smaller one is the median.
    fn others(&self, channel: usize) -> [f64; 2] {
        let is_sum = |channel: usize| channel % 3 == 2;
        let this = &self.channels[channel];
        let (mut others, mut n) = ([0; N], 0);
        for i in (0..N).filter(|i| *i != channel && is_sum(*i) == is_sum(channel)) {
            others[n] = self.channels[i].squares.wrapping_sub(this.squares_then[i]);
            n += 1;
        }
        others[..n].sort_unstable();
        [others[0], others[(n - 1) / 2]].map(|sum| sum as f64 / (6.0 * f64::from(this.repeats - 2)))
    }
}

impl Channel {
    /// Takes a code; returns the bits that changed.
    fn push(&mut self, code: i32) -> i32 {
        let Some([last, before]) = self.last else {
            self.last = Some([code; 2]);
            return 0;
        };
        self.last = Some([code, last]);
        if code == last {
            self.repeats = self.repeats.saturating_add(1);
        } else {
            self.repeats = 0;
        }
        // The second difference removes the position and the velocity of the signal.
        let second = i64::from(code) - 2 * i64::from(last) + i64::from(before);
        self.squares = self.squares.wrapping_add((second * second) as u64);
        self.block.0 += 1;
        if self.block.0 == BLOCK {
            let variance = self.squares.wrapping_sub(self.block.1) as f64 / f64::from(6 * BLOCK);
            self.variance = Some(self.variance.map_or(variance, |mean| mean + WEIGHT * (variance - mean)));
            self.begin_block();
        }
        code ^ last
    }

    fn begin_block(&mut self) {
        self.block = (0, self.squares);
    }

    /// Begins a new block. A run of repeats goes on: also across a gap, noise would have changed the code.
    fn interrupt(&mut self) {
        self.last = self.last.map(|[last, _]| [last, last]);
        self.begin_block();
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// Codes of nine channels with this noise (in steps of the converter) and motion.
    struct Signals {
        random: Pcg64Mcg,
        noise: f64,
        scan: u64,
        motion: fn(u64) -> f64,
        dead_bits: u32,
    }

    impl Signals {
        fn new(noise: f64) -> Self {
            Self { random: Pcg64Mcg::seed_from_u64(3), noise, scan: 0, motion: |_| 0.0, dead_bits: 0 }
        }

        fn next(&mut self) -> [i32; 9] {
            self.scan += 1;
            let at = (self.motion)(self.scan);
            std::array::from_fn(|i| {
                let noise: f64 = self.random.sample(StandardNormal);
                let code = (100.0 * i as f64 + 0.1 * i as f64 + at + self.noise * noise).round() as i32;
                code << self.dead_bits
            })
        }
    }

    fn frozen(detector: &FrozenChannels) -> Vec<usize> {
        (0..9).filter(|i| detector.frozen(*i)).collect()
    }

    /// Scans until the detector finds channel 4, which repeats its code from scan `from` on.
    fn found_after(signals: &mut Signals, from: usize) -> Option<usize> {
        let (mut detector, mut held) = (FrozenChannels::new(), 0);
        for n in 0..from + 3000 {
            let mut codes = signals.next();
            if n >= from {
                codes[4] = held;
            }
            held = codes[4];
            detector.push(codes, [true; 3]);
            assert!(frozen(&detector).iter().all(|i| *i == 4), "{:?} in scan {n}", frozen(&detector));
            if detector.frozen(4) {
                return Some(n - from + 1);
            }
        }
        None
    }

    #[test]
    fn a_frozen_channel_is_found_as_soon_as_the_noise_allows() {
        // 1.08 um on 13 mm: 21.8 steps at 18 bits, 5.4 at 16, 0.34 at 12 (docs/twin.md).
        for (noise, most) in [(21.8, 8), (5.4, 12), (1.36, 40), (0.34, 2000)] {
            let found = found_after(&mut Signals::new(noise), 2000);
            assert!(found.is_some_and(|n| n <= most), "{noise} steps: after {found:?} scans");
            let mut moving = Signals { motion: |n| 50.0 * (n as f64 * 0.01).sin(), ..Signals::new(noise) };
            let found = found_after(&mut moving, 2000);
            assert!(found.is_some_and(|n| n <= most), "{noise} steps, moving: after {found:?} scans");
        }
    }

    #[test]
    fn dead_low_bits_are_the_step_of_the_converter() {
        let mut signals = Signals { dead_bits: 4, ..Signals::new(0.34) };
        assert!(found_after(&mut signals, 2000).is_some_and(|n| n > 60), "repeats are normal here");
        let mut signals = Signals { dead_bits: 4, ..Signals::new(5.4) };
        assert!(found_after(&mut signals, 2000).is_some_and(|n| n <= 12));
    }

    #[test]
    fn a_channel_that_never_changed_is_compared_with_its_kind() {
        assert!(found_after(&mut Signals::new(21.8), 0).is_some_and(|n| n <= 600));
    }

    #[test]
    fn noise_far_below_the_step_says_nothing() {
        assert_eq!(found_after(&mut Signals::new(0.05), 2000), None);
        assert_eq!(found_after(&mut Signals::new(0.0), 2000), None);
    }

    #[test]
    fn a_dark_channel_may_repeat_its_code() {
        let (mut detector, mut signals) = (FrozenChannels::new(), Signals::new(20.0));
        for n in 0..5000 {
            let dark = (2000..4000).contains(&n);
            let codes = signals.next();
            detector.push(codes.map(|code| if dark { 0 } else { code }), [!dark; 3]);
            assert_eq!(frozen(&detector), [0; 0], "scan {n}");
        }
    }

    /// No false alarm at rest, moving, and vibrating; with converters whose step is fine, equal to the noise,
    /// and coarse.
    #[test]
    fn healthy_channels_are_not_frozen() {
        let motions: [fn(u64) -> f64; 3] = [
            |_| 0.0,
            |n| 30.0 * (n as f64 * 1e-4).sin(),
            |n| if n % 20_000 < 10_000 { 6.0 * (n as f64 * 1.2566).sin() } else { 0.3 },
        ];
        for noise in [21.8, 5.4, 1.0, 0.34, 0.2] {
            for motion in motions {
                let (mut detector, mut signals) =
                    (FrozenChannels::new(), Signals { motion, ..Signals::new(noise) });
                for n in 0..200_000 {
                    detector.push(signals.next(), [true; 3]);
                    assert_eq!(frozen(&detector), [0; 0], "noise {noise}, scan {n}");
                }
            }
        }
    }
}
