//! Tables of numbers as CSV.
//!
//! Columns are identified by name, in any order. A bad row does not stop the conversion. All results are written
//! before more input is awaited, so that a program can write a row and wait for its result.

use std::cell::RefCell;
use std::fmt::Display;
use std::fs::File;
use std::io::{self, Read, Stdout, Write};
use std::path::Path;
use std::rc::Rc;

use anyhow::Context;
use csv::ByteRecord;
use trifacet::exit::{self, Failure};

use super::written;

/// A column of the input.
pub(crate) struct Column {
    pub(crate) name: &'static str,
    /// Another name for the same quantity, in any unit.
    pub(crate) alias: Option<&'static str>,
    /// Value if the input lacks this column. `None`: the column is required.
    pub(crate) default: Option<f64>,
}

/// A row of the output.
pub(crate) struct Row {
    pub(crate) cells: Vec<String>,
    /// The error of the row, if there is one.
    pub(crate) problem: Option<String>,
}

/// Why a row does not consist of numbers.
#[derive(Debug, thiserror::Error)]
pub(crate) enum RowError {
    /// The row has more or fewer fields than the header.
    #[error("{found} fields where the header has {expected}")]
    Width { found: usize, expected: usize },
    /// A field is empty, as in the tables of `watch` and `export`.
    #[error("{column} is empty: the value is unknown")]
    Unknown { column: &'static str },
    /// A field is not a finite number.
    #[error("{column} is {text:?}, not a finite number")]
    NotFinite { column: &'static str, text: String },
}

/// The numbers of a row in the order of the columns, or the error of the row.
pub(crate) type Numbers = Result<Vec<f64>, RowError>;

/// Formats a number with seventeen significant digits, which reproduce it exactly.
pub(crate) fn digits(number: f64) -> String {
    format!("{number:.16e}")
}

/// Reads rows of `columns` from a file (`None` or `-`: standard input), processes each with `work`, and
/// writes the results to standard output. `work` gets the numbers of a row, or its error.
///
/// # Errors
/// Fails if input or output fails. Bad rows are reported on standard error with their line, and cause an
/// [`exit::DATA`] failure at the end.
pub(crate) fn convert(
    input: Option<&Path>,
    columns: &[Column],
    header: &[&str],
    work: impl Fn(Numbers) -> Row,
) -> anyhow::Result<()> {
    let output: Output = Rc::new(RefCell::new(csv::Writer::from_writer(io::stdout())));
    let mut table = Table::open(input, columns, Rc::clone(&output))?;
    wrote(output.borrow_mut().write_record(header))?;
    let (mut rows, mut bad) = (0_u64, 0_u64);
    while let Some((line, numbers)) = table.next()? {
        let row = work(numbers);
        wrote(output.borrow_mut().write_record(&row.cells))?;
        rows += 1;
        if let Some(problem) = row.problem {
            bad += 1;
            // Standard error may be closed. The exit code still reports the error.
            let _ = writeln!(io::stderr(), "trifacet: {}:{line}: {problem}", table.name);
        }
    }
    written(output.borrow_mut().flush())?;
    if bad > 0 {
        let message = format!("{}: {bad} of {rows} rows could not be processed", table.name);
        return Err(Failure::new(exit::DATA, message).into());
    }
    Ok(())
}

fn wrote(result: csv::Result<()>) -> anyhow::Result<()> {
    // Keep the kind of the error: csv's own conversion loses it.
    written(result.map_err(|error| match error.into_kind() {
        csv::ErrorKind::Io(error) => error,
        other => io::Error::other(format!("{other:?}")),
    }))
}

/// The output, shared with the input.
type Output = Rc<RefCell<csv::Writer<Stdout>>>;

/// An input that writes the results so far before it reads more, which may take any time.
struct Input {
    bytes: Box<dyn Read>,
    output: Output,
}

/// The output failed while the input was read.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct OutputFailed(io::Error);

impl Read for Input {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.output.borrow_mut().flush().map_err(|error| io::Error::other(OutputFailed(error)))?;
        self.bytes.read(buffer)
    }
}

/// An input after its header was read.
struct Table<'c> {
    name: String,
    reader: csv::Reader<io::Chain<Input, &'static [u8]>>,
    columns: &'c [Column],
    /// Index of each column in a row.
    places: Vec<Option<usize>>,
    width: usize,
    record: ByteRecord,
}

