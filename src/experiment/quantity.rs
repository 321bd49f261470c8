//! Parses lengths and angles with units.

use crate::config::Axis;
use crate::text::table::plain;

const LENGTHS: &[(&str, f64)] = &[("um", 1e-6), ("µm", 1e-6), ("nm", 1e-9), ("mm", 1e-3), ("m", 1.0)];
const ANGLES: &[(&str, f64)] = &[
    ("urad", 1e-6),
    ("µrad", 1e-6),
    ("nrad", 1e-9),
    ("mrad", 1e-3),
    ("rad", 1.0),
    ("arcsec", std::f64::consts::PI / 648_000.0),
];

fn units(axis: Axis) -> &'static [(&'static str, f64)] {
    if axis.is_turn() { ANGLES } else { LENGTHS }
}

/// The size of a unit in metres or radians. `None`: not a unit for this axis.
pub fn unit(axis: Axis, name: &str) -> Option<f64> {
    let name = name.replace('\u{3bc}', "µ"); // Greek mu (U+03BC) looks like the micro sign
    units(axis).iter().find(|(unit, _)| *unit == name).map(|(_, si)| *si)
}

/// The units for an axis, for messages.
pub fn allowed(axis: Axis) -> String {
    let names: Vec<_> = units(axis).iter().map(|(name, _)| *name).filter(|name| name.is_ascii()).collect();
    names.join(", ")
}

/// Why a text is not a length or an angle.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum QuantityError {
    /// The number is invalid.
    #[error(
        "\"{text}\" is not a number in {}, such as -14.40; another unit can follow the number: {}",
        axis.micro_unit(), allowed(*axis)
    )]
    Number {
        /// The axis.
        axis: Axis,
        /// The text.
        text: String,
    },
    /// The unit is not one for the axis.
    #[error("\"{unit}\" is not a unit for {}: allowed are {}", axis.name(), allowed(*axis))]
    Unit {
        /// The axis.
        axis: Axis,
        /// The unit.
        unit: String,
    },
}

/// Parses "-14.40", which is in um or urad, or "-0.0144 mm". Returns metres or radians.
///
/// # Errors
/// Fails if the number or the unit is not valid. The message states what is allowed.
pub fn parse(axis: Axis, text: &str) -> Result<f64, QuantityError> {
    let text = text.trim();
    let end = text.rfind(|c: char| c.is_ascii_digit() || c == '.').map_or(0, |last| last + 1);
    let (number, name) = (text[..end].trim(), text[end..].trim());
    let value = plain(number).parse().ok().filter(|x: &f64| x.is_finite());
    let value = value.ok_or_else(|| QuantityError::Number { axis, text: text.to_owned() })?;
    let name = if name.is_empty() { axis.micro_unit() } else { name };
    let si = unit(axis, name).ok_or_else(|| QuantityError::Unit { axis, unit: name.to_owned() })?;
    Ok(value * si)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_the_axis_unit_or_their_own() {
        let near = |a: Result<f64, QuantityError>, b: f64| assert!((a.unwrap() - b).abs() < 1e-18);
        near(parse(Axis::Tx, " -14.40\n"), -14.4e-6);
        near(parse(Axis::Tx, "0.5 mm"), 0.5e-3);
        near(parse(Axis::Tz, "12µm"), 12e-6);
        near(parse(Axis::Tz, "\u{2212}12 \u{3bc}m"), -12e-6);
        near(parse(Axis::Roll, "1e2"), 100e-6);
        near(parse(Axis::Yaw, "1arcsec"), std::f64::consts::PI / 648_000.0);
        for (axis, bad, expected) in [
            (Axis::Tx, "", "not a number in um"),
            (Axis::Tx, "1,44", "not a number"),
            (Axis::Tx, "inf", "not a number"),
            (Axis::Tx, "3 urad", "allowed are um, nm, mm, m"),
            (Axis::Roll, "3 um", "not a unit for roll"),
        ] {
            let error = parse(axis, bad).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
