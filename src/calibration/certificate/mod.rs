//! The certificate of a calibration, with the content that ISO/IEC 17025:2017 asks for in 7.8.2 and 7.8.4.
//!
//! Certified are poses relative to the tare over a range, not parameters: many combinations of parameters have the same
//! effect on all poses, so that no measurement tells them apart.

mod dcc;
mod html;
mod laboratory;
mod xml;

pub use laboratory::{Laboratory, PLACES, TEMPLATE};
use serde::Deserialize;
use trifacet_optics::calibration::result::RangeUncertainty;

use super::Record;
use super::report::Errors;
use crate::config::{RecordError, RecordHeader};

/// Coverage factor of the stated expanded uncertainties.
const COVERAGE_FACTOR: f64 = 2.0;
/// Its coverage probability for a normal distribution, rounded as is usual.
const COVERAGE_PROBABILITY: f64 = 0.95;
/// Number of poses over which the uncertainty is determined.
const RANGE_POSES: usize = 1000;
/// The axes, with their units.
const AXES: [(&str, &str); 6] =
    [("tx", "um"), ("ty", "um"), ("tz", "um"), ("roll", "urad"), ("pitch", "urad"), ("yaw", "urad")];

/// What the certificate takes from the report of the fit.
#[derive(Clone, Debug, Deserialize)]
struct Findings {
    before: Option<Errors>,
    after: Option<Errors>,
    held_out: HeldOutPoints,
    chi2_per_row: f64,
    rows: usize,
    dropped: Vec<serde_json::Value>,
    inputs: Vec<Input>,
    warnings: Vec<String>,
}

/// The test on the points held out.
#[derive(Clone, Copy, Debug, Deserialize)]
struct HeldOutPoints {
    points: usize,
    rows: usize,
    chi2: f64,
    poses: usize,
}

#[derive(Clone, Debug, Deserialize)]
struct Input {
    path: String,
    rows: usize,
    sha256: String,
}

/// A file of the calibration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IssuedFile {
    /// Its name.
    pub name: String,
    /// SHA-256 of its contents, in hexadecimal.
    pub sha256: String,
}

/// A certificate.
#[derive(Clone, Debug)]
pub struct Certificate {
    laboratory: Laboratory,
    draft: bool,
    header: RecordHeader,
    findings: Findings,
    range: RangeUncertainty,
    files: Vec<IssuedFile>,
}

/// Why there is no certificate.
#[derive(Debug, thiserror::Error)]
pub enum CertificateError {
    /// The record cannot be used.
    #[error("{0}")]
    Record(#[from] RecordError),
    /// The record has no report of its fit.
    #[error("the record has no complete report of its fit: {0}")]
    Report(#[from] serde_json::Error),
    /// The tare pose has no reading.
    #[error("the zero of the reference is out of reach of the PSDs")]
    OutOfReach,
    /// The measurement ended after its evaluation.
    #[error(
        "calibration.ended = {ended:?} is after the date of the calibration record, {evaluated}: a measurement ends \
         before its evaluation"
    )]
    EndedLater {
        /// Last day of the measurement.
        ended: String,
        /// Time of the record.
        evaluated: String,
    },
}

impl Certificate {
    /// A certificate of this calibration. `files`: the calibrated configuration, the tables and the record. A draft
    /// marks what is missing.
    ///
    /// # Errors
    /// Fails if record and statements do not carry a certificate.
    pub fn new(
        record: &Record,
        laboratory: Laboratory,
        files: Vec<IssuedFile>,
        draft: bool,
    ) -> Result<Self, CertificateError> {
        let header = record.header.clone();
        let findings = Findings::deserialize(&record.measurement)?;
        // The date begins the time of the record, so that texts compare as dates.
        if let Some(ended) = &laboratory.calibration.ended
            && ended.as_str() > header.date.get(..ended.len()).unwrap_or_default()
        {
            return Err(CertificateError::EndedLater { ended: ended.clone(), evaluated: header.date });
        }
        let (metres, radians) = (header.range_mm * 1e-3, header.range_mrad * 1e-3);
        let range = record.calibration()?.range_uncertainty(metres, radians, RANGE_POSES);
        let range = range.ok_or(CertificateError::OutOfReach)?;
        Ok(Self { laboratory, draft, header, findings, range, files })
    }

