//! Medians and straight lines.

/// The slope of a straight line fitted to points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slope {
    /// Slope: change of y per unit of x.
    pub value: f64,
    /// Standard uncertainty of the slope, from the scatter of the points about the line.
    pub sigma: f64,
}

/// The slope of the least-squares line of `y` on `x`. NaN if it is not defined.
pub fn slope(x: &[f64], y: &[f64]) -> Slope {
    let n = x.len() as f64;
    let (mx, my) = (x.iter().sum::<f64>() / n, y.iter().sum::<f64>() / n);
    let xx: f64 = x.iter().map(|x| (x - mx).powi(2)).sum();
    let xy: f64 = x.iter().zip(y).map(|(x, y)| (x - mx) * (y - my)).sum();
    let value = xy / xx;
    let left: f64 = x.iter().zip(y).map(|(x, y)| (y - my - value * (x - mx)).powi(2)).sum();
    Slope { value, sigma: (left / (n - 2.0) / xx).sqrt() }
}

/// The median; for an even number of values the mean of the middle two. NaN if there are no values.
pub fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    match sorted.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => sorted[middle],
        _ => f64::midpoint(sorted[middle - 1], sorted[middle]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_of_odd_and_even_numbers() {
        assert_eq!(median([3.0, 1.0, 2.0].into_iter()), 2.0);
        assert_eq!(median([4.0, 1.0, 2.0, 3.0].into_iter()), 2.5);
        assert!(median([].into_iter()).is_nan());
    }

    #[test]
    fn a_slope_has_the_standard_uncertainty_of_the_textbook() {
        // y = x with residuals 1, -2, 1: sum of squares 6, one degree of freedom, sum of (x - mean)^2 = 2.
        let slope = slope(&[0.0, 1.0, 2.0], &[1.0, -1.0, 3.0]);
        assert!(
            (slope.value - 1.0).abs() < 1e-12 && (slope.sigma - 3.0_f64.sqrt()).abs() < 1e-12,
            "{slope:?}"
        );
    }
}
