//! The header of a calibration record.

use std::path::Path;

use jiff::Timestamp;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::config::file::read_regular_up_to;

/// The format of records that this version writes and reads.
pub const FORMAT: u32 = 1;

/// Largest number of bytes of a record that are read.
const LARGEST: u64 = 1 << 30;

/// What the daemon needs of a calibration record. The other fields of the file are ignored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordHeader {
    /// Format of the file, [`FORMAT`].
    pub format: u32,
    /// Version of the program that wrote the record.
    pub version: String,
    /// Time of the calibration, RFC 3339.
    pub date: String,
    /// What was measured, in a few words.
    pub method: String,
    /// The [`fingerprint`](super::fingerprint) of the configuration that the calibration produced.
    pub fits: String,
    /// Range of the translations for which `std_um` and `std_urad` hold, millimetres to both sides of the tare pose.
    pub range_mm: f64,
    /// Range of the rotations, milliradians to both sides.
    pub range_mrad: f64,
    /// Standard uncertainty of tx, ty, tz over this range, relative to the tare pose, micrometres.
    pub std_um: [f64; 3],
    /// Standard uncertainty of roll, pitch, yaw over this range, relative to the tare pose, microradians.
    pub std_urad: [f64; 3],
    /// Time from which the calibration is no longer valid, RFC 3339. `None`: no limit was stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expires: Option<String>,
    /// What the drift of the head is judged by. `None`: it is not watched.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_calibration: Option<AtCalibration>,
}

/// What shows a drift, as it was at the calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AtCalibration {
    /// The steering residual of the points. `None`: the position of the steering was not read back.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steering: Option<SteeringResidual>,
    /// Standard uncertainty of the power gains of PSD B and C relative to A, percent.
    pub power_gain_std_percent: [f64; 2],
    /// Dark offsets of the configuration: u, v, sum of PSD A, B, C, volts.
    pub dark_v: [[f64; 3]; 3],
}

/// The steering residual of the points of a calibration: beam position by the readback less that by the nine signals,
/// x and y across the beam, micrometres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SteeringResidual {
    /// Mean of all points.
    pub mean_um: [f64; 2],
    /// Standard deviation of a point.
    pub std_um: [f64; 2],
}

/// Why a calibration record cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The file cannot be read.
    #[error("{0}")]
    Unreadable(#[from] std::io::Error),
    /// The file is not a record.
    #[error("not a calibration record: {0}")]
    NotARecord(#[from] serde_json::Error),
    /// The file is a record of a later version.
    #[error(
        "format {found}: this version reads format {FORMAT}; use the program that wrote it (version {version})"
    )]
    Format {
        /// Format of the file.
        found: u32,
        /// Version of the program that wrote it.
        version: String,
    },
    /// A field has a value that is not allowed.
    #[error("{field} is {found}: allowed is {allowed}")]
    Field {
        /// Name of the field.
        field: &'static str,
        /// Its value.
        found: String,
        /// The allowed values.
        allowed: &'static str,
    },
}

/// Reads the file of a record. Blocks.
///
/// # Errors
/// Fails if it is not a regular file, or cannot be read.
pub fn contents(path: &Path) -> Result<Vec<u8>, RecordError> {
    Ok(read_regular_up_to(path, LARGEST)?)
}

/// A record, or its header alone, from the contents of the file; `header` is that of the result.
///
/// # Errors
/// Fails if the contents are not a record that this version can use.
pub fn parsed<T: DeserializeOwned>(
    text: &[u8],
    header: impl Fn(&T) -> &RecordHeader,
) -> Result<T, RecordError> {
    let record = serde_json::from_slice(text);
    if record.is_err() {
        // A later format may lack fields.
        let Format { format, version } = serde_json::from_slice(text)?;
        if format != FORMAT {
            return Err(RecordError::Format { found: format, version });
        }
    }
    let record = record?;
    header(&record).check()?;
    Ok(record)
}

/// The format alone, so that a later format is named as such.
#[derive(Deserialize)]
struct Format {
    format: u32,
    #[serde(default)]
    version: String,
}

impl RecordHeader {
    /// Reads the header of a record. Blocks.
    ///
    /// # Errors
    /// Fails if the file cannot be read, or is not a record that this version can use.
    pub fn open(path: &Path) -> Result<Self, RecordError> {
        parsed(&contents(path)?, |header| header)
    }

