//! What only the laboratory knows, as TOML.

use jiff::civil::Date;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The file with every key explained; fits [`Laboratory`].
pub const TEMPLATE: &str = include_str!("laboratory.toml");

/// What the laboratory states. Every key may be absent; [`Laboratory::missing`] names those that a certificate needs.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct Laboratory {
    /// The document.
    pub certificate: Document,
    /// Who calibrates.
    pub laboratory: Party,
    /// Who ordered the calibration.
    pub customer: Party,
    /// The head.
    pub item: Item,
    /// Where and when the points were measured.
    pub calibration: Measurement,
    /// What measured the poses.
    pub reference: Reference,
    /// The conditions during the measurement.
    pub environment: Environment,
}

/// The document.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct Document {
    /// Unique identification.
    pub number: Option<String>,
    /// Date of issue, YYYY-MM-DD.
    pub issued: Option<String>,
    /// Who authorizes it.
    pub authorized_by: Vec<Person>,
    /// Deviations from the method, or anything else; optional.
    pub remarks: Option<String>,
}

/// A person that authorizes.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct Person {
    /// Name.
    pub name: Option<String>,
    /// Function in the laboratory.
    pub function: Option<String>,
}

/// Laboratory or customer.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct Party {
    /// Name.
    pub name: Option<String>,
    /// Street and number.
    pub street: Option<String>,
    /// Postal code.
    pub post_code: Option<String>,
    /// City.
    pub city: Option<String>,
    /// Country, two letters of ISO 3166-1.
    pub country: Option<String>,
    /// Number of the accreditation; optional, for the laboratory only.
    pub accreditation: Option<String>,
}

/// The head that was calibrated.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct Item {
    /// What it is.
    pub description: Option<String>,
    /// Its maker.
    pub manufacturer: Option<String>,
    /// Its type.
    pub model: Option<String>,
    /// Its serial number.
    pub serial_number: Option<String>,
    /// Its condition, where that matters; optional.
    pub condition: Option<String>,
    /// Date of receipt, YYYY-MM-DD.
    pub received: Option<String>,
}

/// Where and when the points were measured.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct Measurement {
    /// One of [`PLACES`].
    pub place: Option<String>,
    /// Address or room; optional.
    pub place_detail: Option<String>,
    /// First day, YYYY-MM-DD.
    pub begun: Option<String>,
    /// Last day, YYYY-MM-DD.
    pub ended: Option<String>,
    /// The laboratory's own procedure; optional.
    pub procedure: Option<String>,
}

/// What measured the poses.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct Reference {
    /// What it is.
    pub description: Option<String>,
    /// Its serial number.
    pub serial_number: Option<String>,
    /// Number of its certificate.
    pub certificate: Option<String>,
    /// Who issued its certificate.
    pub certificate_by: Option<String>,
    /// How its results are traceable to the SI.
    pub traceability: Option<String>,
    /// Standard uncertainty of its translations that is common to all points, over the range, micrometres.
    pub common_um: Option<f64>,
    /// Standard uncertainty of its angles that is common to all points, over the range, microradians.
    pub common_urad: Option<f64>,
}

/// The conditions during the measurement: smallest and largest value.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct Environment {
    /// Temperature of the air, degrees Celsius.
    pub temperature_c: Option<[f64; 2]>,
    /// Relative humidity, percent.
    pub humidity_percent: Option<[f64; 2]>,
    /// Pressure of the air, hectopascals; optional.
    pub pressure_hpa: Option<[f64; 2]>,
}

/// Places of a calibration, as a digital calibration certificate names them.
pub const PLACES: [&str; 5] = ["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"];

/// Keys that a certificate does not need.
const OPTIONAL: [&str; 8] = [
    "certificate.remarks",
    "laboratory.accreditation",
    "customer.accreditation",
    "item.condition",
    "calibration.place_detail",
    "calibration.procedure",
    "environment.pressure_hpa",
    "environment.humidity_percent",
];

