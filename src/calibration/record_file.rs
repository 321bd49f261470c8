//! The whole record of a calibration: what uncertainties are computed from.

use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::{Deserialize, Serialize};
use trifacet_optics::calibration::cholesky::Factor;
use trifacet_optics::calibration::gauge;
use trifacet_optics::calibration::linearised::Layout;
use trifacet_optics::calibration::map::{Field, Lattice};
use trifacet_optics::calibration::parameters::{Nominal, Parameter, Tolerances, parameters};
use trifacet_optics::calibration::result::Calibration;

use crate::config::{RecordError, RecordHeader, contents, parsed, spread_bytes};

/// A record: the header, and the parameters with their covariance.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Record {
    /// What the daemon reads.
    #[serde(flatten)]
    pub header: RecordHeader,
    /// The geometric parameters for people; not needed for computations.
    pub parameters: Vec<ParameterReport>,
    /// Files of points, residuals and dropped rows, for people.
    pub measurement: serde_json::Value,
    nominal: Nominal,
    tolerances: Tolerances,
    /// Runs with a zero of their own.
    runs: usize,
    half_sizes_m: [f64; 3],
    field: Field,
    /// Cells of the knots that have readings, PSDs A, B, C.
    cells: [Vec<[i32; 2]>; 3],
    /// All parameters: geometry, zeros of the runs, polynomials and splines of the PSDs. Base64 of 64-bit
    /// little-endian numbers, as the two below.
    theta: String,
    /// Factor of their inverse covariance `S L L' S`: lower triangle of L, by columns.
    factor: String,
    /// Diagonal of S.
    scale: String,
    /// What the frames need, see [`SharedSpread`](crate::config::SharedSpread): base64.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    spread: Option<String>,
}

/// A geometric parameter before and after the fit.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ParameterReport {
    /// Its name.
    pub name: String,
    /// "m", "rad" or "1".
    pub unit: String,
    /// Difference from the nominal head.
    pub value: f64,
    /// Standard deviation before the fit: the tolerance.
    pub prior: f64,
    /// Standard deviation after the fit.
    pub posterior: f64,
    /// What most of the variance before the fit is removed or kept by: "data", "tolerance" or "convention".
    pub determined_by: String,
    /// The parts of the variance before the fit; absent in records of before.
    #[serde(default)]
    pub shares: Shares,
}

/// Parts of the variance of a parameter before the fit; their sum is 1.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Shares {
    /// The data have removed it.
    pub data: f64,
    /// More data would remove it: the tolerance holds.
    pub tolerance: f64,
    /// No measurement can remove it, since it has no effect on a pose: a convention.
    pub convention: f64,
}

impl Shares {
    /// From the deviations before and after the fit, and from the part that no measurement can remove.
    fn new(prior: f64, posterior: f64, gauge: f64) -> Self {
        let left = (posterior / prior).powi(2).min(1.0);
        let convention = gauge.clamp(0.0, left);
        Self { data: 1.0 - left, tolerance: left - convention, convention }
    }

    /// The name of the largest part.
    fn largest(&self) -> &'static str {
        let parts = [("data", self.data), ("tolerance", self.tolerance), ("convention", self.convention)];
        parts.into_iter().max_by(|a, b| a.1.total_cmp(&b.1)).map_or("tolerance", |(name, _)| name)
    }
}

/// The geometric parameters of a calibration.
pub fn parameter_reports(calibration: &Calibration) -> Vec<ParameterReport> {
    let list = parameters(&calibration.tolerances);
    // A head that cannot be measured as drawn has no fit, so that there are always shares.
    let gauge = gauge::shares(&calibration.nominal, &calibration.tolerances);
    let gauge = gauge.unwrap_or_else(|| vec![0.0; list.len()]);
    let found = calibration.theta.iter().zip(calibration.deviations()).zip(gauge);
    let one = |(parameter, ((value, posterior), gauge)): (Parameter, ((&f64, f64), f64))| {
        let shares = Shares::new(parameter.deviation, posterior, gauge);
        ParameterReport {
            determined_by: shares.largest().to_owned(),
            name: parameter.name,
            unit: parameter.unit,
            value: *value,
            prior: parameter.deviation,
            posterior,
            shares,
        }
    };
    list.into_iter().zip(found).map(one).collect()
}

