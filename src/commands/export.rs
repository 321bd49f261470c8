//! `trifacet export`: a recording as a table, for those who compute with it.

mod csv;
#[cfg(feature = "parquet")]
mod parquet;
mod samples;

use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use trifacet::exit::{self, Failure};
use trifacet::publishing::columns::{Columns, Value};
use trifacet::recording::reader::Read;
use trifacet::recording::{Entry, Reader, Topic};

use super::replay::{cannot_write, new_file};

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
    /// The new file; by default beside the recording, with the ending of its form
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
    let ending = match (args.format, args.what) {
        (Format::Csv, What::Frames) => "csv",
        (Format::Csv, What::Samples) => "samples.csv",
        (Format::Parquet, What::Frames) => "parquet",
        (Format::Parquet, What::Samples) => "samples.parquet",
    };
    let output = args.output.clone().unwrap_or_else(|| args.file.with_extension(ending));
    let topic = if args.what == What::Frames { Topic::Frame } else { Topic::Sample };
    let mut reader = Reader::open(&args.file, &[topic])?;
    let file = new_file(&output)?;
    let rows = match write(&mut reader, file, args.format, &output) {
        Ok(rows) => rows,
        Err(error) => {
            let _ = fs::remove_file(&output); // half a table is none
            return Err(error);
        }
    };
    let tally = reader.tally();
    for damage in &tally.damages {
        eprintln!("trifacet: missing in the table: {damage}");
    }
    if !tally.finished {
        eprintln!(
            "trifacet: the recording was not closed; {} bytes at its end are no whole chunk",
            tally.torn
        );
    }
    eprintln!("{rows} rows in {}", output.display());
    match tally.damages.len() {
        0 => Ok(()),
        n => Err(Failure::new(exit::DATA, format!("{n} places of the recording cannot be read")).into()),
    }
}

fn write(reader: &mut Reader, file: File, format: Format, output: &Path) -> anyhow::Result<u64> {
    let to = BufWriter::new(file);
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