impl Laboratory {
    /// Reads the file.
    ///
    /// # Errors
    /// The text is not TOML, has an unknown key, or a value that is not allowed; the message names the key.
    pub fn parse(text: &str) -> Result<Self, String> {
        let laboratory: Self = toml::from_str(text).map_err(|e| e.to_string().trim_end().to_owned())?;
        laboratory.leaves().iter().try_for_each(|(key, value)| check_text(key, value))?;
        laboratory.check_numbers()?;
        laboratory.check_dates()?;
        laboratory.check_words()?;
        Ok(laboratory)
    }

    /// The keys that a certificate needs and that are absent.
    pub fn missing(&self) -> Vec<String> {
        let absent = self
            .leaves()
            .into_iter()
            .filter(|(key, value)| value.is_null() && !OPTIONAL.contains(&key.as_str()));
        absent.map(|(key, _)| key).collect()
    }

    /// All values with the names of their keys; an absent one is null.
    fn leaves(&self) -> Vec<(String, Value)> {
        let mut leaves = Vec::new();
        // The structures contain only text, numbers and arrays.
        collect("", &serde_json::to_value(self).unwrap_or_default(), &mut leaves);
        leaves
    }

    fn check_numbers(&self) -> Result<(), String> {
        let common = [
            ("reference.common_um", self.reference.common_um),
            ("reference.common_urad", self.reference.common_urad),
        ];
        for (key, value) in common {
            if let Some(value) = value
                && !(value.is_finite() && value >= 0.0)
            {
                return Err(format!("{key} = {value}: allowed is a finite number of at least 0"));
            }
        }
        let environment = &self.environment;
        let ranges = [
            ("environment.temperature_c", environment.temperature_c, [-100.0, 200.0]),
            ("environment.humidity_percent", environment.humidity_percent, [0.0, 100.0]),
            ("environment.pressure_hpa", environment.pressure_hpa, [0.0, 2000.0]),
        ];
        for (key, range, [least, most]) in ranges {
            if let Some([low, high]) = range
                && !(low >= least && low <= high && high <= most)
            {
                return Err(format!(
                    "{key} = [{low}, {high}]: allowed are the smallest and the largest value, within {least} to {most}"
                ));
            }
        }
        Ok(())
    }

    fn check_dates(&self) -> Result<(), String> {
        let dates = [
            ("item.received", &self.item.received),
            ("calibration.begun", &self.calibration.begun),
            ("calibration.ended", &self.calibration.ended),
            ("certificate.issued", &self.certificate.issued),
        ];
        let mut before: Option<(&str, Date)> = None;
        for (key, text) in dates {
            let Some(text) = text else { continue };
            let date = text.parse::<Date>().ok().filter(|_| text.len() == "2026-05-04".len());
            let date = date.ok_or_else(|| format!("{key} = {text:?}: allowed is a date, as 2026-05-04"))?;
            if let Some((earlier, limit)) = before
                && date < limit
            {
                return Err(format!("{key} = {text:?} is before {earlier} = \"{limit}\""));
            }
            before = Some((key, date));
        }
        Ok(())
    }

    fn check_words(&self) -> Result<(), String> {
        for (key, country) in
            [("laboratory.country", &self.laboratory.country), ("customer.country", &self.customer.country)]
        {
            if let Some(code) = country
                && !(code.len() == 2 && code.bytes().all(|byte| byte.is_ascii_uppercase()))
            {
                return Err(format!(
                    "{key} = {code:?}: allowed are two capital letters of ISO 3166-1, as \"DE\""
                ));
            }
        }
        if self.customer.accreditation.is_some() {
            return Err("customer.accreditation: only the laboratory has an accreditation".to_owned());
        }
        match &self.calibration.place {
            Some(place) if !PLACES.contains(&place.as_str()) => {
                Err(format!("calibration.place = {place:?}: allowed are {}", PLACES.join(", ")))
            }
            _ => Ok(()),
        }
    }
}

