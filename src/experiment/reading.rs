//! Readings of the sensor with their references, and their file format.

use std::collections::HashSet;
use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;

use trifacet_wire::Status;
use trifacet_wire::layout::{DEVIATIONS, POSE};

use super::observation::Observation;
use crate::config::Axis;
use crate::exit::{self, Failure};
use crate::text::TextReader;
use crate::text::table::{Layout, Row, RowError, Table};

/// Part of the experiment to which a reading belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The points of Table 2 in the paper.
    Table2,
    /// The same points with a better converter, less noise and averaging.
    Beyond,
    /// The record with the mirror at rest.
    StaticRecord,
}

impl Part {
    const ALL: [Part; 3] = [Part::Table2, Part::Beyond, Part::StaticRecord];

    fn name(self) -> &'static str {
        match self {
            Part::Table2 => "table2",
            Part::Beyond => "beyond",
            Part::StaticRecord => "rest",
        }
    }
}

/// A reading with its position in the experiment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Part of the experiment.
    pub part: Part,
    /// The axis that is moved, and its reference, metres or radians. `None` at rest.
    pub moved: Option<(Axis, f64)>,
    /// Number of the point on its axis, from 1; 0 at rest.
    pub point: u32,
    /// Number of the reading at its point, from 1.
    pub number: u32,
    /// The output of the sensor.
    pub look: Observation,
}

/// Readings with their source and the options of the measurement.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Record {
    /// Description of the source; "" if the file does not contain it.
    pub source: String,
    /// Description of the options. Readings with different options must not be combined.
    pub options: String,
    /// Readings in the order of measurement.
    pub readings: Vec<Reading>,
}

/// Prefixes of the lines with the source and with the options.
const HEAD: [&str; 2] = ["# source: ", "# options: "];

/// Names of all columns, in order.
fn columns() -> Vec<&'static str> {
    let first = ["part", "axis", "point", "reading", "time_ns", "reference_si"];
    let last = ["averaged", "config", "status"];
    [&first[..], &POSE, &DEVIATIONS, &last].concat()
}

/// Writes readings as CSV, in SI units, after two comment lines with source and options.
///
/// # Errors
/// Fails if the writer fails.
pub fn write(record: &Record, to: impl Write) -> std::io::Result<()> {
    let mut out = std::io::BufWriter::new(to);
    for (name, text) in HEAD.iter().zip([&record.source, &record.options]) {
        writeln!(out, "{name}{}", text.replace(['\n', '\r'], " "))?;
    }
    writeln!(out, "{}", columns().join(","))?;
    for Reading { part, moved, point, number, look } in &record.readings {
        let (axis, reference) =
            moved.map_or(("", String::new()), |(axis, x)| (axis.name(), format!("{x:e}")));
        write!(out, "{},{axis},{point},{number},{},{reference}", part.name(), look.time_ns)?;
        for x in look.pose {
            write!(out, ",{x:e}")?;
        }
        for x in look.sigmas {
            write!(out, ",{x:e}")?;
        }
        let status: Vec<_> = look.status.names().collect();
        writeln!(out, ",{},{},{}", look.averaged, look.config, status.join(" "))?;
    }
    out.flush()
}

/// Reads a file that [`write()`] wrote.
///
/// # Errors
/// Fails if the file cannot be read or contains an error. The message contains file and line.
pub fn read(file: &Path) -> Result<Record, Failure> {
    let mut table = open(file, &columns())?;
    let mut readings = Vec::new();
    let mut seen = HashSet::new();
    while let Some(row) = table.next_row()? {
        let reading = reading(&row).map_err(|e| row.wrong(e))?;
        let axis = reading.moved.map(|(axis, _)| axis as usize);
        if !seen.insert((reading.part as usize, axis, reading.point, reading.number)) {
            return Err(row.wrong("this reading occurs twice"));
        }
        readings.push(reading);
    }
    if readings.is_empty() {
        return Err(Failure::new(exit::DATA, format!("{}: the file contains no readings", file.display())));
    }
    let [source, options] =
        head(file).map_err(|e| Failure::new(exit::IO, format!("cannot read {}: {e}", file.display())))?;
    Ok(Record { source, options, readings })
}

