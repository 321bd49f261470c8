//! The report of a calibration, as JSON and as a page.

use std::fmt::Write as _;

use serde::Serialize;
use trifacet_optics::FACETS;
use trifacet_optics::calibration::fit::{Dropped, Fitted};
use trifacet_optics::calibration::held_out::HeldOut;
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
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Errors {
    /// tx, ty, tz.
    pub um: [f64; 3],
    /// roll, pitch, yaw.
    pub urad: [f64; 3],
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
            held_out: fitted.held_out,
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

    /// The report as a page that prints.
    pub fn html(&self) -> String {
        let mut page = format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>Calibration</title>\n<style>\
             body{{font:14px/1.4 sans-serif;max-width:60em;margin:2em auto;padding:0 1em}}table{{border-collapse:\
             collapse;margin:.5em 0}}td,th{{border:1px solid #bbb;padding:.15em .6em;text-align:right}}\
             td:first-child,th:first-child{{text-align:left}}</style></head><body>\n<h1>Calibration of the head</h1>\n\
             <p><strong>{}</strong></p>\n<p>Measured: {}.</p>\n",
            escaped(&self.verdict),
            escaped(&self.method)
        );
        for warning in &self.warnings {
            let _ = writeln!(page, "<p>Warning: {}.</p>", escaped(warning));
        }
        page += "<h2>Poses</h2>\n<table><tr><th></th><th>tx, um</th><th>ty, um</th><th>tz, um</th>\
                 <th>roll, urad</th><th>pitch, urad</th><th>yaw, urad</th></tr>\n";
        let rows = [
            ("nominal head against the reference, rms", self.before),
            ("calibrated head on points held out, rms", self.after),
            ("standard uncertainty by the calibration", Some(self.std)),
        ];
        for (name, errors) in rows {
            let Some(Errors { um, urad }) = errors else { continue };
            let cells: Vec<String> = um.iter().chain(&urad).map(|x| format!("<td>{x:.3}</td>")).collect();
            let _ = writeln!(page, "<tr><td>{name}</td>{}</tr>", cells.concat());
        }
        let _ = writeln!(
            page,
            "</table>\n<h2>Tests</h2>\n<table>\n<tr><td>chi-square per row</td><td>{:.3}</td></tr>\n\
             <tr><td>chi-square per row, {} points held out</td><td>{:.3}</td></tr>\n\
             <tr><td>residual of the steering, um</td><td>{:.3}, {:.3}</td></tr>",
            self.chi2_per_row,
            self.held_out.points,
            self.held_out.per_row(),
            self.steering_um[0],
            self.steering_um[1]
        );
        for (psd, covered) in FACETS.into_iter().zip(self.covered) {
            let _ = writeln!(
                page,
                "<tr><td>spots of the range among readings, PSD {psd}</td><td>{:.1} %</td></tr>",
                100.0 * covered
            );
        }
        page += "</table>\n<h2>Rows that were dropped</h2>\n";
        if self.dropped.is_empty() {
            page += "<p>None.</p>\n";
        }
        for DroppedRow { file, line, reason } in &self.dropped {
            let _ = writeln!(page, "<p>{}:{line}: {}.</p>", escaped(file), escaped(reason));
        }
        page += "<h2>Parameters</h2>\n<p>Differences from the nominal head. Many combinations of them have the same \
                 effect, so that they are not known singly; poses are.</p>\n<table><tr><th>parameter</th><th>unit</th>\
                 <th>value</th><th>tolerance</th><th>standard uncertainty</th><th>determined by</th></tr>\n";
        for p in &self.parameters {
            let _ = writeln!(
                page,
                "<tr><td>{}</td><td>{}</td><td>{:.3e}</td><td>{:.1e}</td><td>{:.1e}</td><td>{}</td></tr>",
                p.name, p.unit, p.value, p.prior, p.posterior, p.determined_by
            );
        }
        page += "</table>\n<h2>Files</h2>\n<table><tr><th>file</th><th>kind</th><th>rows</th><th>SHA-256</th></tr>\n";
        for file in &self.inputs {
            let path = escaped(&file.path.display().to_string());
            let InputFile { kind, rows, sha256, .. } = file;
            let _ = writeln!(
                page,
                "<tr><td>{path}</td><td>{kind}</td><td>{rows}</td><td><small>{sha256}</small></td></tr>"
            );
        }
        page + "</table>\n</body></html>\n"
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

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
