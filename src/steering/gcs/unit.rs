//! Comparison of the unit that an axis reports with the configured one.

use crate::config::NO_TILT;

/// Names of units of length, and their size in micrometres. Case and spelling in the answer to `PUN?` differ
/// between models. The micro sign comes in several encodings; these are the ones that remain after decoding.
const LENGTHS: [(&str, f64); 8] = [
    ("nm", 1e-3),
    ("um", 1.0),
    ("micron", 1.0),
    ("microns", 1.0),
    ("\u{b5}m", 1.0),
    ("\u{c2}\u{b5}m", 1.0),
    ("\u{ce}\u{bc}m", 1.0),
    ("mm", 1000.0),
];
/// Names of units of angle.
const ANGLES: [&str; 6] = ["rad", "mrad", "urad", "\u{b5}rad", "\u{c2}\u{b5}rad", "deg"];

/// The unit of an axis does not suit the configuration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum UnitError {
    /// The axis turns.
    #[error("axis {axis} turns (it counts in {unit}): {NO_TILT}")]
    Angle {
        /// Name of the axis.
        axis: String,
        /// The unit that the axis reports.
        unit: String,
    },
    /// `steering.gcs.um_per_unit` is wrong.
    #[error("axis {axis} counts in {unit}: steering.gcs.um_per_unit = {configured} should be {um}")]
    Length {
        /// Name of the axis.
        axis: String,
        /// The unit that the axis reports.
        unit: String,
        /// The configured size of the unit, micrometres.
        configured: f64,
        /// The size of the reported unit, micrometres.
        um: f64,
    },
}

/// Checks that positions of an axis in the unit `name` are in units of `um_per_unit`. An unknown name is
/// accepted.
///
/// # Errors
/// The axis is rotary, or the configured unit is wrong.
pub fn check(axis: &str, name: &str, um_per_unit: f64) -> Result<(), UnitError> {
    let lower = name.to_ascii_lowercase();
    if ANGLES.contains(&lower.as_str()) {
        return Err(UnitError::Angle { axis: axis.into(), unit: name.into() });
    }
    match LENGTHS.iter().find(|(known, _)| *known == lower) {
        Some(&(_, um)) if (um_per_unit / um - 1.0).abs() > 1e-6 => {
            let (axis, unit) = (axis.into(), name.into());
            Err(UnitError::Length { axis, unit, configured: um_per_unit, um })
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_compared_with_the_configuration() {
        for (name, um) in [("MM", 1000.0), ("um", 1.0), ("MICRON", 1.0), ("\u{b5}m", 1.0), ("count", 0.3)] {
            assert_eq!(check("1", name, um), Ok(()), "{name}");
        }
        let error = |axis, name, um| check(axis, name, um).unwrap_err().to_string();
        assert!(error("2", "mm", 1.0).contains("axis 2 counts in mm"));
        assert!(error("2", "\u{c2}\u{b5}m", 1000.0).contains("should be 1"));
        assert!(error("1", "URAD", 1.0).contains("translated"));
    }
}
