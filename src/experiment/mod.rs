//! The experiment of the paper: each axis is moved in small steps, with fifty readings at each point, and
//! the readings are compared with a reference.
//!
//! - [`protocol`]: the points of the measurement. [`quantity`], [`reference`](mod@reference): input from
//!   the interferometer.
//! - [`observation`], [`reading`]: values of the sensor and their file.
//! - [`statistics`], [`static_record`], [`allan`](mod@allan), [`fit`]: evaluation.
//! - [`twin`], [`live`]: sources of readings.
//! - [`table`], [`report`]: output.

pub mod allan;
pub mod fit;
pub mod live;
pub mod observation;
pub mod protocol;
pub mod quantity;
pub mod reading;
pub mod reference;
pub mod report;
pub mod static_record;
pub mod statistics;
pub mod table;
pub mod twin;

/// Formats a number with three significant digits.
pub fn three(x: f64) -> String {
    if !x.is_finite() {
        return "-".into();
    }
    // Rounded first: 0.9999 becomes 1.00, which has one digit before the point.
    let rounded: f64 = format!("{x:.2e}").parse().unwrap_or(x);
    let whole = if rounded == 0.0 { 1 } else { rounded.abs().log10().floor() as i32 + 1 };
    if whole > 6 {
        return format!("{x:.2e}");
    }
    format!("{x:.*}", (3 - whole).clamp(0, 9) as usize)
}

/// Formats a position in um or urad with its sign: two decimal places, or three significant digits if these
/// would show too few.
pub fn place(x: f64) -> String {
    let few = x != 0.0 && !(0.1..1e6).contains(&x.abs());
    let sign = if few && x > 0.0 { "+" } else { "" };
    if few { format!("{sign}{}", three(x)) } else { format!("{x:+.2}") }
}

#[cfg(test)]
mod tests {
    use super::{place, three};

    #[test]
    fn numbers_have_three_significant_digits() {
        let all = [0.0, 0.9999, -0.030_49, 9.996, 28.84, 309.6, 12_345.6, f64::NAN].map(three);
        assert_eq!(all, ["0.00", "1.00", "-0.0305", "10.0", "28.8", "310", "12346", "-"]);
        assert_eq!(three(-1e300), "-1.00e300");
        let all = [0.0, -14.4, 0.0028, -0.000_5, 309.0, 1e300].map(place);
        assert_eq!(all, ["+0.00", "-14.40", "+0.00280", "-0.000500", "+309.00", "+1.00e300"]);
    }
}
