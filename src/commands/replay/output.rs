//! What comes out of a replay, as a file.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use trifacet::clock::Mono;
use trifacet::exit::{self, Failure};
use trifacet::publishing::columns::Columns;
use trifacet::recording::Entry;
use trifacet::recording::codec::{EncodeError, Encoder};
use trifacet::recording::writer::Writer;
use trifacet::replay::{Engine, verdict::Pair};

use super::{cannot_write, new_file};

/// A file that is being written.
pub(super) struct Output {
    path: PathBuf,
    form: Form,
}

enum Form {
    Csv { to: BufWriter<File>, begun: bool },
    Mcap { writer: Box<Writer<BufWriter<File>>>, encoder: Box<Encoder> },
}

/// What may go wrong with a message.
#[derive(Debug, thiserror::Error)]
enum Broken {
    #[error(transparent)]
    Encode(#[from] EncodeError),
    #[error(transparent)]
    File(#[from] mcap::McapError),
}

impl Output {
    /// A new file; its form is in its name.
    pub(super) fn create(path: &Path) -> anyhow::Result<Self> {
        let extension = path.extension().and_then(|e| e.to_str());
        let form = match extension {
            Some("csv") => Form::Csv { to: BufWriter::new(new_file(path)?), begun: false },
            Some("mcap") => {
                let to = BufWriter::new(new_file(path)?);
                let writer = cannot_write(Writer::new(to, Some(mcap::Compression::Zstd)), path)?;
                let encoder = Encoder::new((Mono(0), 0));
                Form::Mcap { writer: Box::new(writer), encoder: Box::new(encoder) }
            }
            _ => {
                let why = format!("--output {}: allowed are names that end in .mcap or .csv", path.display());
                return Err(Failure::new(exit::USAGE, why).into());
            }
        };
        Ok(Self { path: path.to_owned(), form })
    }

    /// Takes an entry of the recording with what came out of it.
    pub(super) fn take(
        &mut self,
        entry: &Entry,
        pair: Option<&Pair<'_>>,
        engine: &Engine,
    ) -> anyhow::Result<()> {
        match &mut self.form {
            Form::Csv { to, begun } => {
                let Some(pair) = pair else { return Ok(()) };
                let columns = Columns::of(&pair.now);
                if !std::mem::replace(begun, true) {
                    cannot_write(writeln!(to, "{}", columns.csv_header()), &self.path)?;
                }
                cannot_write(writeln!(to, "{}", columns.csv_line()), &self.path)
            }
            Form::Mcap { writer, encoder } => {
                let Some(now) = now(entry, pair, engine) else { return Ok(()) };
                let put = |message: trifacet::recording::codec::Encoded<'_>| {
                    writer.put(message).map_err(Broken::from)
                };
                cannot_write(encoder.encode(&now, put), &self.path)
            }
        }
    }

    /// Closes the file.
    pub(super) fn finish(self) -> anyhow::Result<()> {
        match self.form {
            Form::Csv { mut to, .. } => cannot_write(to.flush(), &self.path),
            Form::Mcap { writer, .. } => {
                let mut to = cannot_write(writer.finish(), &self.path)?;
                cannot_write(to.flush(), &self.path)
            }
        }
    }
}

/// The entry as it would be recorded now.
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
