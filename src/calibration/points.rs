//! Reads the measured points of a calibration.
//!
//! A file of points is a table as CSV: `u_a_m` ... `v_c_m`, `power_a` ... `power_c`, and optionally their standard
//! uncertainties `std_...`, the pose by a reference `ref_tx_m` ... `ref_yaw_rad` with `ref_std_...`, the readback of
//! the steering `stage_x_m`, `stage_y_m` with `std_stage_...`, the time `time_s`, and `run`. An empty field or NaN: not measured.

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use serde::Serialize;
use sha2::{Digest, Sha256};
use trifacet_optics::calibration::parameters::Nominal;
use trifacet_optics::calibration::point::{Known, Point};
use trifacet_optics::calibration::revisits::{COORDINATES, Revisits, correct};
use trifacet_wire::layout::{POSE, SPOTS};

use crate::exit::{self, Failure};
use crate::text::table::{Layout, Row, RowError, Table};

/// Columns of the powers.
pub(super) const POWERS: [&str; 3] = ["power_a", "power_b", "power_c"];
/// Columns of the position of the steering.
pub(super) const STAGE: [&str; 2] = ["stage_x_m", "stage_y_m"];
const RUN: &str = "run";
const TIME: &str = "time_s";
/// Largest file.
const LARGEST: u64 = 256 << 20;

/// What holds where a file does not say it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Defaults {
    /// Standard uncertainty of a spot, metres.
    pub spot: f64,
    /// Standard uncertainty of a power relative to it.
    pub power: f64,
    /// Standard uncertainty of the readback, metres.
    pub readback: f64,
    /// Each file of points has a zero of its own.
    pub own_zero: bool,
}

/// A file of points.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct InputFile {
    /// Its path, as given.
    pub path: PathBuf,
    /// "points" or "scan".
    pub kind: &'static str,
    /// Number of rows.
    pub rows: usize,
    /// SHA-256 of its contents.
    pub sha256: String,
}

/// Where a point comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Line {
    /// Index of the file.
    pub file: usize,
    /// Line in it; the header is line 1 if nothing precedes it.
    pub line: u64,
}

/// All points of a calibration.
#[derive(Clone, Debug, Default)]
pub struct Measured {
    /// The points.
    pub points: Vec<Point>,
    /// Index of the first point of a scan of the steering.
    pub scans: usize,
    /// Where each one comes from.
    pub lines: Vec<Line>,
    /// When each one was measured, seconds, if its row states it.
    pub times: Vec<Option<f64>>,
    /// The files.
    pub files: Vec<InputFile>,
}

/// A point, and the name of its run.
type Named = (Point, Option<String>);

impl Measured {
    /// Reads files of points and of scans. Blocks.
    ///
    /// # Errors
    /// A file cannot be read, or a row is not a point; the message names file and line.
    pub fn read(points: &[PathBuf], scans: &[PathBuf], defaults: Defaults) -> Result<Self, Failure> {
        let mut measured = Self::default();
        let mut names: Vec<Option<String>> = Vec::new();
        for path in points {
            let rows = measured.file(path, "points", defaults)?;
            for (point, run) in rows {
                let file = defaults.own_zero.then(|| path.display().to_string());
                names.push(match (run, file) {
                    (Some(run), Some(file)) => Some(format!("{file}\n{run}")),
                    (run, file) => run.or(file),
                });
                measured.points.push(point);
            }
        }
        measured.scans = measured.points.len();
        let first = zeros(&names, &mut measured.points);
        for (zero, path) in (first..).zip(scans) {
            for (point, _) in measured.file(path, "scan", defaults)? {
                measured.points.push(point.of_scan(zero));
            }
        }
        Ok(measured)
    }

    /// Takes the drift that visits of the same pose show off the points, by their times, or by the order of the rows if one
    /// has no time. Returns the coordinates that drifted, in words.
    pub fn without_drift(&mut self, nominal: &Nominal) -> Option<String> {
        let times: Option<Vec<f64>> = self.times.iter().copied().collect();
        let times = times.unwrap_or_else(|| (0..self.points.len()).map(|k| k as f64).collect());
        let Revisits { visits, drifted } = correct(nominal, &mut self.points, &times);
        let sizes = drifted.iter().map(|(coordinate, size)| {
            let unit = if (3..6).contains(coordinate) { "urad" } else { "um" };
            format!("{} {:.2} {unit}", COORDINATES[*coordinate], size * 1e6)
        });
        let sizes = sizes.collect::<Vec<_>>().join(", ");
        (!drifted.is_empty()).then(|| {
            format!(
                "{} visits of the same pose differ by more than their noise: during the measurement {sizes} of drift. A \
                 random walk through the visits was taken off all points, and its uncertainty added to theirs",
                visits.len()
            )
        })
    }

    /// "file:line" of a point.
    pub fn place(&self, point: usize) -> String {
        let Line { file, line } = self.lines[point];
        format!("{}:{line}", self.files[file].path.display())
    }