    /// Standard uncertainties of the six axes by the calibration, the largest over the range; um, urad.
    fn by_calibration(&self) -> [f64; 6] {
        self.range.largest.map(|x| x * 1e6)
    }

    /// Standard uncertainties of the six axes by the reference; um, urad. `None`: not stated.
    fn by_reference(&self) -> [Option<f64>; 6] {
        let [um, urad] = [self.laboratory.reference.common_um, self.laboratory.reference.common_urad];
        [um, um, um, urad, urad, urad]
    }

    /// Expanded uncertainties; um, urad. `None`: a part is not stated.
    fn expanded(&self) -> [Option<f64>; 6] {
        let (own, reference) = (self.by_calibration(), self.by_reference());
        [0, 1, 2, 3, 4, 5].map(|i| reference[i].map(|part| COVERAGE_FACTOR * own[i].hypot(part)))
    }

    /// The measurand.
    fn measurand(&self) -> String {
        format!(
            "Pose of the mirror (tx, ty, tz, roll, pitch, yaw) relative to the tare pose, computed with the calibrated \
             configuration and its correction tables, for poses within ±{} mm and ±{} mrad on each axis of the zero \
             of the reference, whose three spots lie within the covered areas of the tables",
            self.header.range_mm, self.header.range_mrad
        )
    }

    /// How the expanded uncertainty was found.
    fn uncertainty_statement(&self) -> String {
        format!(
            "The expanded measurement uncertainty U is the combined standard uncertainty multiplied by the coverage \
             factor k = {COVERAGE_FACTOR}, which for a normal distribution corresponds to a coverage probability of \
             approximately {:.0} %. It was determined according to JCGM 100:2008. It is the largest one of {} poses over \
             the range and combines the covariance of the calibration (noise of the readings, standard uncertainties \
             of the reference at each point, coverage of the detectors) with the standard uncertainty of the reference \
             that is common to all points. It does not contain the noise of readings in later use, changes of \
             temperature or pointing since the tare, or long-term drift",
            100.0 * COVERAGE_PROBABILITY,
            self.range.poses
        )
    }

    fn method(&self) -> String {
        format!(
            "Fit of the optical model of the head to measured points ({}) by weighted least squares with the \
             tolerances of the head as prior information: trifacet calibrate fit {}, evaluated {}",
            self.header.method, self.header.version, self.header.date
        )
    }

    /// Chi-square per row of the points held out; `None` without rows.
    fn held_out_chi2(&self) -> Option<f64> {
        let HeldOutPoints { rows, chi2, .. } = self.findings.held_out;
        (rows > 0).then(|| chi2 / rows as f64)
    }
}

/// The six numbers of errors.
fn six(errors: &Errors) -> [f64; 6] {
    let Errors { um: [a, b, c], urad: [d, e, f] } = *errors;
    [a, b, c, d, e, f]
}

/// Rounded up to two significant digits, as an uncertainty is stated: never smaller than it is.
fn rounded_up(value: f64) -> String {
    if value <= 0.0 {
        return "0".to_owned();
    }
    let decimals = 1 - value.log10().floor() as i32;
    let scale = 10_f64.powi(decimals);
    // Rounding errors do not count as excess.
    let up = (value * scale - 1e-9).ceil() / scale;
    format!("{up:.*}", usize::try_from(decimals).unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::rounded_up;

    #[test]
    fn uncertainties_are_never_rounded_down() {
        for (value, text) in [(0.1601, "0.17"), (0.16, "0.16"), (1.234, "1.3"), (0.0, "0"), (123.4, "130")] {
            assert_eq!(rounded_up(value), text);
        }
        assert_eq!(rounded_up(0.0999), "0.100", "one digit more than necessary, but not less than it is");
    }
}
