//! Tables of numbers as CSV.
//!
//! Columns are identified by name, in any order. A bad row does not stop the conversion.

use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;

use anyhow::Context;
use trifacet::exit::{self, Failure};
use trifacet::text::table::{self, Layout, RowError, Table};

use super::written;

/// A column of the input.
pub(crate) struct Column {
    pub(crate) name: &'static str,
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
    let mut table = open(input, columns)?;
    let name = table.name().to_owned();
    let mut output = csv::Writer::from_writer(io::BufWriter::new(io::stdout().lock()));
    wrote(output.write_record(header))?;
    let (mut rows, mut bad) = (0_u64, 0_u64);
    while let Some(read) = table.next_row()? {
        let row = work(numbers(&read, columns));
        wrote(output.write_record(&row.cells))?;
        rows += 1;
        if let Some(problem) = row.problem {
            bad += 1;
            // Standard error may be closed. The exit code still reports the error.
            let _ = writeln!(io::stderr(), "trifacet: {}", read.wrong(problem));
        }
    }
    written(output.flush())?;
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

/// The table in a file, or from standard input.
fn open(input: Option<&Path>, columns: &[Column]) -> anyhow::Result<Table<Box<dyn Read>>> {
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
    Ok(Table::open(name, bytes, Layout { needed: &needed, optional: &optional, comments: false })?)
}

/// The numbers of a row, in the order of the columns.
fn numbers(row: &table::Row<'_>, columns: &[Column]) -> Numbers {
    row.check_width()?;
    let number = |Column { name, default }: &Column| match default {
        Some(default) if !row.has(name) => Ok(*default),
        _ => row.number(name),
    };
    columns.iter().map(number).collect()
}
