//! `trifacet export`: a recording as a table, for those who compute with it.

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

/// Arguments of `export`.
#[derive(Debug, clap::Args)]
pub(crate) struct ExportArgs {
    /// The recording
    file: PathBuf,
    /// Form of the table
    #[arg(long, value_enum)]
    format: Format,
    /// What makes a row
    #[arg(long, value_enum, default_value_t = What::Frames)]
    what: What,
    /// The new file, or - for standard output (csv); by default beside the recording, with the ending of its form
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Format {
    /// Text, every digit
    Csv,
    /// Columns for pandas and others; in builds with the feature "parquet"
    Parquet,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum What {
    /// Frames as they were published
    Frames,
    /// Samples: raw codes, and what they mean
    Samples,
}

/// One row: values by name.
type Row = Vec<(&'static str, Value)>;

/// A table that is being written.
trait Table {
    fn row(&mut self, row: Row) -> std::io::Result<()>;
    fn finish(self: Box<Self>) -> std::io::Result<()>;
}

/// Writes the table, and says what of the recording is missing in it.
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
    told(reader.tally(), rows, &output)
}

/// Where the table goes.
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
        let why = format!("--output {}: with --format {format} it is no .{other}", output.display());
        return Err(Failure::new(exit::USAGE, why));
    }
    if output == Path::new("-") && matches!(args.format, Format::Parquet) {
        return Err(Failure::new(exit::USAGE, "--output -: standard output takes --format csv only"));
    }
    Ok(output)
}

fn closed(error: &anyhow::Error) -> bool {
    error.downcast_ref::<io::Error>().is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
}

fn told(tally: &Tally, rows: u64, output: &Path) -> anyhow::Result<()> {
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
    match tally.damages.len() + tally.gaps.len() {
        0 => Ok(()),
        n => Err(Failure::new(exit::DATA, format!("the recording has holes, in {n} places")).into()),
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
            let why =
                "--format parquet: this build has no Parquet; build it with --features parquet, or use csv";
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
        return Err(Failure::new(exit::DATA, "there is nothing in the recording to export").into());
    }
    cannot_write(table.finish(), output)?;
    Ok(rows)
}
