//! Tables of numbers as CSV.
//!
//! Columns are identified by name, in any order. A bad row does not stop the conversion. All results are written
//! before more input is awaited, so that a program can write a row and wait for its result.

use std::cell::RefCell;
use std::fs::File;
use std::io::{self, Read, Stdout, Write};
use std::path::Path;
use std::rc::Rc;

use anyhow::Context;
use trifacet::exit::{self, Failure};
use trifacet::text::table::{self, Layout, RowError, Table};

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

/// The numbers of a row in the order of the columns, or the error of the row.
pub(crate) type Numbers = Result<Vec<f64>, RowError>;

/// Formats a number with seventeen significant digits, which reproduce it exactly.
pub(crate) fn digits(number: f64) -> String {
    format!("{number:.16e}")
}

/// What is done with the rows.
pub(crate) trait Conversion {
    /// The row, counted from 1, without which no row can be converted.
    fn needs(&self) -> Option<u64> {
        None
    }

    /// Takes the needed row, before all others. The error states why it cannot be used.
    fn prepare(&mut self, _numbers: &Numbers) -> Result<(), String> {
        Ok(())
    }

    /// Number of rows that are converted together. A row is written when these have been read.
    fn batch(&self) -> usize {
        1
    }

    /// Converts rows, each with its number, counted from 1.
    fn rows(&mut self, rows: Vec<(u64, Numbers)>) -> Vec<Row>;
}

/// A conversion of each row by itself.
struct EachRow<F>(F);

impl<F: Fn(Numbers) -> Row> Conversion for EachRow<F> {
    fn rows(&mut self, rows: Vec<(u64, Numbers)>) -> Vec<Row> {
        rows.into_iter().map(|(_, numbers)| self.0(numbers)).collect()
    }
}

/// Reads rows of `columns` from a file (`None` or `-`: standard input), processes each with `work`, and
/// writes the results to standard output. `work` gets the numbers of a row, or its error.
///
/// # Errors
/// As [`convert_with`].
pub(crate) fn convert(
    input: Option<&Path>,
    columns: &[Column],
    header: &[&str],
    work: impl Fn(Numbers) -> Row,
) -> anyhow::Result<()> {
    convert_with(input, columns, header, EachRow(work))
}

/// As [`convert`], with a conversion that may need one row before all others. The rows before this one wait for it.
///
/// # Errors
/// Fails if input or output fails. Bad rows are reported on standard error with their line, and cause an
/// [`exit::DATA`] failure at the end. So does a needed row that does not exist or cannot be used, at once.
pub(crate) fn convert_with(
    input: Option<&Path>,
    columns: &[Column],
    header: &[&str],
    mut conversion: impl Conversion,
) -> anyhow::Result<()> {
    let output = Output::default();
    let mut table = open(input, columns, output.clone())?;
    let name = table.name().to_owned();
    output.write(header)?;
    let mut rows = 0_u64;
    let mut queue = Queue { name: name.clone(), output: output.clone(), waiting: Vec::new(), bad: 0 };
    while let Some(read) = table.next_row().or_else(|error| output.failed().map_or(Err(error.into()), Err))? {
        rows += 1;
        let numbers = numbers(&read, columns);
        if conversion.needs() == Some(rows) {
            conversion.prepare(&numbers).map_err(|why| read.wrong(why))?;
        }
        queue.waiting.push((read.line(), (rows, numbers)));
        let known = conversion.needs().is_none_or(|needed| rows >= needed);
        if known && queue.waiting.len() >= conversion.batch() {
            queue.convert(&mut conversion)?;
        }
    }
    if conversion.needs().is_none_or(|needed| rows >= needed) {
        queue.convert(&mut conversion)?;
    }
    let bad = queue.bad;
    output.flush()?;
    if let Some(needed) = conversion.needs().filter(|needed| *needed > rows) {
        let message = format!("{name}: row {needed} is needed, but the table has only {rows} data rows");
        return Err(Failure::new(exit::DATA, message).into());
    }
    if bad > 0 {
        let message = format!("{name}: {bad} of {rows} rows could not be processed");
        return Err(Failure::new(exit::DATA, message).into());
    }
    Ok(())
}