fn collect(prefix: &str, value: &Value, leaves: &mut Vec<(String, Value)>) {
    let under = |key: &str| if prefix.is_empty() { key.to_owned() } else { format!("{prefix}.{key}") };
    match value {
        Value::Object(fields) => fields.iter().for_each(|(key, value)| collect(&under(key), value, leaves)),
        Value::Array(values) if values.first().is_some_and(Value::is_object) => {
            for (i, value) in values.iter().enumerate() {
                collect(&format!("{prefix}[{i}]"), value, leaves);
            }
        }
        Value::Array(values) if values.is_empty() => leaves.push((prefix.to_owned(), Value::Null)),
        value => leaves.push((prefix.to_owned(), value.clone())),
    }
}

/// A blank text would leave a gap; other characters cannot be in XML.
fn check_text(key: &str, value: &Value) -> Result<(), String> {
    let Value::String(text) = value else { return Ok(()) };
    if text.trim().is_empty() {
        return Err(format!("{key} is blank: allowed is a text; without the key it counts as missing"));
    }
    let wrong = text.chars().find(|c| (c.is_control() && *c != '\n') || matches!(c, '\u{fffe}' | '\u{ffff}'));
    wrong.map_or(Ok(()), |c| {
        Err(format!("{key} contains the character {c:?}: allowed are printable characters"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_template_has_every_key_and_is_complete_except_for_what_it_leaves_open() {
        let empty = Laboratory::default();
        let template = Laboratory::parse(TEMPLATE).unwrap();
        assert_eq!(template, empty, "the template states nothing");
        let filled = TEMPLATE.lines().map(|line| line.strip_prefix("#: ").unwrap_or(line));
        let filled = Laboratory::parse(&filled.collect::<Vec<_>>().join("\n")).unwrap();
        assert_eq!(filled.missing(), Vec::<String>::new());
        let absent: Vec<String> =
            filled.leaves().into_iter().filter(|(_, value)| value.is_null()).map(|(key, _)| key).collect();
        assert_eq!(absent, ["customer.accreditation"]);
    }

    #[test]
    fn what_is_missing_is_named() {
        let missing = Laboratory::default().missing();
        for key in ["certificate.number", "certificate.authorized_by", "reference.common_um"] {
            assert!(missing.iter().any(|name| name == key), "{missing:?}");
        }
        let one = Laboratory::parse("certificate.authorized_by = [{ name = \"A\" }]").unwrap();
        assert!(one.missing().contains(&"certificate.authorized_by[0].function".to_owned()));
    }

    #[test]
    fn wrong_values_are_refused_by_key() {
        for (text, expected) in [
            ("item.received = \"2026-5-4\"", "item.received = \"2026-5-4\": allowed is a date"),
            (
                "calibration.begun = \"2026-05-04\"\ncalibration.ended = \"2026-05-03\"",
                "calibration.ended = \"2026-05-03\" is before calibration.begun = \"2026-05-04\"",
            ),
            ("laboratory.name = \" \"", "laboratory.name is blank"),
            ("laboratory.name = \"a\\u0007\"", "laboratory.name contains the character '\\u{7}'"),
            ("laboratory.country = \"Germany\"", "laboratory.country = \"Germany\": allowed are two"),
            ("calibration.place = \"here\"", "calibration.place = \"here\": allowed are laboratory"),
            ("environment.temperature_c = [21, 20]", "environment.temperature_c = [21, 20]: allowed"),
            ("reference.common_um = -1.0", "reference.common_um = -1: allowed"),
            ("reference.common_um = nan", "reference.common_um = NaN: allowed"),
            ("reference.common = 1.0", "unknown field `common`"),
        ] {
            let refusal = Laboratory::parse(text).unwrap_err();
            assert!(refusal.contains(expected), "{text}: {refusal}");
        }
    }
}
