//! Comparison of the unit that an axis reports with the configured one.

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

/// Checks that positions of an axis in the unit `name` are in units of `um_per_unit`. An unknown name is
/// accepted.
///
/// # Errors
/// The axis is rotary, or the configured unit is wrong.
pub fn check(axis: &str, name: &str, um_per_unit: f64) -> Result<(), String> {
    let lower = name.to_ascii_lowercase();
    if ANGLES.contains(&lower.as_str()) {
        return Err(format!("axis {axis} turns (it counts in {name}): {}", crate::config::NO_TILT));
    }
    match LENGTHS.iter().find(|(known, _)| *known == lower) {
        Some((_, um)) if (um_per_unit / um - 1.0).abs() > 1e-6 => Err(format!(
            "axis {axis} counts in {name}: steering.gcs.um_per_unit = {um_per_unit} should be {um}"
        )),
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
        assert!(check("2", "mm", 1.0).unwrap_err().contains("axis 2 counts in mm"));
        assert!(check("2", "\u{c2}\u{b5}m", 1000.0).unwrap_err().contains("should be 1"));
        assert!(check("1", "URAD", 1.0).unwrap_err().contains("translated"));
    }
}
