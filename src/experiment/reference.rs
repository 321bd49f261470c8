//! Reads a CSV file with interferometer readings: the position of the mirror at each point.

use std::collections::BTreeMap;
use std::path::Path;

use super::protocol::Course;
use super::quantity;
use super::reading::{axis, open};
use crate::config::Axis;
use crate::exit::{self, Failure};
use crate::text::table::{Row, RowError};

/// Columns of the file. `unit` is that of `reference`; `point` counts from 1.
pub const COLUMNS: [&str; 4] = ["axis", "unit", "point", "reference"];

/// Why a file does not contain the points of an axis.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
enum PointsError {
    /// There is no point of any axis.
    #[error("the file contains no readings")]
    Empty,
    /// A point is missing before another one.
    #[error("point {missing} of {} is missing, but point {found} exists", axis.name())]
    Gap { axis: Axis, missing: u32, found: u32 },
}

/// Reads the points of each axis, in the order of a pose, metres or radians.
///
/// # Errors
/// Fails if the file cannot be read or contains an error. The message contains file and line.
pub fn read(file: &Path) -> Result<Vec<Course>, Failure> {
    let mut table = open(file, &COLUMNS)?;
    let mut found: BTreeMap<(usize, u32), f64> = BTreeMap::new();
    while let Some(row) = table.next_row()? {
        let (axis, point, reference) = point(&row).map_err(|e| row.wrong(e))?;
        if found.insert((axis as usize, point), reference).is_some() {
            return Err(row.wrong(format!("point {point} of {} occurs twice", axis.name())));
        }
    }
    courses(&found).map_err(|what| Failure::new(exit::DATA, format!("{}: {what}", file.display())))
}

/// Axis, number and reference of a point.
fn point(row: &Row<'_>) -> Result<(Axis, u32, f64), RowError> {
    row.check_width()?;
    let axis = axis(row)?;
    let allowed = format!("one of {} for {}", quantity::allowed(axis), axis.name());
    let si = row.parse("unit", &allowed, |name| quantity::unit(axis, name))?;
    let point = row.parse("point", "1, 2, 3, ...", |text| text.parse().ok().filter(|n| *n > 0))?;
    Ok((axis, point, row.number("reference")? * si))
}

/// The courses of all axes that have points.
fn courses(found: &BTreeMap<(usize, u32), f64>) -> Result<Vec<Course>, PointsError> {
    let courses = Axis::ALL.into_iter().map(|axis| course(axis, found));
    let courses: Vec<_> =
        courses.filter(|c| !matches!(c, Ok(c) if c.points.is_empty())).collect::<Result<_, _>>()?;
    if courses.is_empty() { Err(PointsError::Empty) } else { Ok(courses) }
}

fn course(axis: Axis, found: &BTreeMap<(usize, u32), f64>) -> Result<Course, PointsError> {
    let own = found.range((axis as usize, 0)..=(axis as usize, u32::MAX));
    let mut points = Vec::new();
    for ((_, point), reference) in own {
        let missing = points.len() as u32 + 1;
        if *point != missing {
            return Err(PointsError::Gap { axis, missing, found: *point });
        }
        points.push(*reference);
    }
    Ok(Course { axis, points })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(rows: &str) -> Result<Vec<Course>, Failure> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), format!("point,axis,reference,unit\n{rows}")).unwrap();
        read(file.path())
    }

    #[test]
    fn points_come_in_any_order_and_in_their_units() {
        let courses = of("2,yaw,1,arcsec\n1,yaw,0,urad\n1,tx,-1.5,um\n").unwrap();
        assert_eq!(courses[0], Course { axis: Axis::Tx, points: vec![-1.5e-6] });
        assert_eq!(courses[1].axis, Axis::Yaw);
        assert!((courses[1].points[1] - 4.848_136_8e-6).abs() < 1e-13);
    }

    #[test]
    fn errors_are_named() {
        for (rows, expected) in [
            ("", "no readings"),
            ("1,tx,0,urad\n", ":2: unit is \"urad\": allowed is one of um, nm, mm, m for tx"),
            ("1,x,0,um\n", "allowed is tx, ty, tz, roll, pitch or yaw"),
            ("0,tx,0,um\n", "point is \"0\""),
            ("1,tx,zero,um\n", "reference is \"zero\": allowed is a finite number"),
            ("1,tx,0,um\n1,tx,1,um\n", ":3: point 1 of tx occurs twice"),
            ("1,tx,0,um\n3,tx,1,um\n", "point 2 of tx is missing, but point 3 exists"),
            ("1,tx,0\n", ":2: 3 fields where the header has 4"),
        ] {
            let error = of(rows).unwrap_err().message;
            assert!(error.contains(expected), "{error}");
        }
    }
}
