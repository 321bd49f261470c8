//! Slow pointing of the laser: a drift of the beam that the readback of the stage does not show.

use rand::RngExt;
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

/// An Ornstein-Uhlenbeck process on each axis: normally distributed, correlated over a given time.
#[derive(Clone, Debug)]
pub struct Pointing {
    /// Standard deviation, metres.
    sigma: f64,
    /// Part of the position that remains from one scan to the next.
    remains: f64,
    at: [f64; 2],
    random: Pcg64,
}

impl Pointing {
    /// A drift with the standard deviation `sigma` (metres), correlated over `time_s` seconds, in scans of
    /// `period_s` seconds. It begins at a random position of the same distribution.
    pub fn new(sigma: f64, time_s: f64, period_s: f64, mut random: Pcg64) -> Self {
        let at = std::array::from_fn(|_| sigma * random.sample::<f64, _>(StandardNormal));
        Self { sigma, remains: (-period_s / time_s).exp(), at, random }
    }

    /// The displacement of the beam in the next scan, metres. Goes on to the scan after it.
    pub fn advance(&mut self) -> [f64; 2] {
        let at = self.at;
        if self.sigma > 0.0 {
            let step = self.sigma * (1.0 - self.remains * self.remains).sqrt();
            self.at = at.map(|x| self.remains * x + step * self.random.sample::<f64, _>(StandardNormal));
        }
        at
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn the_drift_has_its_size_and_its_correlation_time() {
        let mut pointing = Pointing::new(2e-6, 0.1, 1e-3, Pcg64::seed_from_u64(4));
        let all: Vec<f64> = (0..400_000).map(|_| pointing.advance()[0]).collect();
        let mean = |pairs: &mut dyn Iterator<Item = f64>| pairs.sum::<f64>() / all.len() as f64;
        let square = mean(&mut all.iter().map(|x| x * x));
        assert!((square.sqrt() / 2e-6 - 1.0).abs() < 0.05, "{square:e}");
        let later = mean(&mut all.iter().zip(&all[100..]).map(|(a, b)| a * b));
        assert!((later / square - (-1.0_f64).exp()).abs() < 0.1, "{later:e}");
    }

    #[test]
    fn without_a_size_there_is_none() {
        let mut pointing = Pointing::new(0.0, 10.0, 1e-3, Pcg64::seed_from_u64(4));
        assert!((0..100).all(|_| pointing.advance() == [0.0; 2]));
    }
}