    fn file(&mut self, path: &Path, kind: &'static str, defaults: Defaults) -> Result<Vec<Named>, Failure> {
        let name = path.display().to_string();
        let unreadable = |e: std::io::Error| Failure::new(exit::IO, format!("cannot read {name}: {e}"));
        let mut bytes = Vec::new();
        File::open(path).and_then(|f| f.take(LARGEST).read_to_end(&mut bytes)).map_err(unreadable)?;
        let needed = [&SPOTS[..], &POWERS].concat();
        let layout = Layout { needed: &needed, optional: &[], aliases: &[], comments: true };
        let mut table = Table::open(&name, &bytes[..], layout)?;
        let mut rows = Vec::new();
        while let Some(row) = table.next_row()? {
            rows.push(point(&row, kind, defaults).map_err(|e| row.wrong(e))?);
            self.lines.push(Line { file: self.files.len(), line: row.line() });
            self.times.push(optional(&row, TIME).map_err(|e| row.wrong(e))?);
        }
        if rows.is_empty() {
            return Err(Failure::new(exit::DATA, format!("{name}: the table has no rows")));
        }
        let sha256 = format!("{:x}", Sha256::digest(&bytes));
        self.files.push(InputFile { path: path.to_owned(), kind, rows: rows.len(), sha256 });
        Ok(rows)
    }
}

/// Gives each run but the one with most references a zero of its own; returns their number.
fn zeros(names: &[Option<String>], points: &mut [Point]) -> usize {
    let mut runs: Vec<&Option<String>> = Vec::new();
    for name in names {
        if !runs.contains(&name) {
            runs.push(name);
        }
    }
    let referenced: Vec<bool> = points.iter().map(|p| p.reference.iter().any(Option::is_some)).collect();
    let size = |run: &&Option<String>| {
        names.iter().zip(&referenced).filter(|(name, referenced)| name == run && **referenced).count()
    };
    // Of several largest ones, the first: `max_by_key` returns the last.
    let Some(common) = runs.iter().copied().rev().max_by_key(size) else { return 0 };
    runs.retain(|run| *run != common);
    for (name, point) in names.iter().zip(points) {
        point.run = runs.iter().position(|run| *run == name);
    }
    runs.len()
}

fn point(row: &Row<'_>, kind: &str, defaults: Defaults) -> Result<Named, RowError> {
    row.check_width()?;
    let mut point = Point {
        spots: [f64::NAN; 6],
        spot_deviations: [defaults.spot; 6],
        powers: [f64::NAN; 3],
        power_deviations: [f64::NAN; 3],
        reference: [None; 6],
        steering: None,
        run: None,
    };
    for (i, name) in SPOTS.iter().enumerate() {
        point.spots[i] = length(row, name)?.unwrap_or(f64::NAN);
        point.spot_deviations[i] = deviation(row, &format!("std_{name}"))?.unwrap_or(defaults.spot);
    }
    for (i, name) in POWERS.iter().enumerate() {
        point.powers[i] = optional(row, name)?.unwrap_or(f64::NAN);
        let own = deviation(row, &format!("std_{name}"))?;
        point.power_deviations[i] = own.unwrap_or(defaults.power * point.powers[i]);
    }
    let mut stage = [None; 2];
    for (known, name) in stage.iter_mut().zip(STAGE) {
        let own = deviation(row, &format!("std_{name}"))?.unwrap_or(defaults.readback);
        *known = length(row, name)?.map(|value| Known { value, deviation: own });
    }
    if let [Some(x), Some(y)] = stage {
        point.steering = Some([x, y]);
    }
    let mut run = None;
    if kind == "points" {
        for (i, name) in POSE.iter().enumerate() {
            let column = format!("ref_{name}");
            let Some(value) = length(row, &column)? else { continue };
            let Some(deviation) = deviation(row, &format!("ref_std_{name}"))? else {
                return Err(RowError::Other(format!(
                    "{column} has a value, but ref_std_{name} does not: state the standard uncertainty of the \
                     reference"
                )));
            };
            point.reference[i] = Some(Known { value, deviation });
        }
        run = Some(row.text(RUN)?).filter(|run| !run.is_empty()).map(str::to_owned);
    }
    Ok((point, run))
}

/// A number; `None` if the column does not exist, the field is empty or NaN.
fn optional(row: &Row<'_>, column: &str) -> Result<Option<f64>, RowError> {
    let text = row.text(column)?;
    if text.is_empty() || text.eq_ignore_ascii_case("nan") { Ok(None) } else { row.number(column).map(Some) }
}

/// Metres or radians. A larger number is in another unit.
fn length(row: &Row<'_>, column: &str) -> Result<Option<f64>, RowError> {
    let value = optional(row, column)?;
    match value {
        Some(value) if value.abs() > 10.0 => Err(RowError::Field {
            column: column.to_owned(),
            text: value.to_string(),
            allowed: "-10 to 10; use metres and radians".to_owned(),
        }),
        value => Ok(value),
    }
}

fn deviation(row: &Row<'_>, column: &str) -> Result<Option<f64>, RowError> {
    match optional(row, column)? {
        Some(value) if value <= 0.0 => Err(RowError::Field {
            column: column.to_owned(),
            text: value.to_string(),
            allowed: "a standard uncertainty above 0".to_owned(),
        }),
        value => Ok(value),
    }
}