/// Opens a table that must have these columns. Lines that begin with # are comments.
pub(super) fn open(file: &Path, needed: &[&str]) -> Result<Table<File>, Failure> {
    let name = file.display().to_string();
    let bytes = File::open(file).map_err(|e| Failure::new(exit::IO, format!("cannot read {name}: {e}")))?;
    Table::open(name, bytes, Layout { needed, optional: &[], aliases: &[], comments: true })
}

fn head(file: &Path) -> std::io::Result<[String; 2]> {
    let mut head = [String::new(), String::new()];
    for line in BufReader::new(TextReader::new(File::open(file)?)?).lines() {
        let line = line?;
        if !line.starts_with('#') {
            break;
        }
        for (text, name) in head.iter_mut().zip(HEAD) {
            if let Some(said) = line.strip_prefix(name) {
                // A spreadsheet program adds a separator for each empty field.
                said.trim_end_matches([',', ';', '\t', ' ']).trim().clone_into(text);
            }
        }
    }
    Ok(head)
}

fn reading(row: &Row<'_>) -> Result<Reading, RowError> {
    row.check_width()?;
    let part =
        row.parse("part", "table2, beyond or rest", |text| Part::ALL.into_iter().find(|p| p.name() == text))?;
    let moved = match part {
        Part::StaticRecord => None,
        _ => Some((axis(row)?, row.number("reference_si")?)),
    };
    let six = |names: &[&str; 6]| -> Result<[f64; 6], RowError> {
        let mut six = [0.0; 6];
        for (x, column) in six.iter_mut().zip(names) {
            *x = row.number(column)?;
        }
        Ok(six)
    };
    let bit = |name: &str| Status::NAMES.iter().find(|(_, n)| *n == name).map(|(bit, _)| *bit);
    let bits =
        |text: &str| text.split_whitespace().try_fold(Status::default(), |all, name| Some(all | bit(name)?));
    let status = row.parse("status", "names of status bits separated by blanks", bits)?;
    if !status.has(Status::POSE_VALID) {
        let what = "its status does not contain POSE_VALID: it is not a reading";
        return Err(RowError::Other(what.into()));
    }
    let sigmas = six(&DEVIATIONS)?.map(|x| x as f32);
    if !sigmas.iter().all(|x| *x > 0.0 && x.is_finite()) {
        return Err(RowError::Other("a standard uncertainty (sd_...) is not above 0".into()));
    }
    Ok(Reading {
        part,
        moved,
        point: row.count("point")?,
        number: row.count("reading")?,
        look: Observation {
            time_ns: row.count("time_ns")?,
            pose: six(&POSE)?,
            sigmas,
            averaged: row.count("averaged")?,
            config: row.count("config")?,
            status,
        },
    })
}

/// Parses the axis of a row.
pub(super) fn axis(row: &Row<'_>) -> Result<Axis, RowError> {
    row.parse("axis", "tx, ty, tz, roll, pitch or yaw", |text| {
        Axis::ALL.into_iter().find(|a| a.name() == text)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::observation::tests::look;

    #[test]
    fn readings_survive_a_round_trip() {
        let moved = Some((Axis::Pitch, -1.0 / 3.0e6));
        let status = Status::POSE_VALID | Status::SIMULATED;
        let one =
            Observation { status, pose: [1.0 / 3.0, -2.0 / 3.0e7, 0.0, 1e-9, 5.0, 6.0], ..look(-5, 0.0) };
        let readings = vec![
            Reading { part: Part::Table2, moved, point: 2, number: 50, look: one },
            Reading { part: Part::Beyond, moved, point: 3, number: 1, look: look(7, 1e-6) },
            Reading { part: Part::StaticRecord, moved: None, point: 0, number: 9, look: look(8, 2e-6) },
        ];
        let file = tempfile::NamedTempFile::new().unwrap();
        let record = Record { source: "tcp://lab:7361".into(), options: "50 readings".into(), readings };
        write(&record, file.as_file()).unwrap();
        assert_eq!(read(file.path()).unwrap(), record);
        let text = std::fs::read_to_string(file.path()).unwrap();
        let bare = text.lines().skip(2).flat_map(|line| [line, "\n"]).collect::<String>();
        std::fs::write(file.path(), bare).unwrap();
        let Record { source, readings, .. } = read(file.path()).unwrap();
        assert_eq!((source, readings), (String::new(), record.readings));
    }
}
