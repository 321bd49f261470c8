//! The report of a calibration, as JSON and as a page.

mod page;
mod pictures;

use serde::{Deserialize, Serialize};
use trifacet_optics::calibration::fit::{Dropped, Fitted};
use trifacet_optics::calibration::held_out::{HeldOut, PoseError};
use trifacet_optics::calibration::map::Field;
use trifacet_optics::calibration::mistakes::Regression;
use trifacet_optics::calibration::result::RangeUncertainty;

use super::{InputFile, Measured, ParameterReport, Verdict, Wanted, parameter_reports};

/// A row that has no part in the fit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DroppedRow {
    /// The file.
    pub file: String,
    /// Its line; the header is line 1.
    pub line: u64,
    /// Why.
    pub reason: String,
}

/// Errors of poses: rms, micrometres and microradians.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// tx, ty, tz.
    pub um: [f64; 3],
    /// roll, pitch, yaw.
    pub urad: [f64; 3],
}

/// A pose that was held out.
#[derive(Clone, Debug, Serialize)]
pub struct HeldOutPose {
    /// The file.
    pub file: String,
    /// Its line; the header is line 1.
    pub line: u64,
    /// The reference: tx, ty, tz, roll, pitch, yaw, um and urad.
    pub reference: [f64; 6],
    /// Pose by the other points less the reference, um and urad.
    pub error: [f64; 6],
    /// Spots as read: u, v of A, B, C, mm.
    pub spots_mm: [f64; 6],
    /// The same error as displacements of the spots, um.
    pub spot_errors_um: [f64; 6],
}

/// Where readings lie on a PSD.
#[derive(Clone, Debug, Serialize)]
pub struct Coverage {
    /// Half the side of the PSD, mm.
    pub half_side_mm: f64,
    /// Side of a cell, mm.
    pub cell_mm: f64,
    /// Lower left corners of the cells with readings or among cells with readings: u, v, mm.
    pub covered_mm: Vec<[f64; 2]>,
    /// Spots of the points: u, v, mm.
    #[serde(skip)]
    pub points_mm: Vec<[f64; 2]>,
    /// Spots of the scans: u, v, mm.
    #[serde(skip)]
    pub scans_mm: Vec<[f64; 2]>,
}

/// All that people may want to know of a fit.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The result in one sentence.
    pub verdict: String,
    /// What was measured, in a few words.
    pub method: String,
    /// What to know when using the calibration.
    pub warnings: Vec<String>,
    /// What was asked.
    pub wanted: Wanted,
    /// Standard uncertainty over the range, relative to the zero of the reference.
    pub std: Errors,
    /// Part of the spots of this range that lie among the readings, PSDs A, B, C.
    pub covered: [f64; 3],
    /// Differences of the nominal head from the reference; `None`: too few points have all six coordinates.
    pub before: Option<Errors>,
    /// Errors of the points that were held out, with the head that the others give.
    pub after: Option<Errors>,
    /// The errors of each of these points.
    pub held_out_poses: Vec<HeldOutPose>,
    /// Where readings lie on PSDs A, B, C.
    pub coverage: [Coverage; 3],
    /// The test on the points held out.
    pub held_out: HeldOut,
    /// Cost per row: chi-square with the prior's share.
    pub chi2_per_row: f64,
    /// Number of rows.
    pub rows: usize,
    /// Rms residual of the steering, x and y, micrometres.
    pub steering_um: [f64; 2],
    /// Rows that have no part in the fit.
    pub dropped: Vec<DroppedRow>,
    /// The prior of the splines.
    pub field: Field,
    /// All candidates for it, with the logarithms of their likelihoods.
    pub likelihoods: Vec<(Field, f64)>,
    /// Geometric parameters.
    pub parameters: Vec<ParameterReport>,
    /// Files of points.
    pub inputs: Vec<InputFile>,
    /// Chi-square of each point in the order of the files; `None`: dropped.
    pub chi2: Vec<Option<f64>>,
}

/// Why a point was dropped.
pub fn reason(why: Dropped) -> String {
    match why {
        Dropped::Unsolved => "its signals have no solution".to_owned(),
        Dropped::Gross { chi2, rows } => {
            format!("chi-square {chi2:.0} with {rows} rows: reference or readings are wrong")
        }
    }
}

fn errors(rms: [f64; 6]) -> Option<Errors> {
    let [a, b, c, d, e, f] = rms.map(|x| x * 1e6);
    rms.iter().all(|x| x.is_finite()).then_some(Errors { um: [a, b, c], urad: [d, e, f] })
}

