//! The paper's experiment: each axis moved in small intervals, fifty readings at each point, held against a
//! reference.
//!
//! - [`protocol`]: what is measured where. [`quantity`], [`reference`](mod@reference): the interferometer.
//! - [`observation`], [`reading`]: what was read, and its file. [`statistics`], [`static_record`], [`allan`](mod@allan), [`fit`]: what it says.
//! - [`twin`], [`live`]: where readings come from.
//! - [`table`], [`report`]: how it is told.

pub mod allan;
pub mod csv_input;
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

/// A number with three digits that count, for people.
pub fn three(x: f64) -> String {
    if !x.is_finite() {
        return "-".into();
    }
    // Rounded first: 0.9999 has one digit before the point.
    let rounded: f64 = format!("{x:.2e}").parse().unwrap_or(x);
    let whole = if rounded == 0.0 { 1 } else { rounded.abs().log10().floor() as i32 + 1 };
    if whole > 6 {
        return format!("{x:.2e}");
    }
    format!("{x:.*}", (3 - whole).clamp(0, 9) as usize)
}

/// Where something is, in um or urad, with its sign: two digits behind the point, and three that count where these say
/// nothing.
pub fn place(x: f64) -> String {
    let few = x != 0.0 && !(0.1..1e6).contains(&x.abs());
    let sign = if few && x > 0.0 { "+" } else { "" };
    if few { format!("{sign}{}", three(x)) } else { format!("{x:+.2}") }
}

#[cfg(test)]
mod tests {
    use super::{place, three};

    #[test]
    fn three_digits_count() {
        let all = [0.0, 0.9999, -0.030_49, 9.996, 28.84, 309.6, 12_345.6, f64::NAN].map(three);
        assert_eq!(all, ["0.00", "1.00", "-0.0305", "10.0", "28.8", "310", "12346", "-"]);
        assert_eq!(three(-1e300), "-1.00e300");
        let all = [0.0, -14.4, 0.0028, -0.000_5, 309.0, 1e300].map(place);
        assert_eq!(all, ["+0.00", "-14.40", "+0.00280", "-0.000500", "+309.00", "+1.00e300"]);
    }
}