/// Rows that were read and are not yet converted, each with its line.
struct Queue {
    name: String,
    output: Output,
    waiting: Vec<(u64, (u64, Numbers))>,
    bad: u64,
}

impl Queue {
    /// Converts the rows and writes them. Bad rows are reported and counted.
    fn convert(&mut self, conversion: &mut impl Conversion) -> anyhow::Result<()> {
        let (lines, rows): (Vec<_>, Vec<_>) = self.waiting.drain(..).unzip();
        for (line, row) in lines.into_iter().zip(conversion.rows(rows)) {
            self.output.write(&row.cells)?;
            if let Some(problem) = row.problem {
                self.bad += 1;
                // Standard error may be closed. The exit code still reports the error.
                let _ = writeln!(io::stderr(), "trifacet: {}:{line}: {problem}", self.name);
            }
        }
        Ok(())
    }
}

fn wrote(result: csv::Result<()>) -> anyhow::Result<()> {
    // Keep the kind of the error: csv's own conversion loses it.
    written(result.map_err(|error| match error.into_kind() {
        csv::ErrorKind::Io(error) => error,
        other => io::Error::other(format!("{other:?}")),
    }))
}

/// The output, shared with the input.
#[derive(Clone)]
struct Output {
    table: Rc<RefCell<csv::Writer<Stdout>>>,
    error: Rc<RefCell<Option<io::Error>>>,
}

impl Default for Output {
    fn default() -> Self {
        Self { table: Rc::new(RefCell::new(csv::Writer::from_writer(io::stdout()))), error: Rc::default() }
    }
}

impl Output {
    fn write<I: AsRef<[u8]>>(&self, cells: impl IntoIterator<Item = I>) -> anyhow::Result<()> {
        wrote(self.table.borrow_mut().write_record(cells))
    }

    fn flush(&self) -> anyhow::Result<()> {
        written(self.table.borrow_mut().flush())
    }

    /// The failure of the output, if that is why the input could not be read.
    fn failed(&self) -> Option<anyhow::Error> {
        self.error.take().and_then(|error| written(Err(error)).err())
    }
}

/// An input that writes the results so far before it reads more, which may take any time.
struct Input {
    bytes: Box<dyn Read>,
    output: Output,
}

impl Read for Input {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let flushed = self.output.table.borrow_mut().flush();
        if let Err(error) = flushed {
            let kind = error.kind();
            *self.output.error.borrow_mut() = Some(error);
            return Err(kind.into());
        }
        self.bytes.read(buffer)
    }
}

/// The table in a file, or from standard input.
fn open(input: Option<&Path>, columns: &[Column], output: Output) -> anyhow::Result<Table<Input>> {
    let names = |optional: bool| -> Vec<_> {
        columns.iter().filter(|c| c.default.is_some() == optional).map(|c| c.name).collect()
    };
    let [needed, optional] = [false, true].map(names);
    let (name, bytes): (_, Box<dyn Read>) = match input.filter(|path| *path != Path::new("-")) {
        Some(path) => {
            let name = path.display().to_string();
            let file = File::open(path).with_context(|| format!("cannot open {name}"))?;
            (name, Box::new(file))
        }
        None => ("standard input".into(), Box::new(io::stdin().lock())),
    };
    let aliases: Vec<_> = columns.iter().filter_map(|c| Some((c.alias?, c.name))).collect();
    let layout = Layout { needed: &needed, optional: &optional, aliases: &aliases, comments: false };
    Ok(Table::open(name, Input { bytes, output }, layout)?)
}

/// The numbers of a row, in the order of the columns.
fn numbers(row: &table::Row<'_>, columns: &[Column]) -> Numbers {
    row.check_width()?;
    let number = |Column { name, default, .. }: &Column| match default {
        Some(default) if !row.has(name) => Ok(*default),
        _ => row.number(name),
    };
    columns.iter().map(number).collect()
}
