//! Reads CSV files by column names. Errors contain the line.

use std::path::Path;

use csv::StringRecord;

use super::quantity::plain;
use crate::exit::{self, Failure};

/// A CSV file after its header was read.
pub struct CsvInput {
    name: String,
    reader: csv::Reader<std::fs::File>,
    columns: Vec<String>,
}

/// One row of the file.
pub struct Row<'s> {
    sheet: &'s str,
    columns: &'s [String],
    line: u64,
    record: StringRecord,
}

impl CsvInput {
    /// Opens a file that must have these columns, in any order. Other columns, and lines that begin with #,
    /// are ignored.
    ///
    /// # Errors
    /// Fails if the file cannot be read, or if a column is missing or occurs twice.
    pub fn open(file: &Path, needed: &[&str]) -> Result<Self, Failure> {
        let name = file.display().to_string();
        let cannot = |e: &dyn std::fmt::Display| Failure::new(exit::IO, format!("cannot read {name}: {e}"));
        let opened = std::fs::File::open(file).map_err(|e| cannot(&e))?;
        let mut reader =
            csv::ReaderBuilder::new().trim(csv::Trim::All).comment(Some(b'#')).from_reader(opened);
        let header = reader.headers().map_err(|e| cannot(&e))?;
        let columns: Vec<String> =
            header.iter().map(|c| c.trim_start_matches('\u{feff}').to_owned()).collect();
        for column in needed {
            let what = match columns.iter().filter(|c| c == column).count() {
                0 => "is missing",
                1 => continue,
                _ => "occurs twice",
            };
            let needed = needed.join(",");
            let message = format!("{name}: the column {column} {what}; required are {needed}");
            return Err(Failure::new(exit::DATA, message));
        }
        Ok(Self { name, reader, columns })
    }

    /// The next row. `None` at the end of the file.
    ///
    /// # Errors
    /// Fails if the row cannot be read, or if its number of fields differs from that of the header.
    pub fn next_row(&mut self) -> Result<Option<Row<'_>>, Failure> {
        let mut record = StringRecord::new();
        let read = self.reader.read_record(&mut record);
        let read = read.map_err(|e| Failure::new(exit::DATA, format!("{}: {e}", self.name)))?;
        let line = record.position().map_or(0, csv::Position::line);
        Ok(read.then_some(Row { sheet: &self.name, columns: &self.columns, line, record }))
    }
}

impl Row<'_> {
    /// A field as text; "" if the column does not exist.
    pub fn text(&self, column: &str) -> &str {
        let place = self.columns.iter().position(|c| c == column);
        place.and_then(|place| self.record.get(place)).unwrap_or_default()
    }

    /// A field parsed by `parse`. `what` states the allowed values, for the error message.
    ///
    /// # Errors
    /// Fails if `parse` returns `None`.
    pub fn parse<T>(
        &self,
        column: &str,
        what: &str,
        parse: impl Fn(&str) -> Option<T>,
    ) -> Result<T, Failure> {
        let text = self.text(column);
        parse(text).ok_or_else(|| self.wrong(&format!("{column} is \"{text}\": allowed is {what}")))
    }

    /// A field as a finite number.
    ///
    /// # Errors
    /// Fails if the field is not a finite number.
    pub fn number(&self, column: &str) -> Result<f64, Failure> {
        self.parse(column, "a finite number", |text| plain(text).parse().ok().filter(|x: &f64| x.is_finite()))
    }

    /// A field as a whole number.
    ///
    /// # Errors
    /// Fails if the field is not a whole number within the range of the type.
    pub fn count<T: std::str::FromStr>(&self, column: &str) -> Result<T, Failure> {
        self.parse(column, "a whole number", |text| text.parse().ok())
    }

    /// An error message for this row.
    pub fn wrong(&self, what: &str) -> Failure {
        Failure::new(exit::DATA, format!("{}:{}: {what}", self.sheet, self.line))
    }
}