impl Record {
    /// The record of a calibration. `measurement`: what people may want to know of the data.
    pub fn new(header: RecordHeader, calibration: &Calibration, measurement: serde_json::Value) -> Self {
        let layout = &calibration.layout;
        let range = [header.range_mm * 1e-3, header.range_mrad * 1e-3];
        Self {
            header,
            parameters: parameter_reports(calibration),
            measurement,
            nominal: calibration.nominal.clone(),
            tolerances: calibration.tolerances.clone(),
            runs: layout.runs,
            half_sizes_m: layout.half_sizes,
            field: calibration.field,
            cells: layout.lattices.each_ref().map(|lattice| lattice.cells().to_vec()),
            theta: encode(calibration.theta.iter().copied()),
            factor: encode(calibration.factor.packed()),
            scale: encode(calibration.factor.scale().iter().copied()),
            spread: calibration.spread(range).map(|spread| STANDARD.encode(spread_bytes(&spread))),
        }
    }

    /// Reads a record. Blocks.
    ///
    /// # Errors
    /// Fails if the file cannot be read, or is not a record.
    pub fn open(path: &Path) -> Result<Self, RecordError> {
        parsed(&contents(path)?, |record: &Self| &record.header)
    }

    /// The calibration, from which uncertainties are computed.
    ///
    /// # Errors
    /// The numbers do not belong together: the file was changed.
    pub fn calibration(&self) -> Result<Calibration, RecordError> {
        let wrong = |field, found: &str| RecordError::Field {
            field,
            found: found.to_owned(),
            allowed: "what trifacet calibrate fit wrote",
        };
        let knots = self.field.knots;
        if !self.half_sizes_m.iter().all(|half| Lattice::is_usable(knots, *half)) {
            return Err(wrong("field", "not a usable lattice"));
        }
        let [a, b, c] = &self.cells;
        let lattice = |i: usize, cells: &Vec<[i32; 2]>| {
            let mut cells = cells.clone();
            cells.retain(|cell| cell.iter().all(|x| x.abs() < 10_000));
            cells.sort_unstable();
            Lattice::of_cells(knots, self.half_sizes_m[i], cells)
        };
        let lattices = [lattice(0, a), lattice(1, b), lattice(2, c)];
        let theta = decode(&self.theta).ok_or_else(|| wrong("theta", "not base64 of finite numbers"))?;
        if self.runs > theta.len() {
            return Err(wrong("runs", "more than the parameters"));
        }
        let layout = Layout { runs: self.runs, lattices, half_sizes: self.half_sizes_m };
        let scale = decode(&self.scale).ok_or_else(|| wrong("scale", "not base64 of finite numbers"))?;
        let packed = decode(&self.factor).ok_or_else(|| wrong("factor", "not base64 of finite numbers"))?;
        if theta.len() != layout.parameters() || scale.len() != layout.parameters() {
            return Err(wrong("theta", "of another length than the basis"));
        }
        let factor = Factor::from_parts(&packed, scale).ok_or_else(|| wrong("factor", "of another size"))?;
        let (nominal, tolerances) = (self.nominal.clone(), self.tolerances.clone());
        Ok(Calibration { nominal, tolerances, layout, field: self.field, theta, factor })
    }
}

fn encode(numbers: impl Iterator<Item = f64>) -> String {
    STANDARD.encode(numbers.flat_map(f64::to_le_bytes).collect::<Vec<u8>>())
}

fn decode(text: &str) -> Option<Vec<f64>> {
    let bytes = STANDARD.decode(text).ok()?;
    let (chunks, rest) = bytes.as_chunks::<8>();
    let numbers: Vec<f64> = chunks.iter().map(|chunk| f64::from_le_bytes(*chunk)).collect();
    (rest.is_empty() && numbers.iter().all(|x| x.is_finite())).then_some(numbers)
}
