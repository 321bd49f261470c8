//! CSV by column names, in which whatever is wrong is named with its line.

use std::path::Path;

use csv::StringRecord;

use super::quantity::plain;
use crate::exit::{self, Failure};

/// A CSV file whose header is read.
pub struct CsvInput {
    name: String,
    reader: csv::Reader<std::fs::File>,
    columns: Vec<String>,
}

/// One row of it.
pub struct Row<'s> {
    sheet: &'s str,
    columns: &'s [String],
    line: u64,
    record: StringRecord,
}

impl CsvInput {
    /// Opens a file that must have these columns, in any order; others are ignored, and so are lines that begin with #.
    ///
    /// # Errors
    /// It cannot be read, or a column is missing, or there twice.
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
                _ => "is there twice",
            };
            let needed = needed.join(",");
            let message = format!("{name}: the column {column} {what}; needed are {needed}");
            return Err(Failure::new(exit::DATA, message));
        }
        Ok(Self { name, reader, columns })
    }

    /// The next row.
    ///
    /// # Errors
    /// It cannot be read, or has not as many fields as the header.
    pub fn next_row(&mut self) -> Result<Option<Row<'_>>, Failure> {
        let mut record = StringRecord::new();
        let read = self.reader.read_record(&mut record);
        let read = read.map_err(|e| Failure::new(exit::DATA, format!("{}: {e}", self.name)))?;
        let line = record.position().map_or(0, csv::Position::line);
        Ok(read.then_some(Row { sheet: &self.name, columns: &self.columns, line, record }))
    }
}

impl Row<'_> {
    /// A field as it is written; "" where there is no such column.
    pub fn text(&self, column: &str) -> &str {
        let place = self.columns.iter().position(|c| c == column);
        place.and_then(|place| self.record.get(place)).unwrap_or_default()
    }

    /// A field as this, if it can be that; `what` says what is allowed.
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
    pub fn number(&self, column: &str) -> Result<f64, Failure> {
        self.parse(column, "a finite number", |text| plain(text).parse().ok().filter(|x: &f64| x.is_finite()))
    }

    /// A field as a count.
    pub fn count<T: std::str::FromStr>(&self, column: &str) -> Result<T, Failure> {
        self.parse(column, "a whole number", |text| text.parse().ok())
    }

    /// What is wrong with this row.
    pub fn wrong(&self, what: &str) -> Failure {
        Failure::new(exit::DATA, format!("{}:{}: {what}", self.sheet, self.line))
    }
}
