//! Trend of a slowly varying number.

use std::collections::VecDeque;

use trifacet_core::time::Mono;

/// Most values used: ten minutes at one value per second.
const MOST: usize = 600;
/// Fewest values from which a trend is computed.
const LEAST: usize = 10;

/// Slope of the straight line through the last values.
#[derive(Clone, Debug, Default)]
pub struct Trend(VecDeque<(Mono, f64)>);

impl Trend {
    /// Adds a value with its time.
    pub fn push(&mut self, at: Mono, value: f64) {
        if self.0.len() == MOST {
            self.0.pop_front();
        }
        self.0.push_back((at, value));
    }

    /// Change per second, by least squares; `None` while there are too few values.
    pub fn per_second(&self) -> Option<f64> {
        let (origin, _) = *self.0.front()?;
        if self.0.len() < LEAST {
            return None;
        }
        let n = self.0.len() as f64;
        let points = || self.0.iter().map(|(at, value)| (at.seconds_since(origin), value));
        let (sum_t, sum_value) = points().fold((0.0, 0.0), |(t, v), (at, value)| (t + at, v + value));
        let (mean_t, mean_value) = (sum_t / n, sum_value / n);
        let (mut square, mut product) = (0.0, 0.0);
        for (t, value) in points() {
            square += (t - mean_t).powi(2);
            product += (t - mean_t) * (value - mean_value);
        }
        (square > 0.0).then(|| product / square)
    }
}

#[cfg(test)]
mod tests {
    use trifacet_core::time::NS_PER_S;

    use super::*;

    #[test]
    fn the_slope_is_that_of_the_last_values() {
        let mut trend = Trend::default();
        for t in 0..700 {
            let value = if t < 100 { 9.0 } else { 1.0 - 2e-3 * t as f64 };
            trend.push(Mono(t * NS_PER_S), value);
            assert_eq!(trend.per_second().is_none(), t < 9, "{t}");
        }
        assert!((trend.per_second().unwrap() + 2e-3).abs() < 1e-12);
    }
}
