//! Student's t-distribution: probabilities and coverage factors.

/// Degrees of freedom beyond which the normal distribution is used: factors up to 3 differ by less than 1e-5, and
/// the logarithm of the gamma function loses its digits.
const NORMAL: f64 = 1e6;

/// The probability that a variable with Student's t-distribution is within plus and minus `t`.
pub fn coverage(t: f64, dof: f64) -> f64 {
    if dof > NORMAL {
        return libm::erf(t / std::f64::consts::SQRT_2);
    }
    1.0 - incomplete_beta(0.5 * dof, 0.5, dof / (dof + t * t))
}

/// The coverage factor of a two-sided interval: a variable with Student's t-distribution is within plus and minus
/// this with the given probability. NaN unless the probability is between 0 and 1 and `dof` is positive.
pub fn coverage_factor(probability: f64, dof: f64) -> f64 {
    if !(probability > 0.0 && probability < 1.0 && dof > 0.0) {
        return f64::NAN;
    }
    let (mut low, mut high) = (0.0, 1.0);
    while coverage(high, dof) < probability {
        low = high;
        high *= 2.0;
        if high > 1e100 {
            return f64::INFINITY;
        }
    }
    // A bisection to the last bit takes fewer than 60 steps in a binary interval.
    for _ in 0..64 {
        let middle = 0.5 * (low + high);
        if coverage(middle, dof) < probability { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// The regularised incomplete beta function, by its continued fraction (DLMF 8.17.22, evaluated after Lentz).
fn incomplete_beta(a: f64, b: f64, x: f64) -> f64 {
    if x <= 0.0 {
        return 0.0;
    }
    if x >= 1.0 {
        return 1.0;
    }
    // The fraction converges fast below the mean, the other side by symmetry.
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - incomplete_beta(b, a, 1.0 - x);
    }
    let front = libm::lgamma(a + b) - libm::lgamma(a) - libm::lgamma(b) + a * x.ln() + b * (-x).ln_1p();
    front.exp() * fraction(a, b, x) / a
}

fn fraction(a: f64, b: f64, x: f64) -> f64 {
    const TINY: f64 = 1e-300;
    let away = |y: f64| if y.abs() < TINY { TINY } else { y };
    let (mut c, mut d) = (1.0, 1.0 / away(1.0 - (a + b) * x / (a + 1.0)));
    let mut value = d;
    for i in 1..500 {
        let m = f64::from(i);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        let mut last = 1.0;
        for term in [even, odd] {
            d = 1.0 / away(1.0 + term * d);
            c = away(1.0 + term / c);
            last = c * d;
            value *= last;
        }
        if (last - 1.0).abs() < 1e-15 {
            break;
        }
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;

    /// JCGM 100, table G.2, all columns of some rows.
    #[test]
    fn the_factors_are_those_of_table_g_2() {
        let probabilities = [0.6827, 0.90, 0.95, 0.9545, 0.99, 0.9973];
        let table = [
            (1.0, [1.84, 6.31, 12.71, 13.97, 63.66, 235.80]),
            (2.0, [1.32, 2.92, 4.30, 4.53, 9.92, 19.21]),
            (5.0, [1.11, 2.02, 2.57, 2.65, 4.03, 5.51]),
            (16.0, [1.03, 1.75, 2.12, 2.17, 2.92, 3.54]),
            (50.0, [1.01, 1.68, 2.01, 2.05, 2.68, 3.16]),
            (100.0, [1.005, 1.660, 1.984, 2.025, 2.626, 3.077]),
            (f64::INFINITY, [1.000, 1.645, 1.960, 2.000, 2.576, 3.000]),
        ];
        for (dof, factors) in table {
            let decimals = if dof >= 100.0 { 3 } else { 2 };
            for (probability, factor) in probabilities.into_iter().zip(factors) {
                let k = coverage_factor(probability, dof);
                // Half a unit of the last digit. The column 0.6827 stands for 0.682 689, and so on.
                let limit = 0.51 * 0.1_f64.powi(decimals) + 2e-4 * k;
                assert!((k - factor).abs() < limit, "{dof} {probability}: {k}, printed {factor}");
            }
        }
    }

    #[test]
    fn coverage_is_the_inverse_and_large_numbers_agree_with_the_normal_distribution() {
        for dof in [0.7, 1.0, 3.5, 30.0, 1e4, 1e6, f64::INFINITY] {
            for probability in [0.1, 0.5, 0.95, 0.999] {
                let k = coverage_factor(probability, dof);
                assert!((coverage(k, dof) - probability).abs() < 1e-8, "{dof} {probability}");
            }
        }
        // One degree of freedom is the Cauchy distribution: an arc tangent.
        let cauchy = (std::f64::consts::FRAC_PI_2 * 0.95).tan();
        assert!((coverage_factor(0.95, 1.0) / cauchy - 1.0).abs() < 1e-10);
        assert!((coverage_factor(0.95, 1e6) - coverage_factor(0.95, f64::INFINITY)).abs() < 1e-5);
        assert!(coverage_factor(1.0, 5.0).is_nan() && coverage_factor(0.9, f64::NAN).is_nan());
    }
}