impl<'c> Table<'c> {
    fn open(input: Option<&Path>, columns: &'c [Column], output: Output) -> anyhow::Result<Self> {
        let (name, bytes): (_, Box<dyn Read>) = match input.filter(|path| *path != Path::new("-")) {
            Some(path) => {
                let name = path.display().to_string();
                let file = File::open(path).with_context(|| format!("cannot open {name}"))?;
                (name, Box::new(file))
            }
            None => ("standard input".into(), Box::new(io::stdin().lock())),
        };
        // The reader counts a line at its line feed. One is appended, so that the line numbers are right
        // for the last record too. Carriage returns are trimmed like blanks.
        let reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .trim(csv::Trim::All)
            .terminator(csv::Terminator::Any(b'\n'))
            .from_reader(Input { bytes, output }.chain(&b"\n"[..]));
        let mut table =
            Self { name, reader, columns, places: Vec::new(), width: 0, record: ByteRecord::new() };
        table.read_header()?;
        Ok(table)
    }

    fn read_header(&mut self) -> anyhow::Result<()> {
        let needed: Vec<_> = self.columns.iter().filter(|c| c.default.is_none()).map(|c| c.name).collect();
        let needed = needed.join(", ");
        let Some(line) = self.next_record()? else {
            return Err(self.unfit(1, format!("empty: the first line must name the columns {needed}")));
        };
        let names: Vec<_> =
            self.record.iter().map(|n| n.strip_prefix(b"\xef\xbb\xbf").unwrap_or(n)).collect();
        let mut places = Vec::new();
        for Column { name, alias, default } in self.columns {
            let is = |found: &[u8]| found == name.as_bytes() || alias.is_some_and(|a| found == a.as_bytes());
            let mut found = names.iter().enumerate().filter(|(_, n)| is(n)).map(|(i, _)| i);
            let place = found.next();
            if found.next().is_some() {
                let or = alias.map_or_else(String::new, |alias| format!(" or {alias}"));
                return Err(self.unfit(line, format!("the column {name}{or} occurs twice")));
            }
            if place.is_none() && default.is_none() {
                return Err(self.unfit(line, format!("the column {name} is missing; required are {needed}")));
            }
            places.push(place);
        }
        self.width = names.len();
        self.places = places;
        Ok(())
    }

    /// The failure of the input, or of the output before it.
    fn failed(&self, error: csv::Error) -> anyhow::Result<bool> {
        let error = match error.into_kind() {
            csv::ErrorKind::Io(error) => error,
            other => io::Error::other(format!("{other:?}")),
        };
        match error.downcast::<OutputFailed>() {
            Ok(OutputFailed(error)) => written(Err(error)).map(|()| false),
            Err(error) => Err(Failure::new(exit::IO, format!("cannot read {}: {error}", self.name)).into()),
        }
    }

    fn unfit(&self, line: u64, what: impl Display) -> anyhow::Error {
        Failure::new(exit::DATA, format!("{}:{line}: {what}", self.name)).into()
    }

    /// The line number of the next row, and its numbers or its error.
    fn next(&mut self) -> anyhow::Result<Option<(u64, Numbers)>> {
        let Some(line) = self.next_record()? else { return Ok(None) };
        Ok(Some((line, self.numbers())))
    }

    fn numbers(&self) -> Numbers {
        if self.record.len() != self.width {
            return Err(RowError::Width { found: self.record.len(), expected: self.width });
        }
        let number = |(column, place): (&Column, &Option<usize>)| {
            let Some(field) = place.and_then(|place| self.record.get(place)) else {
                return Ok(column.default.unwrap_or(f64::NAN));
            };
            if field.is_empty() {
                return Err(RowError::Unknown { column: column.name });
            }
            let text = String::from_utf8_lossy(field);
            let number = text.parse().ok().filter(|x: &f64| x.is_finite());
            number.ok_or_else(|| RowError::NotFinite { column: column.name, text: text.into_owned() })
        };
        self.columns.iter().zip(&self.places).map(number).collect()
    }

    /// Reads the next record that is not blank, and returns its line number.
    fn next_record(&mut self) -> anyhow::Result<Option<u64>> {
        while self.reader.read_byte_record(&mut self.record).or_else(|error| self.failed(error))? {
            if self.record.len() > 1 || self.record.get(0).is_some_and(|field| !field.is_empty()) {
                let within = self.record.iter().flatten().filter(|byte| **byte == b'\n').count() as u64;
                return Ok(Some(self.reader.position().line().saturating_sub(1 + within)));
            }
        }
        Ok(None)
    }
}
