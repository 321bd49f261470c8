//! The file of the planned poses: CSV with `kind` (`tare` or `point`) and the six coordinates.

use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

use trifacet_optics::Pose;
use trifacet_optics::calibration::plan::Planned;
use trifacet_wire::layout::POSE;

use crate::exit::{self, Failure};
use crate::text::table::{Layout, Row, RowError, Table};

const KIND: &str = "kind";
/// Largest planned translation, metres, and rotation, radians: a larger number is in another unit.
const LARGEST: [f64; 2] = [0.05, 0.5];

/// Writes the poses in their order.
///
/// # Errors
/// The file cannot be written.
pub fn write(poses: &[Planned], mut to: impl Write) -> io::Result<()> {
    writeln!(to, "{KIND},{}", POSE.join(","))?;
    for Planned { tare, pose } in poses {
        let numbers = pose.to_array().map(|x| format!("{x:e}")).join(",");
        writeln!(to, "{},{numbers}", if *tare { "tare" } else { "point" })?;
    }
    to.flush()
}

/// Reads the poses. Without the column `kind` every row is a point.
///
/// # Errors
/// The file cannot be read ([`exit::IO`]), or a row is not a pose ([`exit::DATA`]); the message names the line.
pub fn read(file: &Path) -> Result<Vec<Planned>, Failure> {
    let name = file.display().to_string();
    let bytes = File::open(file).map_err(|e| Failure::new(exit::IO, format!("cannot read {name}: {e}")))?;
    let layout = Layout { needed: &POSE, optional: &[KIND], aliases: &[], comments: true };
    let mut table = Table::open(name.clone(), bytes, layout)?;
    let mut poses = Vec::new();
    while let Some(row) = table.next_row()? {
        poses.push(planned(&row).map_err(|e| row.wrong(e))?);
    }
    if poses.is_empty() {
        return Err(Failure::new(exit::DATA, format!("{name} contains no pose")));
    }
    Ok(poses)
}

fn planned(row: &Row<'_>) -> Result<Planned, RowError> {
    row.check_width()?;
    let tare = row.has(KIND)
        && row.parse(KIND, "tare or point", |text| match text {
            "tare" => Some(true),
            "point" => Some(false),
            _ => None,
        })?;
    let mut numbers = [0.0; 6];
    for (i, (x, column)) in numbers.iter_mut().zip(POSE).enumerate() {
        *x = row.number(column)?;
        let (most, unit) = if i < 3 { (LARGEST[0], "m") } else { (LARGEST[1], "rad") };
        if x.abs() > most {
            return Err(RowError::Other(format!("{column} is {x}: allowed is -{most} to {most} {unit}")));
        }
    }
    Ok(Planned { tare, pose: Pose::from_array(numbers) })
}
