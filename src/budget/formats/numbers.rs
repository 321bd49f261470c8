//! Numbers as people read them.

/// The number with this number of significant digits, without an exponent if it is of a usual size.
pub fn significant(value: f64, digits: i32) -> String {
    if value == 0.0 {
        return "0".into();
    }
    if !value.is_finite() {
        return if value > 0.0 { "inf".into() } else { value.to_string() };
    }
    // By the rounded number: 0.0999 has the first digit of 0.10.
    let scientific = format!("{value:.*e}", (digits - 1).max(0) as usize);
    let Some((_, Ok(exponent))) = scientific.split_once('e').map(|(m, e)| (m, e.parse::<i32>())) else {
        return scientific;
    };
    match exponent {
        -6..0 => format!("{value:.*}", (digits - 1 - exponent).max(0) as usize),
        0..7 => {
            let rounded: f64 = scientific.parse().unwrap_or(value);
            format!("{rounded:.*}", (digits - 1 - exponent).max(0) as usize)
        }
        _ => scientific,
    }
}

/// The number with seven significant digits or more, without an exponent: a YAML parser takes `1e-6` for a text.
pub fn plain(value: f64) -> String {
    let decimals = if value == 0.0 { 1.0 } else { (7.0 - value.abs().log10().floor()).clamp(1.0, 30.0) };
    format!("{value:.*}", decimals as usize)
}

/// The number with as many decimals as an uncertainty with two significant digits has.
pub fn rounded_as(value: f64, uncertainty: f64) -> String {
    if !(uncertainty > 0.0 && uncertainty.is_finite()) {
        return significant(value, 6);
    }
    let decimals = significant(uncertainty, 2).split_once('.').map_or(0, |(_, d)| d.len());
    let text = format!("{value:.decimals$}");
    if text.trim_matches(['-', '0', '.']).is_empty() { text.trim_start_matches('-').into() } else { text }
}

/// The texts of a column, padded so that their decimal points are under each other.
pub fn aligned(column: &[String]) -> Vec<String> {
    let after = |text: &str| text.find('.').map_or(0, |at| text.len() - at);
    let numeric = |text: &str| text.ends_with(|c: char| c.is_ascii_digit());
    let most = column.iter().filter(|text| numeric(text)).map(|text| after(text)).max().unwrap_or(0);
    let pad = |text: &String| if numeric(text) { most - after(text) } else { 0 };
    column.iter().map(|text| format!("{text}{}", " ".repeat(pad(text)))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_significant_digits() {
        for (value, text) in [
            (0.912_87, "0.91"),
            (0.0999, "0.10"),
            (1.999, "2.0"),
            (23.6, "24"),
            (99.7, "100"),
            (1234.0, "1200"),
            (-0.014, "-0.014"),
            (0.0, "0"),
            (3e-9, "3.0e-9"),
            (f64::INFINITY, "inf"),
        ] {
            assert_eq!(significant(value, 2), text);
        }
        assert_eq!(
            [plain(0.912_871_234_5), plain(-1e-8), plain(0.0), plain(1e9)].join(" "),
            "0.91287123 -0.000000010000000 0.0 1000000000.0"
        );
        assert_eq!(rounded_as(1000.04, 0.0231), "1000.040");
        assert_eq!(rounded_as(-0.0001, 0.5), "0.00");
        assert_eq!(rounded_as(5.0, 0.0), "5.00000");
    }

    #[test]
    fn decimal_points_are_under_each_other() {
        let column = ["0.91", "12", "-", "0.0014"].map(String::from);
        assert_eq!(aligned(&column), ["0.91  ", "12     ", "-", "0.0014"]);
    }
}
