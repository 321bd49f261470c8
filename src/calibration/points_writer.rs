//! The files of a calibration run: a row per point or per position of a scan.
//!
//! The columns are the nine signals before correction tables and power gains, their standard uncertainties, the pose
//! by the reference with its uncertainties (not in a scan), and the position of the steering. What is not measured is
//! empty. `point`, `time_s` and `samples` tell where a row comes from; the fit uses `time_s` for drift.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

use trifacet_wire::layout::{POSE, SPOTS};

use super::points::{POWERS, STAGE};
use super::reading::Reading;
use crate::exit::{self, Failure};
use crate::text::table::{Layout, Table};

/// Where a row comes from.
const ORIGIN: [&str; 3] = ["point", "time_s", "samples"];

/// What a file contains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Contents {
    /// Points with a reference.
    Points,
    /// Positions of the steering while the mirror is at rest.
    Scan,
}

/// The pose by the reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reference {
    /// tx, ty, tz, roll, pitch, yaw, metres and radians.
    pub pose: [f64; 6],
    /// Their standard uncertainties.
    pub sigmas: [f64; 6],
}

/// A file of points. Each row is complete on disk before the next one is measured.
#[derive(Debug)]
pub struct PointsFile {
    file: File,
}

impl PointsFile {
    /// A new file.
    ///
    /// # Errors
    /// The file exists, or cannot be written.
    pub fn create(path: &Path, contents: Contents) -> io::Result<Self> {
        let mut file = OpenOptions::new().write(true).create_new(true).open(path)?;
        writeln!(file, "{}", columns(contents).join(","))?;
        Ok(Self { file })
    }

    /// Continues a file of points. Returns the numbers of the points that it contains. A last line without an end,
    /// which a failure of the power can leave, is removed.
    ///
    /// # Errors
    /// The file cannot be read or written, or is not a file of points.
    pub fn resume(path: &Path) -> Result<(Self, Vec<u32>), Failure> {
        let failed =
            |e: io::Error| Failure::new(exit::IO, format!("cannot continue {}: {e}", path.display()));
        let bytes = std::fs::read(path).map_err(failed)?;
        let whole = bytes.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
        let columns = columns(Contents::Points);
        let needed: Vec<&str> = columns.iter().map(String::as_str).collect();
        let layout = Layout { needed: &needed, optional: &[], aliases: &[], comments: false };
        let mut table = Table::open(path.display().to_string(), &bytes[..whole], layout)?;
        let mut points = Vec::new();
        while let Some(row) = table.next_row()? {
            let point = row.check_width().and_then(|()| row.count("point"));
            points.push(point.map_err(|e| row.wrong(e))?);
        }
        let file = OpenOptions::new().append(true).open(path).map_err(failed)?;
        file.set_len(whole as u64).map_err(failed)?;
        Ok((Self { file }, points))
    }

    /// Appends a row. `reference` is `None` in a scan. `time_s`: UTC, seconds since 1970.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn append(
        &mut self,
        point: u32,
        time_s: f64,
        reading: &Reading,
        reference: Option<&Reference>,
    ) -> io::Result<()> {
        let Reading { spots, powers, spot_sigmas, power_sigmas, stage, samples, .. } = reading;
        let signals = spots.iter().chain(powers).chain(spot_sigmas).chain(power_sigmas);
        let reference = reference.iter().flat_map(|r| r.pose.iter().chain(&r.sigmas));
        let mut fields: Vec<String> = signals.chain(reference).map(|x| field(*x)).collect();
        fields.extend(stage.unwrap_or([f64::NAN; 2]).map(field));
        fields.extend([point.to_string(), format!("{time_s:.3}"), samples.to_string()]);
        let line = fields.join(",") + "\n";
        self.file.write_all(line.as_bytes())?;
        self.file.sync_data()
    }
}

/// The shortest text that reproduces a number; empty for what is not measured.
fn field(number: f64) -> String {
    if number.is_finite() { format!("{number:e}") } else { String::new() }
}

fn columns(contents: Contents) -> Vec<String> {
    let own = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
    let with =
        |prefix: &str, names: &[&str]| names.iter().map(|name| format!("{prefix}{name}")).collect::<Vec<_>>();
    let signals = [&SPOTS[..], &POWERS].concat();
    let mut columns = [own(&signals), with("std_", &signals)].concat();
    if contents == Contents::Points {
        columns.extend([with("ref_", &POSE), with("ref_std_", &POSE)].concat());
    }
    columns.extend([own(&STAGE), own(&ORIGIN)].concat());
    columns
}

#[cfg(test)]
mod tests {
    use trifacet_core::time::Mono;

    use super::*;

    #[test]
    fn a_file_is_continued_without_its_incomplete_line() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("points.csv");
        let reading = Reading {
            time: Mono(0),
            spots: [1.0 / 3.0; 6],
            spot_sigmas: [1e-7; 6],
            powers: [2e-4; 3],
            power_sigmas: [1e-8; 3],
            stage: None,
            samples: 100,
            left_out: 0,
        };
        let reference = Reference { pose: [f64::NAN, 1.0, 2.0, 3.0, 4.0, 5.0], sigmas: [1e-7; 6] };
        let mut file = PointsFile::create(&path, Contents::Points).unwrap();
        file.append(1, 0.5, &reading, Some(&reference)).unwrap();
        drop(file);
        let whole = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, format!("{whole}0.1,0.2")).unwrap();
        let (mut file, points) = PointsFile::resume(&path).unwrap();
        assert_eq!(points, [1]);
        file.append(2, 1.5, &reading, Some(&reference)).unwrap();
        assert_eq!(PointsFile::resume(&path).unwrap().1, [1, 2]);
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.starts_with("u_a_m,v_a_m,u_b_m,") && text.contains(",ref_tx_m,"), "{text}");
        let row: Vec<&str> = text.lines().nth(1).unwrap().split(',').collect();
        assert_eq!((row[0].parse::<f64>().unwrap(), row[18], row[19]), (1.0 / 3.0, "", "1e0"));
        assert_eq!(&row[30..], ["", "", "1", "0.500", "100"]);
        assert!(PointsFile::create(&path, Contents::Points).is_err(), "nothing is written over");
    }
}
