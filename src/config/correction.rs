//! Reads the file of a correction table: CSV with the columns `u_m, v_m, du_m, dv_m`, and optionally `covered`, see
//! [`Correction`].

use trifacet_core::channels::correction::{Correction, CorrectionError, CorrectionPoint};

use crate::exit::Failure;
use crate::text::table::{Layout, Row, RowError, Table};

/// Columns of the file.
const COLUMNS: [&str; 4] = ["u_m", "v_m", "du_m", "dv_m"];
/// Whether measurements support the point: 1 or 0. Without this column, all points count as supported.
const COVERED: &str = "covered";

/// Why a file is not a valid correction table.
#[derive(Debug, thiserror::Error)]
pub enum CorrectionFileError {
    /// The file is not a table of numbers with the four columns.
    #[error(transparent)]
    Numbers(#[from] Failure),
    /// The points do not form a grid.
    #[error("{name}: {source}")]
    Grid {
        /// Name of the file.
        name: String,
        /// The wrong point.
        source: CorrectionError,
    },
}

/// Parses a correction table for a PSD whose half edge length is `half_size` metres. `name` is the name of
/// the file in messages.
///
/// # Errors
/// Fails if a row does not consist of numbers, or if the points do not form a valid table.
pub fn parse_correction(name: &str, text: &[u8], half_size: f64) -> Result<Correction, CorrectionFileError> {
    let mut table = Table::open(
        name,
        text,
        Layout { needed: &COLUMNS, optional: &[COVERED], aliases: &[], comments: true },
    )?;
    let mut points = Vec::new();
    while let Some(row) = table.next_row()? {
        points.push(point(&row).map_err(|e| row.wrong(e))?);
    }
    Correction::new(&points, half_size)
        .map_err(|source| CorrectionFileError::Grid { name: name.to_owned(), source })
}

fn point(row: &Row<'_>) -> Result<CorrectionPoint, RowError> {
    row.check_width()?;
    let [u, v, du, dv] = COLUMNS.map(|column| row.number(column));
    let covered = if row.has(COVERED) { row.parse(COVERED, "0 or 1", zero_or_one)? } else { true };
    Ok(CorrectionPoint { u: u?, v: v?, du: du?, dv: dv?, covered })
}

fn zero_or_one(text: &str) -> Option<bool> {
    match text {
        "0" => Some(false),
        "1" => Some(true),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_may_have_comments_and_spaces_and_a_row_that_is_not_four_numbers_is_named() {
        let text = "# PSD A\nu_m, v_m, du_m, dv_m\n-7e-3,-7e-3,1e-6,0\n7e-3,-7e-3,1e-6,0\n-7e-3,7e-3,1e-6,0\n7e-3, 7e-3, 1e-6, 0\n";
        let table = parse_correction("a.csv", text.as_bytes(), 6.5e-3).unwrap();
        assert!((table.apply([0.0; 2]).spot[0] - 1e-6).abs() < 1e-15);
        let say = |text: String| parse_correction("a.csv", text.as_bytes(), 6.5e-3).unwrap_err().to_string();
        assert_eq!(say(format!("{text}1,2,3\n")), "a.csv:7: 3 fields where the header has 4");
        assert!(
            say(format!("{text}1,2,3,x\n")).starts_with("a.csv:7: dv_m is \"x\": allowed is a finite number")
        );
        assert!(say(format!("{text}1,2,3,4\n")).contains("row 5"));
    }

    #[test]
    fn a_fifth_column_states_which_points_measurements_support() {
        let text = "u_m,v_m,du_m,dv_m,covered\n-7e-3,-7e-3,0,0,1\n0,-7e-3,0,0,1\n7e-3,-7e-3,0,0,0\n\
                    -7e-3,7e-3,0,0,1\n0,7e-3,0,0,1\n7e-3,7e-3,0,0,0\n";
        let table = parse_correction("a.csv", text.as_bytes(), 6.5e-3).unwrap();
        assert!(table.apply([-1e-3, 0.0]).covered && !table.apply([1e-3, 0.0]).covered);
        let wrong = parse_correction("a.csv", text.replace(",1\n", ",yes\n").as_bytes(), 6.5e-3);
        let wrong = wrong.unwrap_err().to_string();
        assert_eq!(wrong, "a.csv:2: covered is \"yes\": allowed is 0 or 1");
    }
}
