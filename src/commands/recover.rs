//! `trifacet recover`: a whole file of all that can be read of a damaged one.

use std::fs::File;
use std::io::{BufWriter, IntoInnerError};
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context;
use rustix::process::{Resource, Rlimit, setrlimit};
use trifacet::exit::{self, Failure};
use trifacet::recording::codec::{Encoded, Encoder};
use trifacet::recording::reader::Tally;
use trifacet::recording::writer::{RecordError, Writer};
use trifacet::recording::{Reader, Topic};
use trifacet_core::time::Mono;

use super::new_file::{NewFile, cannot_write};

/// Memory of the child that reads the damaged file, bytes.
const MEMORY: u64 = 1 << 30;

/// Arguments of `recover`.
#[derive(Debug, clap::Args)]
pub(crate) struct RecoverArgs {
    /// The damaged recording; it is only read
    file: PathBuf,
    /// The new one; by default beside it, as NAME.recovered.mcap
    out: Option<PathBuf>,
    /// Reads and writes itself, within bounds of memory
    #[arg(long, hide = true)]
    child: bool,
}

/// Writes a new file of what can be read.
pub(crate) fn recover(args: &RecoverArgs) -> anyhow::Result<()> {
    let out = args.out.clone().unwrap_or_else(|| args.file.with_extension("recovered.mcap"));
    if args.child {
        return child(&args.file, &out);
    }
    // Whatever a damaged file does to who reads it, it does to a child.
    let program = std::env::current_exe().context("cannot find this program")?;
    let status = Command::new(program).arg("recover").arg("--child").arg(&args.file).arg(&out).status();
    let status = status.context("cannot start a child")?;
    if status.success() {
        return Ok(());
    }
    let code = status.code().and_then(|code| u8::try_from(code).ok());
    let why = format!("nothing was recovered from {}: the child ended with {status}", args.file.display());
    Err(Failure::new(code.unwrap_or(exit::SOFTWARE), why).into())
}

fn child(file: &Path, out: &Path) -> anyhow::Result<()> {
    setrlimit(Resource::As, Rlimit { current: Some(MEMORY), maximum: Some(MEMORY) })
        .context("cannot bound the memory")?;
    let mut reader = Reader::open(file, Reader::REPLAY)?;
    let new = NewFile::create(out, file.metadata().ok().as_ref())?;
    let saved = copy(&mut reader, new.writer()?, out)?;
    let tally = reader.tally();
    if tally.time_ns.is_none() {
        return Err(
            Failure::new(exit::DATA, format!("{}: nothing of ours can be read", file.display())).into()
        );
    }
    new.keep()?;
    told(tally, &saved);
    Ok(())
}

/// Messages on each topic.
type Saved = [u64; Topic::ALL.len()];

/// Writes what can be read, and where something cannot, that it is missing there.
fn copy(reader: &mut Reader, to: File, out: &Path) -> anyhow::Result<Saved> {
    let to = BufWriter::new(to);
    let mut writer = cannot_write(Writer::new(to, Some(mcap::Compression::Zstd)), out)?;
    let mut saved = Saved::default();
    let (mut missing, mut told) = (Vec::new(), 0);
    let mut more = true;
    while more {
        let mut done = Ok(());
        more = reader.raw(|topic, time_ns, data| {
            if done.is_ok() {
                saved[topic as usize] += 1;
                done = gaps(&mut writer, time_ns, &mut missing)
                    .and_then(|()| Ok(writer.put(Encoded { topic, time_ns, data })?));
            }
        })?;
        cannot_write(done, out)?;
        let damages = &reader.tally().damages;
        missing.extend(damages[told..].iter().map(|damage| format!("damaged in the file before: {damage}")));
        told = damages.len();
    }
    let end_ns = reader.tally().time_ns.map_or(0, |[_, end]| end);
    cannot_write(gaps(&mut writer, end_ns, &mut missing), out)?;
    let to = cannot_write(writer.finish(), out)?.into_inner();
    cannot_write(to.map_err(IntoInnerError::into_error), out)?;
    Ok(saved)
}

/// Says at this moment what is missing before it.
fn gaps(
    writer: &mut Writer<BufWriter<File>>,
    time_ns: i64,
    missing: &mut Vec<String>,
) -> Result<(), RecordError> {
    for why in missing.drain(..) {
        // How much it was, nobody knows.
        Encoder::new((Mono(0), time_ns)).gap(0, &why, |gap| Ok::<_, RecordError>(writer.put(gap)?))?;
    }
    Ok(())
}

/// Says what was saved, and what was not.
fn told(tally: &Tally, saved: &Saved) {
    let count = |topic: Topic| saved[topic as usize];
    eprintln!(
        "saved {} samples, {} frames, {} valid poses, {:.3} s",
        count(Topic::Sample),
        count(Topic::Frame),
        count(Topic::Pose),
        tally.seconds()
    );
    for damage in &tally.damages {
        eprintln!("lost {damage}");
    }
    match (tally.indexed, tally.torn) {
        (_, 0) => {}
        (false, torn) => eprintln!("lost {torn} bytes at the end: no whole chunk, which is up to a second"),
        (true, _) => eprintln!("nothing is lost at the end: only the index behind the data was damaged"),
    }
    if tally.strange > 0 {
        eprintln!("left out {} messages of other programs", tally.strange);
    }
    if tally.finished && tally.damages.is_empty() {
        eprintln!("nothing was damaged: the new file has what the old one has");
    }
}