    fn check(&self) -> Result<(), RecordError> {
        if self.format != FORMAT {
            return Err(RecordError::Format { found: self.format, version: self.version.clone() });
        }
        let wrong = |field, found: String, allowed| Err(RecordError::Field { field, found, allowed });
        for (field, time) in [("date", Some(&self.date)), ("expires", self.expires.as_ref())] {
            if let Some(text) = time
                && text.parse::<Timestamp>().is_err()
            {
                return wrong(field, format!("{text:?}"), "a time in RFC 3339, as 2026-05-04T12:00:00Z");
            }
        }
        for (field, range) in [("range_mm", self.range_mm), ("range_mrad", self.range_mrad)] {
            if !(range.is_finite() && range > 0.0) {
                return wrong(field, range.to_string(), "a finite number above 0");
            }
        }
        for (field, deviations) in [("std_um", self.std_um), ("std_urad", self.std_urad)] {
            if !deviations.iter().all(|x| x.is_finite() && *x >= 0.0) {
                return wrong(field, format!("{deviations:?}"), "three finite numbers of at least 0");
            }
        }
        if let Some(at) = &self.at_calibration {
            let steering = at.steering.iter().flat_map(|steering| steering.std_um);
            let mut deviations = at.power_gain_std_percent.into_iter().chain(steering);
            if deviations.any(|x| x < 0.0) {
                return wrong("at_calibration", "a negative deviation".into(), "deviations of at least 0");
            }
        }
        Ok(())
    }

    /// The time of the calibration.
    pub fn time(&self) -> Option<Timestamp> {
        self.date.parse().ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header() -> RecordHeader {
        RecordHeader {
            format: FORMAT,
            version: "0.1.0".into(),
            date: "2026-05-04T12:00:00Z".into(),
            method: "six-axis stage, 500 points".into(),
            fits: "00".into(),
            range_mm: 1.0,
            range_mrad: 5.0,
            std_um: [0.1, 0.1, 0.08],
            std_urad: [0.3, 0.3, 0.2],
            expires: None,
            at_calibration: None,
        }
    }

    fn refusal(change: impl FnOnce(&mut serde_json::Value)) -> String {
        let mut json = serde_json::to_value(header()).unwrap();
        change(&mut json);
        parsed::<RecordHeader>(json.to_string().as_bytes(), |header| header).unwrap_err().to_string()
    }

    #[test]
    fn a_header_is_read_from_a_record_with_more_fields() {
        let mut json = serde_json::to_value(header()).unwrap();
        json["theta"] = serde_json::json!([1.0, 2.0]);
        assert_eq!(parsed::<RecordHeader>(json.to_string().as_bytes(), |header| header).unwrap(), header());
        json["expires"] = "2027-05-04T12:00:00+02:00".into();
        let read = parsed::<RecordHeader>(json.to_string().as_bytes(), |header| header).unwrap();
        assert_eq!(read.expires.as_deref(), Some("2027-05-04T12:00:00+02:00"));
    }

    #[test]
    fn a_record_that_cannot_be_used_is_refused_with_the_reason() {
        let later = refusal(|json| {
            *json = serde_json::json!({ "format": 2, "version": "9.1" });
        });
        assert!(
            later.starts_with("format 2: this version reads format 1") && later.contains("9.1"),
            "{later}"
        );
        assert!(
            refusal(|json| json["date"] = "May".into()).starts_with("date is \"May\": allowed is a time")
        );
        assert!(refusal(|json| json["expires"] = "never".into()).starts_with("expires is \"never\""));
        assert!(refusal(|json| json["range_mm"] = 0.into()).starts_with("range_mm is 0: allowed is"));
        let negative = refusal(|json| json["std_urad"] = serde_json::json!([0.1, -0.1, 0.1]));
        assert!(negative.starts_with("std_urad is [0.1, -0.1, 0.1]: allowed is"), "{negative}");
        let negative = refusal(|json| {
            json["at_calibration"] = serde_json::json!({
                "steering": { "mean_um": [0.0, 0.0], "std_um": [0.1, -0.1] },
                "power_gain_std_percent": [0.1, 0.1],
                "dark_v": [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
            });
        });
        assert_eq!(negative, "at_calibration is a negative deviation: allowed is deviations of at least 0");
        let absent = refusal(|json| drop(json.as_object_mut().unwrap().remove("fits")));
        assert!(absent.starts_with("not a calibration record: missing field `fits`"), "{absent}");
    }
}
