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
    let output = Output::default();
    let mut table = open(input, columns, output.clone())?;
    let name = table.name().to_owned();
    output.write(header)?;
    let (mut rows, mut bad) = (0_u64, 0_u64);
    while let Some(read) = table.next_row().or_else(|error| output.failed().map_or(Err(error.into()), Err))? {
        let row = work(numbers(&read, columns));
        output.write(&row.cells)?;
        rows += 1;
        if let Some(problem) = row.problem {
            bad += 1;
            // Standard error may be closed. The exit code still reports the error.
            let _ = writeln!(io::stderr(), "trifacet: {}", read.wrong(problem));
        }
    }
    output.flush()?;
    if bad > 0 {
        let message = format!("{name}: {bad} of {rows} rows could not be processed");
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
