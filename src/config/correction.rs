//! Reads the file of a correction table: CSV with the columns `u_m, v_m, du_m, dv_m`, see [`Correction`].

use trifacet_core::channels::correction::{Correction, CorrectionError, CorrectionPoint};

/// Why a file is not a valid correction table.
#[derive(Debug, thiserror::Error)]
pub enum CorrectionFileError {
    /// A row does not consist of four numbers.
    #[error("{0}")]
    Csv(#[from] csv::Error),
    /// The points do not form a grid.
    #[error(transparent)]
    Table(#[from] CorrectionError),
}

/// A row of the file. The field names are the column names.
#[derive(serde::Deserialize)]
#[expect(clippy::struct_field_names, reason = "the columns carry their unit")]
struct Row {
    u_m: f64,
    v_m: f64,
    du_m: f64,
    dv_m: f64,
}

/// Parses a correction table for a PSD whose half edge length is `half_size` metres.
///
/// # Errors
/// Fails if a row does not consist of four numbers, or if the points do not form a valid table.
pub fn parse_correction(text: &[u8], half_size: f64) -> Result<Correction, CorrectionFileError> {
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).comment(Some(b'#')).from_reader(text);
    let point = |Row { u_m: u, v_m: v, du_m: du, dv_m: dv }| CorrectionPoint { u, v, du, dv };
    let points: Vec<_> = reader.deserialize().map(|row| row.map(point)).collect::<Result<_, _>>()?;
    Ok(Correction::new(&points, half_size)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_may_have_comments_and_spaces_and_a_row_that_is_not_four_numbers_is_named() {
        let text = "# PSD A\nu_m, v_m, du_m, dv_m\n-7e-3,-7e-3,1e-6,0\n7e-3,-7e-3,1e-6,0\n-7e-3,7e-3,1e-6,0\n7e-3, 7e-3, 1e-6, 0\n";
        let table = parse_correction(text.as_bytes(), 6.5e-3).unwrap();
        assert!((table.apply([0.0; 2])[0] - 1e-6).abs() < 1e-15);
        let say = |text: String| parse_correction(text.as_bytes(), 6.5e-3).unwrap_err().to_string();
        assert!(say(format!("{text}1,2,3\n")).contains("line: 7"), "{}", say(format!("{text}1,2,3\n")));
        assert!(say(format!("{text}1,2,3,x\n")).contains("invalid float"));
        assert!(say(format!("{text}1,2,3,4\n")).contains("row 5"));
    }
}
