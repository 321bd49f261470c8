//! Slow checks of the light, which no single sample shows: the total power against a stored reference, and the
//! readings of the sum channels while the laser is blocked. Pure.

use crate::signals::{PsdState, Sample};
use crate::time::{Mono, NS_PER_S};

/// The total power is judged over this time, nanoseconds, ...
const SECOND: i64 = NS_PER_S;
/// ... and over this number of samples, at least.
const LEAST: u32 = 10;
/// A batch of readings without light has at least this many samples, ...
pub const DARK_LEAST: u32 = 20;
/// ... over at least this time, nanoseconds.
const DARK_TIME: i64 = NS_PER_S / 20;
/// Batches after which the darkest is judged. The first and the last may contain light, while something moves into
/// the beam or out of it.
const BATCHES: u32 = 3;
/// A reading without light is doubted above this part of the usual power of the PSD. 0.2 % draw a spot that is 1 mm
/// out by 2 um.
const DARK_LIMIT: f64 = 0.002;
/// A doubt ends below this part of its limit.
const AGAIN: f64 = 0.8;

/// The total power at the time at which the optics were known to be in order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PowerReference {
    /// Total power, watts.
    pub watts: f64,
    /// Relative difference beyond which the power is doubted.
    pub tolerance: f64,
}

/// The result of one second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PowerVerdict {
    /// Mean total power, watts.
    pub watts: f64,
    /// Its relative difference to the reference.
    pub difference: f64,
    /// The power differs by more than the tolerance, and has not returned to four fifths of it.
    pub doubted: bool,
}

/// The result of a time without light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DarkVerdict {
    /// Readings of the sum channels beyond the dark offsets, as parts of the usual power of PSD A, B, C.
    pub excess: [f64; 3],
    /// This usual power, watts.
    pub usual: [f64; 3],
    /// A reading is above its limit, and has not returned to four fifths of it.
    pub doubted: bool,
}

/// Sums of the powers over successive samples.
#[derive(Clone, Copy, Debug, Default)]
struct Batch {
    began: Option<Mono>,
    count: u32,
    sums: [f64; 3],
}

impl Batch {
    /// Adds a sample. Returns the mean powers when the batch has this many samples over this time.
    fn push(&mut self, sample: &Sample, least: u32, time: i64) -> Option<[f64; 3]> {
        let began = *self.began.get_or_insert(sample.time);
        self.count += 1;
        self.sums.iter_mut().zip(sample.powers).for_each(|(sum, power)| *sum += power);
        let over = self.count >= least && sample.time - began >= time;
        over.then(|| std::mem::take(self).mean())
    }

    fn mean(self) -> [f64; 3] {
        self.sums.map(|sum| sum / f64::from(self.count))
    }
}

/// Both checks over the samples of one source.
#[derive(Clone, Debug, Default)]
pub struct LightChecks {
    reference: Option<PowerReference>,
    lit: Batch,
    power_doubted: bool,
    /// Mean powers in the last complete second with light, watts.
    usual: Option<[f64; 3]>,
    dark: Batch,
    batches: u32,
    /// The batch with the least total power since the begin of the darkness.
    darkest: Option<[f64; 3]>,
    dark_doubted: bool,
}

impl LightChecks {
    /// The checks with this reference. Without one, the total power is not judged.
    pub fn new(reference: Option<PowerReference>) -> Self {
        Self { reference, ..Self::default() }
    }

    /// Takes the next sample. Returns what it completes.
    pub fn push(&mut self, sample: &Sample) -> (Option<PowerVerdict>, Option<DarkVerdict>) {
        let all = |state| sample.psds.iter().all(|psd| *psd == state);
        if !all(PsdState::Good) {
            self.lit = Batch::default();
        }
        if !all(PsdState::Low) {
            (self.dark, self.batches, self.darkest) = (Batch::default(), 0, None);
        }
        if all(PsdState::Good) {
            (self.lit.push(sample, LEAST, SECOND).and_then(|powers| self.power(powers)), None)
        } else if all(PsdState::Low) {
            (None, self.dark.push(sample, DARK_LEAST, DARK_TIME).and_then(|powers| self.darkness(powers)))
        } else {
            (None, None)
        }
    }

    fn power(&mut self, powers: [f64; 3]) -> Option<PowerVerdict> {
        self.usual = Some(powers);
        let PowerReference { watts, tolerance } = self.reference?;
        let total: f64 = powers.iter().sum();
        let difference = total / watts - 1.0;
        self.power_doubted = difference.abs() > tolerance * if self.power_doubted { AGAIN } else { 1.0 };
        Some(PowerVerdict { watts: total, difference, doubted: self.power_doubted })
    }

