//! `trifacet export`: writes a recording as a table.

mod csv;
#[cfg(feature = "parquet")]
mod parquet;
mod samples;

use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use trifacet::exit::{self, Failure};
use trifacet::publishing::columns::{Columns, Value};
use trifacet::recording::reader::{Read, Tally};
use trifacet::recording::{Entry, Reader, Topic};

use super::OutputClosed;
use super::new_file::{NewFile, cannot_write};

/// Options of `export`.
#[derive(Debug, clap::Args)]
pub(crate) struct ExportArgs {
    /// The recording
    file: PathBuf,
    /// Format of the table
    #[arg(long, value_enum)]
    format: Format,
    /// Contents of a row
    #[arg(long, value_enum, default_value_t = What::Frames)]
    what: What,
    /// New file, or - for standard output (csv); by default beside the recording, with the extension of its
    /// format
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Format {
    /// Text with all digits
    Csv,
    /// Columns, for pandas and others; only in builds with the feature "parquet"
    Parquet,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum What {
    /// Published frames
    Frames,
    /// Samples: raw codes and calibrated values
    Samples,
}

/// One row: names and values.
type Row = Vec<(&'static str, Value)>;

/// A table while it is written.
trait Table {
    fn row(&mut self, row: Row) -> std::io::Result<()>;
    fn finish(self: Box<Self>) -> std::io::Result<()>;
}

/// Writes the table and reports which parts of the recording are missing in it.
pub(crate) fn export(args: &ExportArgs) -> anyhow::Result<()> {
    let output = output(args)?;
    let topic = if args.what == What::Frames { Topic::Frame } else { Topic::Sample };
    let mut reader = Reader::open(&args.file, &[topic, Topic::Gap])?;
    let rows = if output == Path::new("-") {
        match write(&mut reader, io::stdout(), args.format, Path::new("standard output")) {
            Err(error) if closed(&error) => return Err(OutputClosed.into()),
            rows => rows?,
        }
    } else {
        let new = NewFile::create(&output, args.file.metadata().ok().as_ref())?;
        let rows = write(&mut reader, new.writer()?, args.format, &output)?;
        new.keep()?;
        rows
    };
    print_summary(reader.tally(), rows, &output)
}

/// Path of the table.
fn output(args: &ExportArgs) -> Result<PathBuf, Failure> {
    let (format, other) = match args.format {
        Format::Csv => ("csv", "parquet"),
        Format::Parquet => ("parquet", "csv"),
    };
    let Some(output) = args.output.clone() else {
        let what = if args.what == What::Samples { "samples." } else { "" };
        return Ok(args.file.with_extension(format!("{what}{format}")));
    };
    if output.extension().is_some_and(|ending| ending == other) {
        let why = format!("--output {}: --format {format} does not write .{other}", output.display());
        return Err(Failure::new(exit::USAGE, why));
    }
    if output == Path::new("-") && matches!(args.format, Format::Parquet) {
        return Err(Failure::new(
            exit::USAGE,
            "--output -: only --format csv can be written to standard output",
        ));
    }
    Ok(output)
}

fn closed(error: &anyhow::Error) -> bool {
    error.downcast_ref::<io::Error>().is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
}

fn print_summary(tally: &Tally, rows: u64, output: &Path) -> anyhow::Result<()> {
    for damage in &tally.damages {
        eprintln!("trifacet: missing in the table: {damage}");
    }
    for gap in &tally.gaps {
        eprintln!("trifacet: missing in the table: {gap}");
    }
    if let Some(end) = tally.unfinished() {
        eprintln!("trifacet: {end}");
    }
    eprintln!("{rows} rows in {}", output.display());
    match tally.damages.len() + tally.gaps.len() + usize::from(tally.lost_at_end() > 0) {
        0 => Ok(()),
        n => Err(Failure::new(exit::DATA, format!("the recording has gaps in {n} places")).into()),
    }
}

fn write(reader: &mut Reader, to: impl Write + Send, format: Format, output: &Path) -> anyhow::Result<u64> {
    let to = BufWriter::new(to);
    let mut table: Box<dyn Table> = match format {
        Format::Csv => Box::new(csv::Csv::new(to)),
        #[cfg(feature = "parquet")]
        Format::Parquet => Box::new(parquet::Parquet::new(to)),
        #[cfg(not(feature = "parquet"))]
        Format::Parquet => {
            let why = "--format parquet: this build does not include Parquet: build with --features parquet, or use csv";
            return Err(Failure::new(exit::USAGE, why).into());
        }
    };
    let mut rows = 0;
    while let Some(read) = reader.read()? {
        let row = match read {
            Read::Entry(Entry::Frame { frame, .. }) => Columns::of(&frame).0,
            Read::Entry(Entry::Sample { scan, sample, steering }) => samples::row(&scan, &sample, &steering),
            _ => continue,
        };
        cannot_write(table.row(row), output)?;
        rows += 1;
    }
    if rows == 0 {
        return Err(Failure::new(exit::DATA, "the recording contains nothing to export").into());
    }
    cannot_write(table.finish(), output)?;
    Ok(rows)
}
