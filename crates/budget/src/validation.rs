//! Validation of the law of propagation by the Monte Carlo method (JCGM 101, clause 8).

use crate::Interval;

/// The numerical tolerance of a standard uncertainty that is stated with this number of significant digits: half a
/// unit of the last of them (JCGM 101, 7.9.2). NaN unless the uncertainty is positive and finite.
pub fn tolerance(std: f64, digits: i32) -> f64 {
    if !(std > 0.0 && std.is_finite()) {
        return f64::NAN;
    }
    let unit = |exponent: i32| 10.0_f64.powi(exponent - digits + 1);
    let exponent = std.log10().floor() as i32;
    // 0.999 is 1.0 with two digits: the unit of its last digit is ten times larger.
    let rounded = (std / unit(exponent)).round() * unit(exponent);
    let carried = rounded >= 10.0_f64.powi(exponent + 1) * (1.0 - 1e-12);
    0.5 * unit(if carried { exponent + 1 } else { exponent })
}

/// The result of a validation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Both ends of the intervals agree within the tolerance.
    Validated,
    /// An end differs by more than the tolerance.
    NotValidated,
    /// The number of trials is too small to decide: the scatter of the ends reaches across the tolerance.
    Undecided,
}

/// The comparison of two coverage intervals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Validation {
    /// Difference of the lower ends.
    pub low: f64,
    /// Difference of the upper ends.
    pub high: f64,
    /// Largest difference with which the law of propagation is validated.
    pub tolerance: f64,
    /// Two standard deviations of an end of the Monte Carlo interval.
    pub scatter: f64,
    /// The result.
    pub verdict: Verdict,
}

impl Validation {
    /// Compares `estimate` plus and minus `expanded` with the interval of the Monte Carlo method, whose ends have a
    /// scatter (two standard deviations).
    pub fn new(estimate: f64, expanded: f64, interval: Interval, scatter: f64, tolerance: f64) -> Self {
        let low = (estimate - expanded - interval.low).abs();
        let high = (estimate + expanded - interval.high).abs();
        let worst = low.max(high);
        let verdict = if worst + scatter <= tolerance {
            Verdict::Validated
        } else if worst - scatter > tolerance {
            Verdict::NotValidated
        } else {
            Verdict::Undecided
        };
        Self { low, high, tolerance, scatter, verdict }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tolerance_is_half_a_unit_of_the_last_digit() {
        // JCGM 101, 7.9.2, examples: 0.000 35 g gives 0.000 005 g with two digits; 2 K gives 0.5 K with one.
        for (std, digits, expected) in [
            (0.00035, 2, 0.000_005),
            (2.0, 1, 0.5),
            (2.0, 2, 0.05),
            (32.0, 2, 0.5),
            (0.0999, 2, 0.005),
            (10.0, 2, 0.5),
        ] {
            let delta = tolerance(std, digits);
            assert!((delta / expected - 1.0).abs() < 1e-9, "{std} {digits}: {delta}");
        }
        assert!(tolerance(0.0, 2).is_nan() && tolerance(f64::NAN, 2).is_nan());
    }

    #[test]
    fn a_scatter_across_the_tolerance_leaves_the_question_open() {
        let interval = Interval { low: -2.0, high: 2.03 };
        let verdict = |scatter, tolerance| Validation::new(0.0, 2.0, interval, scatter, tolerance).verdict;
        assert_eq!(verdict(0.01, 0.05), Verdict::Validated);
        assert_eq!(verdict(0.01, 0.015), Verdict::NotValidated);
        assert_eq!(verdict(0.04, 0.05), Verdict::Undecided);
        assert_eq!(verdict(0.01, f64::NAN), Verdict::Undecided);
    }
}
