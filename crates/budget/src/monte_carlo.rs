//! Propagation of distributions by the Monte Carlo method (JCGM 101, clause 7), for several measurands.

use crate::validation::tolerance;
use crate::{Sampler, student};

/// Fewest trials of a batch (JCGM 101, 7.9.4 b).
const BATCH: usize = 10_000;

/// A coverage interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// When the trials end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stop {
    /// After this number of trials.
    After(usize),
    /// When estimate, standard uncertainty and interval of every measurand have settled within a fifth of the
    /// tolerance at this number of digits (JCGM 101, 7.9.4; a fifth: 8.2), but not after more than `most` trials.
    Settled {
        /// Significant digits of the standard uncertainty.
        digits: i32,
        /// Largest number of trials.
        most: usize,
    },
}

/// Results of the trials.
#[derive(Clone, Debug)]
pub struct MonteCarlo {
    /// Values of each measurand, in ascending order.
    sorted: Vec<Vec<f64>>,
    batches: Vec<Batches>,
    probability: f64,
    failed: usize,
    settled: bool,
}

/// Results of the single batches of a measurand: mean, standard deviation, ends of the symmetric interval.
#[derive(Clone, Debug, Default)]
struct Batches(Vec<[f64; 4]>);

impl MonteCarlo {
    /// Runs trials: draws the inputs, and computes the measurands with `model`, which writes one value per measurand
    /// and returns false where it has none (such a trial is counted and left out). `probability`: of the intervals.
    pub fn run(
        sampler: &mut Sampler,
        measurands: usize,
        probability: f64,
        stop: Stop,
        mut model: impl FnMut(&[f64], &mut [f64]) -> bool,
    ) -> Self {
        let (most, digits) = match stop {
            Stop::After(count) => (count, None),
            Stop::Settled { digits, most } => (most, Some(digits)),
        };
        let size = BATCH.max((100.0 / (1.0 - probability)).ceil() as usize);
        let mut all = Self {
            sorted: vec![Vec::new(); measurands],
            batches: vec![Batches::default(); measurands],
            probability,
            failed: 0,
            settled: false,
        };
        let (mut values, mut results, mut done) = (Vec::new(), vec![0.0; measurands], 0);
        while done < most && !all.settled {
            let count = size.min(most - done);
            let from = all.trials();
            for _ in 0..count {
                sampler.draw(&mut values);
                if model(&values, &mut results) && results.iter().all(|x| x.is_finite()) {
                    for (column, value) in all.sorted.iter_mut().zip(&results) {
                        column.push(*value);
                    }
                } else {
                    all.failed += 1;
                }
            }
            done += count;
            all.close_batch(from);
            all.settled = digits.is_some_and(|digits| all.has_settled(digits));
        }
        for column in &mut all.sorted {
            column.sort_by(f64::total_cmp);
        }
        all
    }

    /// Adds the results of the trials since `from`.
    fn close_batch(&mut self, from: usize) {
        for (column, batches) in self.sorted.iter().zip(&mut self.batches) {
            let mut batch = column[from..].to_vec();
            batch.sort_by(f64::total_cmp);
            if batch.len() > 1 {
                let interval = symmetric(&batch, self.probability);
                batches.0.push([mean(&batch), deviation(&batch), interval.low, interval.high]);
            }
        }
    }

    fn has_settled(&self, digits: i32) -> bool {
        self.batches.iter().all(|batches| {
            let std = mean(&batches.0.iter().map(|b| b[1]).collect::<Vec<_>>());
            let limit = tolerance(std, digits) / 5.0;
            batches.0.len() > 1 && (0..4).all(|part| 2.0 * batches.error(part) < limit)
        })
    }

    /// Number of trials with a result.
    pub fn trials(&self) -> usize {
        self.sorted.first().map_or(0, Vec::len)
    }

    /// Number of trials for which the model had no result.
    pub fn failed(&self) -> usize {
        self.failed
    }

    /// Whether all results have settled, see [`Stop::Settled`].
    pub fn settled(&self) -> bool {
        self.settled
    }

    /// The coverage probability of the intervals.
    pub fn probability(&self) -> f64 {
        self.probability
    }

    /// The estimate of a measurand: the mean.
    pub fn estimate(&self, measurand: usize) -> f64 {
        mean(&self.sorted[measurand])
    }

    /// The standard uncertainty of a measurand: the standard deviation.
    pub fn standard_uncertainty(&self, measurand: usize) -> f64 {
        deviation(&self.sorted[measurand])
    }

    /// The probabilistically symmetric coverage interval (JCGM 101, 7.7.1).
    pub fn symmetric(&self, measurand: usize) -> Interval {
        symmetric(&self.sorted[measurand], self.probability)
    }

    /// The shortest coverage interval (JCGM 101, 7.7.2 and 5.3.4).
    pub fn shortest(&self, measurand: usize) -> Interval {
        let sorted = &self.sorted[measurand];
        let within = held(sorted.len(), self.probability);
        let intervals = sorted.iter().zip(&sorted[within.min(sorted.len())..]);
        let shortest = intervals.min_by(|a, b| (a.1 - a.0).total_cmp(&(b.1 - b.0)));
        shortest.map_or(Interval { low: f64::NAN, high: f64::NAN }, |(low, high)| Interval {
            low: *low,
            high: *high,
        })
    }

    /// Two standard deviations of an end of the symmetric interval, from the scatter of the batches; with fewer than
    /// five batches, that of a normal distribution.
    pub fn scatter(&self, measurand: usize) -> f64 {
        let batches = &self.batches[measurand];
        if batches.0.len() >= 5 {
            return 2.0 * batches.error(2).max(batches.error(3));
        }
        let k = student::coverage_factor(self.probability, f64::INFINITY);
        let density = (-0.5 * k * k).exp() / std::f64::consts::TAU.sqrt();
        let tail = 0.5 * (1.0 - self.probability);
        let error = (tail * (1.0 - tail) / self.trials() as f64).sqrt() / density;
        2.0 * error * self.standard_uncertainty(measurand)
    }
}

impl Batches {
    /// Standard deviation of the mean of one of the results.
    fn error(&self, part: usize) -> f64 {
        let values: Vec<_> = self.0.iter().map(|batch| batch[part]).collect();
        deviation(&values) / (values.len() as f64).sqrt()
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn deviation(values: &[f64]) -> f64 {
    let mean = mean(values);
    (values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (values.len() as f64 - 1.0)).sqrt()
}

/// Number of steps between the ends of an interval among this number of sorted values.
fn held(count: usize, probability: f64) -> usize {
    (probability * count as f64 + 0.5).floor() as usize
}

fn symmetric(sorted: &[f64], probability: f64) -> Interval {
    let count = sorted.len();
    let within = held(count, probability);
    if count <= within {
        return Interval { low: f64::NAN, high: f64::NAN };
    }
    let first = (count - within) / 2;
    // Counted from 1, the ends are number r and r + q, with r = (M - q)/2 rounded up.
    let first = if (count - within).is_multiple_of(2) { first.max(1) } else { first + 1 };
    Interval { low: sorted[first - 1], high: sorted[first - 1 + within] }
}
