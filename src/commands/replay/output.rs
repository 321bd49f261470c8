//! Writes the results of a replay to a file.

use std::fs::{File, Metadata};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use trifacet::exit::{self, Failure};
use trifacet::publishing::columns::Columns;
use trifacet::recording::Entry;
use trifacet::recording::codec::Encoder;
use trifacet::recording::reader::Gap;
use trifacet::recording::writer::{RecordError, Writer};
use trifacet::replay::Engine;
use trifacet::replay::comparison::Pair;
use trifacet_core::time::Mono;

use crate::commands::new_file::{NewFile, cannot_write};

/// Largest number of entries that wait for the frame that determines their time: a block of samples.
const HELD: usize = 20_000;

/// A file while it is written.
pub(super) struct Output {
    path: PathBuf,
    new: NewFile,
    form: OutputFormat,
}

enum OutputFormat {
    Csv { to: BufWriter<File>, begun: bool },
    Mcap(Box<Mcap>),
}

/// The results as a recording.
struct Mcap {
    writer: Writer<BufWriter<File>>,
    encoder: Encoder,
    held: Vec<Held>,
}

/// An entry that waits for its time.
#[expect(clippy::large_enum_variant, reason = "entries are the rule")]
enum Held {
    Entry(Entry),
    Gap(Gap),
}

impl Output {
    /// Starts a new file. The extension determines its format.
    pub(super) fn create(path: &Path, source: Option<&Metadata>) -> anyhow::Result<Self> {
        let extension = path.extension().and_then(|e| e.to_str());
        if !matches!(extension, Some("csv" | "mcap")) {
            let why = format!("--output {}: allowed are names that end in .mcap or .csv", path.display());
            return Err(Failure::new(exit::USAGE, why).into());
        }
        let new = NewFile::create(path, source)?;
        let to = BufWriter::new(new.writer()?);
        let form = if extension == Some("csv") {
            OutputFormat::Csv { to, begun: false }
        } else {
            let writer = cannot_write(Writer::new(to, Some(mcap::Compression::Zstd)), path)?;
            OutputFormat::Mcap(Box::new(Mcap {
                writer,
                encoder: Encoder::new((Mono(0), 0)),
                held: Vec::new(),
            }))
        };
        Ok(Self { path: path.to_owned(), new, form })
    }

    /// Writes an entry of the recording together with its results.
    pub(super) fn take(
        &mut self,
        entry: &Entry,
        pair: Option<&Pair<'_>>,
        engine: &Engine,
    ) -> anyhow::Result<()> {
        match &mut self.form {
            OutputFormat::Csv { to, begun } => {
                let Some(pair) = pair else { return Ok(()) };
                let columns = Columns::of(&pair.now);
                if !std::mem::replace(begun, true) {
                    cannot_write(writeln!(to, "{}", columns.csv_header()), &self.path)?;
                }
                cannot_write(writeln!(to, "{}", columns.csv_line()), &self.path)
            }
            OutputFormat::Mcap(mcap) => match now(entry, pair, engine) {
                Some(now) => cannot_write(mcap.take(now), &self.path),
                None => Ok(()),
            },
        }
    }

    /// Records a gap.
    pub(super) fn gap(&mut self, gap: Gap) {
        if let OutputFormat::Mcap(mcap) = &mut self.form {
            mcap.held.push(Held::Gap(gap));
        }
    }

    /// Completes the file.
    pub(super) fn finish(self) -> anyhow::Result<()> {
        let mut to = match self.form {
            OutputFormat::Csv { to, .. } => to,
            OutputFormat::Mcap(mut mcap) => {
                cannot_write(mcap.flush(), &self.path)?;
                cannot_write(mcap.writer.finish(), &self.path)?
            }
        };
        cannot_write(to.flush(), &self.path)?;
        self.new.keep()
    }
}

impl Mcap {
    fn take(&mut self, entry: Entry) -> Result<(), RecordError> {
        if let Entry::Frame { frame, time, .. } = &entry {
            self.encoder.clocks((*time, frame.time_ns));
        } else if self.held.len() < HELD {
            self.held.push(Held::Entry(entry));
            return Ok(());
        }
        self.flush()?;
        self.put(&entry)
    }

    fn flush(&mut self) -> Result<(), RecordError> {
        for held in std::mem::take(&mut self.held) {
            match held {
                Held::Entry(entry) => self.put(&entry)?,
                Held::Gap(Gap { entries, reason }) => {
                    let Self { encoder, writer, .. } = self;
                    encoder.gap(entries, &reason, |gap| Ok::<_, RecordError>(writer.put(gap)?))?;
                }
            }
        }
        Ok(())
    }

    fn put(&mut self, entry: &Entry) -> Result<(), RecordError> {
        let Self { encoder, writer, .. } = self;
        encoder.encode(entry, |message| Ok(writer.put(message)?))
    }
}

/// The entry as the daemon would record it now.
fn now(entry: &Entry, pair: Option<&Pair<'_>>, engine: &Engine) -> Option<Entry> {
    Some(match entry {
        Entry::Keyframe(_) => Entry::Keyframe(Box::new(engine.now()?)),
        Entry::Sample { scan, steering, .. } => {
            Entry::Sample { scan: *scan, sample: engine.sample_now()?, steering: *steering }
        }
        Entry::Frame { time, .. } => Entry::Frame {
            frame: pair?.now,
            time: *time,
            covariance: engine.report().and_then(|report| report.covariance),
        },
        Entry::Silence { .. } | Entry::Lock { .. } => entry.clone(),
    })
}