impl Report {
    /// The report of a fit that was not refused.
    pub fn new(
        measured: &Measured,
        fitted: &Fitted,
        regression: Option<&Regression>,
        range: &RangeUncertainty,
        verdict: &Verdict,
        wanted: &Wanted,
    ) -> Self {
        let deviation = range.deviation.map(|x| x * 1e6);
        let [x, y, z, roll, pitch, yaw] = deviation;
        let std = Errors { um: [x, y, z], urad: [roll, pitch, yaw] };
        let rms = |values: &[f64; 3]| (values.iter().map(|x| x * x).sum::<f64>() / 3.0).sqrt();
        let sentence = format!(
            "calibrated: over +-{} mm and +-{} mrad the standard uncertainty by the calibration is {:.3} um and \
             {:.3} urad",
            wanted.range_mm,
            wanted.range_mrad,
            rms(&std.um),
            rms(&std.urad)
        );
        let residuals: Vec<[f64; 2]> = fitted.steering.iter().flatten().copied().collect();
        let steering = |axis: usize| {
            let sum: f64 = residuals.iter().map(|r| r[axis] * r[axis]).sum();
            if residuals.is_empty() { 0.0 } else { (sum / residuals.len() as f64).sqrt() * 1e6 }
        };
        Self {
            verdict: sentence,
            method: method(measured),
            warnings: verdict.warnings.clone(),
            wanted: *wanted,
            std,
            covered: range.covered,
            before: regression.and_then(|r| errors(r.rms)),
            after: errors(fitted.held_out.rms),
            held_out_poses: fitted.held_out.errors.iter().map(|e| held_out_pose(measured, e)).collect(),
            coverage: [0, 1, 2].map(|psd| coverage(measured, fitted, psd)),
            held_out: fitted.held_out.clone(),
            chi2_per_row: fitted.cost_per_row(),
            rows: fitted.rows,
            steering_um: [steering(0), steering(1)],
            dropped: fitted.dropped.iter().map(|(k, why)| dropped(measured, *k, *why)).collect(),
            field: fitted.calibration.field,
            likelihoods: fitted.likelihoods.clone(),
            parameters: parameter_reports(&fitted.calibration),
            inputs: measured.files.clone(),
            chi2: fitted.chi2.clone(),
        }
    }
}

fn held_out_pose(measured: &Measured, error: &PoseError) -> HeldOutPose {
    let (point, line) = (&measured.points[error.point], measured.lines[error.point]);
    HeldOutPose {
        file: measured.files[line.file].path.display().to_string(),
        line: line.line,
        reference: point.reference_values().map(|x| x * 1e6),
        error: error.pose.map(|x| x * 1e6),
        spots_mm: point.spots.map(|x| x * 1e3),
        spot_errors_um: error.spots.map(|x| x * 1e6),
    }
}

/// Spots of rows that were dropped do not count.
fn coverage(measured: &Measured, fitted: &Fitted, psd: usize) -> Coverage {
    let layout = &fitted.calibration.layout;
    let (lattice, half) = (&layout.lattices[psd], layout.half_sizes[psd]);
    let cells = (half / lattice.knots()).ceil() as i32;
    let all = (-cells..cells).flat_map(|j| (-cells..cells).map(move |i| [i, j]));
    let middle = |cell: &[i32; 2]| cell.map(|i| (f64::from(i) + 0.5) * lattice.knots());
    let covered = all.filter(|cell| lattice.covers(middle(cell)));
    let spots = |from: usize, to: usize| {
        let used = (from..to).filter(|k| fitted.chi2[*k].is_some()).map(|k| &measured.points[k].spots);
        used.map(|spots| [spots[2 * psd] * 1e3, spots[2 * psd + 1] * 1e3]).collect()
    };
    Coverage {
        half_side_mm: half * 1e3,
        cell_mm: lattice.knots() * 1e3,
        covered_mm: covered.map(|cell| cell.map(|i| f64::from(i) * lattice.knots() * 1e3)).collect(),
        points_mm: spots(0, measured.scans),
        scans_mm: spots(measured.scans, measured.points.len()),
    }
}

fn dropped(measured: &Measured, point: usize, why: Dropped) -> DroppedRow {
    let line = measured.lines[point];
    let file = measured.files[line.file].path.display().to_string();
    DroppedRow { file, line: line.line, reason: reason(why) }
}

/// What was measured, in a few words.
fn method(measured: &Measured) -> String {
    let (mut full, mut partial, mut free) = (0, 0, 0);
    for point in &measured.points[..measured.scans] {
        match point.reference.iter().flatten().count() {
            6 => full += 1,
            0 => free += 1,
            _ => partial += 1,
        }
    }
    let scans = measured.files.iter().filter(|file| file.kind == "scan").count();
    let parts = [
        (full, "points with a reference of all axes"),
        (partial, "points with a reference of some axes"),
        (free, "points without a reference"),
        (scans, "scans of the steering"),
    ];
    let parts = parts.into_iter().filter(|(count, _)| *count > 0);
    parts.map(|(count, what)| format!("{count} {what}")).collect::<Vec<_>>().join(", ")
}

/// Text for HTML and XML.
pub(super) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
