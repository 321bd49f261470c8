//! Means over blocks of consecutive samples.

use serde::{Deserialize, Serialize};

use super::power_step::Power;
use crate::signals::{PsdState, Sample};

/// The samples of the current block.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Block {
    first: Option<Sample>,
    count: u16,
    spots: [f64; 6],
    powers: [f64; 3],
    steering: Option<[f64; 2]>,
    /// Sum of the times since the first sample, nanoseconds.
    time: i64,
    psds: [PsdState; 3],
    lost: u32,
    gap: bool,
    power: Power,
    output_railed: bool,
}

/// A complete block. Its signals are those of a single sample, with less noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mean {
    /// Means of the signals; the index is that of the last sample, the losses are the sum.
    pub sample: Sample,
    /// Number of samples in the block.
    pub count: u16,
    /// Samples were lost inside the block, so that the mean is not over equally spaced samples.
    pub gap: bool,
    /// The worst state of the laser power.
    pub power: Power,
}

impl Block {
    /// Adds a sample with the state of its total power; returns the block when it has `size` samples.
    pub fn push(&mut self, sample: &Sample, power: Power, size: u16) -> Option<Mean> {
        if size <= 1 {
            return Some(Mean { sample: *sample, count: 1, gap: false, power });
        }
        let first = *self.first.get_or_insert(*sample);
        if self.count == 0 {
            self.steering = sample.steering.map(|_| [0.0; 2]);
        }
        self.power = self.power.max(power);
        self.gap |= self.count > 0 && sample.lost > 0;
        self.count += 1;
        self.time += sample.time - first.time;
        self.lost = self.lost.saturating_add(sample.lost);
        self.output_railed |= sample.output_railed;
        add(&mut self.spots, &sample.spots);
        add(&mut self.powers, &sample.powers);
        self.steering = self.steering.zip(sample.steering).map(|(sum, s)| [sum[0] + s[0], sum[1] + s[1]]);
        for (worst, state) in self.psds.iter_mut().zip(sample.psds) {
            if *worst == PsdState::Good {
                *worst = state;
            }
        }
        (self.count >= size).then(|| self.finish(first, sample))
    }

    fn finish(&mut self, first: Sample, last: &Sample) -> Mean {
        let block = std::mem::take(self);
        let n = f64::from(block.count);
        let sample = Sample {
            index: last.index,
            time: first.time + block.time / i64::from(block.count),
            time_sigma_ns: last.time_sigma_ns,
            lost: block.lost,
            spots: block.spots.map(|sum| sum / n),
            powers: block.powers.map(|sum| sum / n),
            psds: block.psds,
            steering: block.steering.map(|sum| sum.map(|s| s / n)),
            output_railed: block.output_railed,
            applied: last.applied,
            uncovered: false,
        };
        Mean { sample, count: block.count, gap: block.gap, power: block.power }
    }

    /// Discards the current block.
    pub fn clear(&mut self) {
        *self = Self::default();
    }
}

fn add<const N: usize>(sum: &mut [f64; N], x: &[f64; N]) {
    for (sum, x) in sum.iter_mut().zip(x) {
        *sum += x;
    }
}