    fn darkness(&mut self, powers: [f64; 3]) -> Option<DarkVerdict> {
        let total = |powers: [f64; 3]| powers.iter().sum::<f64>();
        self.batches += 1;
        let darkest = self.darkest.filter(|darkest| total(*darkest) <= total(powers)).unwrap_or(powers);
        self.darkest = Some(darkest);
        let usual = self.usual.or(self.reference.map(|reference| [reference.watts / 3.0; 3]))?;
        if self.batches < BATCHES {
            return None;
        }
        let excess: [f64; 3] = std::array::from_fn(|psd| darkest[psd] / usual[psd]);
        let limit = DARK_LIMIT * if self.dark_doubted { AGAIN } else { 1.0 };
        self.dark_doubted = excess.iter().any(|part| *part > limit);
        Some(DarkVerdict { excess, usual, doubted: self.dark_doubted })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const USUAL: [f64; 3] = [2e-4; 3];

    /// A sample at 1 kHz with these powers, in parts of the usual ones.
    fn sample(index: u64, parts: [f64; 3]) -> Sample {
        let state = |part: f64| if part < 0.017 { PsdState::Low } else { PsdState::Good };
        Sample {
            index,
            time: Mono(index as i64 * 1_000_000),
            time_sigma_ns: None,
            lost: 0,
            spots: [0.0; 6],
            powers: std::array::from_fn(|psd| USUAL[psd] * parts[psd]),
            psds: parts.map(state),
            steering: None,
            output_railed: false,
            applied: None,
            uncovered: false,
        }
    }

    fn checks() -> LightChecks {
        LightChecks::new(Some(PowerReference { watts: 6e-4, tolerance: 0.05 }))
    }

    /// The powers of samples from `from` on: all verdicts.
    fn powers(checks: &mut LightChecks, from: u64, count: u64, part: f64) -> Vec<PowerVerdict> {
        (from..from + count).filter_map(|k| checks.push(&sample(k, [part; 3])).0).collect()
    }

    fn darkness(checks: &mut LightChecks, from: u64, count: u64, parts: [f64; 3]) -> Vec<DarkVerdict> {
        (from..from + count).filter_map(|k| checks.push(&sample(k, parts)).1).collect()
    }

    #[test]
    fn the_power_is_doubted_beyond_its_tolerance_until_it_is_clearly_within() {
        let mut checks = checks();
        let mut doubted = |from, part| {
            let verdicts = powers(&mut checks, from, 1001, part);
            assert_eq!(verdicts.len(), 1);
            assert!((verdicts[0].difference - (part - 1.0)).abs() < 1e-9);
            verdicts[0].doubted
        };
        let parts = [1.0, 0.96, 0.94, 0.955, 0.97, 1.045, 1.06];
        let seen: Vec<_> = (0..).zip(parts).map(|(k, part)| doubted(2000 * k, part)).collect();
        assert_eq!(seen, [false, false, true, true, false, false, true]);
    }

    #[test]
    fn without_a_reference_and_with_interrupted_light_nothing_is_judged() {
        let mut without = LightChecks::default();
        assert!(powers(&mut without, 0, 5000, 0.5).is_empty());
        let mut blinking = checks();
        for k in 0..5000 {
            let part = if k % 900 == 0 { 0.0 } else { 0.9 };
            assert_eq!(blinking.push(&sample(k, [part; 3])).0, None);
        }
    }

    #[test]
    fn the_darkest_batch_is_judged_from_the_third_on() {
        let mut checks = checks();
        powers(&mut checks, 0, 1001, 1.0);
        assert!(darkness(&mut checks, 2000, 150, [0.01; 3]).is_empty());
        // Something moves out of the beam: the last batch is brighter.
        let verdicts =
            [darkness(&mut checks, 2150, 10, [0.004, 0.0, 0.0]), darkness(&mut checks, 2160, 60, [0.016; 3])]
                .concat();
        let last = verdicts.last().unwrap();
        assert!(last.doubted && last.excess.iter().all(|part| *part < 0.0101), "{verdicts:?}");
        powers(&mut checks, 3000, 1001, 1.0);
        let verdicts = darkness(&mut checks, 5000, 200, [0.0018, 0.0, -0.001]);
        assert!(verdicts.iter().all(|verdict| verdict.doubted), "not yet below four fifths: {verdicts:?}");
        powers(&mut checks, 6000, 1001, 1.0);
        let verdicts = darkness(&mut checks, 8000, 200, [0.001; 3]);
        assert!(!verdicts.is_empty() && verdicts.iter().all(|verdict| !verdict.doubted));
    }

    #[test]
    fn a_single_dark_psd_is_no_darkness() {
        let mut checks = checks();
        powers(&mut checks, 0, 1001, 1.0);
        assert!(darkness(&mut checks, 2000, 2000, [0.01, 0.01, 1.0]).is_empty());
    }
}
