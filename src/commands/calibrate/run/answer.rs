//! An answer of the reference: six numbers.

/// Largest translation, metres, and rotation, radians.
const LARGEST: [f64; 2] = [0.05, 0.5];
const NAMES: [&str; 6] = ["tx", "ty", "tz", "roll", "pitch", "yaw"];

/// Why a text is not a pose.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(super) enum AnswerError {
    /// Another number of fields.
    #[error("{found} fields where six numbers are expected: tx, ty, tz, roll, pitch, yaw")]
    Count {
        /// Number of fields.
        found: usize,
    },
    /// A field is not a number.
    #[error("{name} is \"{text}\": allowed is a finite number, or - if it is not measured")]
    Number {
        /// Name of the coordinate.
        name: &'static str,
        /// The field.
        text: String,
    },
    /// A number is out of range.
    #[error("{name} is {text} {unit}: allowed is -{largest} to {largest} {unit}")]
    Range {
        /// Name of the coordinate.
        name: &'static str,
        /// The field.
        text: String,
        /// The unit.
        unit: &'static str,
        /// The limit.
        largest: f64,
    },
}

/// The unit of the numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unit {
    /// Metres and radians.
    Si,
    /// Micrometres and microradians.
    Micro,
}

/// Six numbers, separated by commas, semicolons or blanks; `-`: not measured, NaN. In metres and radians.
pub(super) fn parse(text: &str, unit: Unit) -> Result<[f64; 6], AnswerError> {
    let separated = |c: char| c == ',' || c == ';' || c.is_whitespace();
    let fields: Vec<&str> = text.split(separated).filter(|field| !field.is_empty()).collect();
    let mut pose = [f64::NAN; 6];
    if fields.len() != pose.len() {
        return Err(AnswerError::Count { found: fields.len() });
    }
    for (i, (x, field)) in pose.iter_mut().zip(&fields).enumerate() {
        if *field == "-" {
            continue;
        }
        let (name, text) = (NAMES[i], (*field).to_owned());
        let Some(number) = field.parse().ok().filter(|x: &f64| x.is_finite()) else {
            return Err(AnswerError::Number { name, text });
        };
        let scale = if unit == Unit::Micro { 1e-6 } else { 1.0 };
        let largest = LARGEST[i / 3] / scale;
        if number.abs() > largest {
            let unit = [["m", "rad"], ["um", "urad"]][usize::from(unit == Unit::Micro)][i / 3];
            return Err(AnswerError::Range {
                name,
                text,
                unit,
                largest: largest.round().max(LARGEST[i / 3]),
            });
        }
        *x = number * scale;
    }
    Ok(pose)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_have_six_numbers_in_range() {
        assert_eq!(parse("1e-3, 2e-3;0 0\t-1e-3 5e-3", Unit::Si), Ok([1e-3, 2e-3, 0.0, 0.0, -1e-3, 5e-3]));
        let one = parse("- - 12.5 - - -", Unit::Micro).unwrap();
        assert!(one[0].is_nan() && (one[2] - 12.5e-6).abs() < 1e-18);
        assert!(parse("- - - - - -", Unit::Si).unwrap().iter().all(|x| x.is_nan()), "free motion");
        for (text, expected) in [
            ("", "0 fields where six numbers"),
            ("1e-3 2e-3 0 0 0", "5 fields where six numbers"),
            ("here 0 0 0 0 0", "tx is \"here\": allowed is a finite number"),
            ("0 0 0 0 0 nan", "yaw is \"nan\""),
            ("0 0 0 0 inf 0", "pitch is \"inf\""),
            ("0 1.5 0 0 0 0", "ty is 1.5 m: allowed is -0.05 to 0.05 m"),
        ] {
            let error = parse(text, Unit::Si).unwrap_err().to_string();
            assert!(error.contains(expected), "{text}: {error}");
        }
        let error = parse("0 0 0 0 0 1e6", Unit::Micro).unwrap_err().to_string();
        assert!(error.contains("yaw is 1e6 urad: allowed is -500000 to 500000 urad"), "{error}");
    }
}
