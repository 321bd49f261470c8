//! Allan deviation and drift of a record at rest.
//!
//! The Allan deviation for an averaging time tau is the rms difference of adjacent means over tau, divided
//! by the square root of two. For white noise it is sigma / sqrt(n), like the standard deviation of a mean.
//! Drift makes it rise again; its minimum is at the longest averaging time that reduces the error.

use super::fit::{Slope, slope};

/// The Allan deviation for one averaging time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Allan {
    /// Number of readings per mean.
    pub n: usize,
    /// The Allan deviation, in the unit of the record.
    pub deviation: f64,
    /// Relative standard uncertainty of the Allan deviation, from the limited number of differences.
    pub part: f64,
}

/// The overlapping Allan deviation of equally spaced readings, for means of 1, 2, 4, ... readings.
///
/// The longest means are an eighth of the record; for longer ones there are too few differences.
pub fn allan(readings: &[f64]) -> Vec<Allan> {
    let mean = readings.iter().sum::<f64>() / readings.len() as f64;
    let mut sums = vec![0.0];
    let mut sum = 0.0;
    for x in readings {
        sum += x - mean;
        sums.push(sum);
    }
    let lengths = std::iter::successors(Some(1), |n| Some(2 * n)).take_while(|n| 8 * n <= readings.len());
    lengths.map(|n| over(&sums, n)).collect()
}

fn over(sums: &[f64], n: usize) -> Allan {
    let pairs = sums.len() - 2 * n;
    let difference = |i: usize| (sums[i + 2 * n] - 2.0 * sums[i + n] + sums[i]) / n as f64;
    let square = (0..pairs).map(|i| difference(i).powi(2)).sum::<f64>() / pairs as f64;
    // Degrees of freedom of overlapping differences of white noise (Howe, Allan and Barnes, 1981).
    let (all, m) = (sums.len() as f64, n as f64);
    let freedom = (1.5 * (all - 1.0) / m - 2.0 * (all - 2.0) / all) * 4.0 * m * m / (4.0 * m * m + 5.0);
    Allan { n, deviation: (square / 2.0).sqrt(), part: 1.0 / (2.0 * freedom).sqrt() }
}

/// The drift of a record: slope per second. `times`: seconds.
pub fn drift(times: &[f64], readings: &[f64]) -> Slope {
    slope(times, readings)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;

    use super::*;

    fn white(n: usize, sigma: f64) -> Vec<f64> {
        let mut random = rand_pcg::Pcg64::seed_from_u64(4);
        (0..n).map(|_| sigma * random.sample::<f64, _>(StandardNormal)).collect()
    }

    #[test]
    fn white_noise_falls_with_the_root_of_the_number() {
        let all = allan(&white(100_000, 2.0));
        assert_eq!(all.len(), 14); // 1 to 8192 of 100 000
        for a in &all {
            let theory = 2.0 / (a.n as f64).sqrt();
            assert!((a.deviation / theory - 1.0).abs() < 3.5 * a.part, "{a:?}, {theory}");
        }
        assert!(all[0].part < 0.004);
    }

    #[test]
    fn the_scatter_is_as_stated() {
        // Over many records, the deviation for 16 readings scatters by the stated relative uncertainty.
        let x = white(400 * 512, 1.0);
        let found: Vec<Allan> = x.chunks(512).map(|chunk| allan(chunk)[4]).collect();
        let n = found.len() as f64;
        let mean = found.iter().map(|a| a.deviation).sum::<f64>() / n;
        let scatter = (found.iter().map(|a| (a.deviation - mean).powi(2)).sum::<f64>() / n).sqrt() / mean;
        assert!((scatter / found[0].part - 1.0).abs() < 0.1, "{scatter} {}", found[0].part);
    }

    #[test]
    fn a_ramp_rises_with_the_time_and_is_the_drift() {
        let x: Vec<f64> = (0..1024).map(|k| 3.0 * f64::from(k)).collect();
        for a in allan(&x) {
            assert!((a.deviation - 3.0 * a.n as f64 / 2.0_f64.sqrt()).abs() < 1e-6 * a.deviation, "{a:?}");
        }
        let times: Vec<f64> = (0..1024).map(|k| 0.01 * f64::from(k)).collect();
        let found = drift(&times, &x);
        assert!((found.value - 300.0).abs() < 1e-9 && found.sigma < 1e-6);
    }
}
