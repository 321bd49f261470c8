//! `trifacet recover`: a whole file of all that can be read of a damaged one.

use std::fs::{self, File, OpenOptions};
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context;
use rustix::process::{Resource, Rlimit, setrlimit};
use trifacet::exit::{self, Failure};
use trifacet::recording::codec::Encoded;
use trifacet::recording::writer::Writer;
use trifacet::recording::{Reader, Topic};

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
    if out.exists() {
        return Err(
            Failure::new(exit::IO, format!("{} exists already: name another file", out.display())).into()
        );
    }
    // Whatever a damaged file does to who reads it, it does to a child.
    let part = out.with_extension("mcap.part");
    let program = std::env::current_exe().context("cannot find this program")?;
    let status = Command::new(program).arg("recover").arg("--child").arg(&args.file).arg(&part).status();
    let status = status.context("cannot start a child")?;
    if status.success() {
        return fs::rename(&part, &out).with_context(|| format!("cannot write {}", out.display()));
    }
    let _ = fs::remove_file(&part); // it may not have come that far
    let code = status.code().and_then(|code| u8::try_from(code).ok());
    let why = format!("nothing was recovered from {}: the child ended with {status}", args.file.display());
    Err(Failure::new(code.unwrap_or(exit::SOFTWARE), why).into())
}

fn child(file: &Path, out: &Path) -> anyhow::Result<()> {
    setrlimit(Resource::As, Rlimit { current: Some(MEMORY), maximum: Some(MEMORY) })
        .context("cannot bound the memory")?;
    let mut reader = Reader::open(file, Reader::REPLAY)?;
    let cannot = || format!("cannot write {}", out.display());
    let to = OpenOptions::new().write(true).create_new(true).open(out).with_context(cannot)?;
    let mut writer = Writer::new(BufWriter::new(to), Some(mcap::Compression::Zstd)).with_context(cannot)?;
    let mut saved = [0_u64; Topic::ALL.len()];
    let mut result = Ok(());
    while reader.raw(|topic, time_ns, data| {
        if result.is_ok() {
            saved[topic as usize] += 1;
            result = writer.put(Encoded { topic, time_ns, data });
        }
    })? && result.is_ok()
    {}
    result.with_context(cannot)?;
    let to: File = writer
        .finish()
        .with_context(cannot)?
        .into_inner()
        .map_err(std::io::IntoInnerError::into_error)
        .with_context(cannot)?;
    to.sync_all().with_context(cannot)?;
    let tally = reader.tally();
    if tally.time_ns.is_none() {
        fs::remove_file(out).with_context(cannot)?;
        return Err(
            Failure::new(exit::DATA, format!("{}: nothing of ours can be read", file.display())).into()
        );
    }
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
    if tally.torn > 0 {
        eprintln!("lost {} bytes at the end: no whole chunk, which is up to a second", tally.torn);
    }
    if tally.strange > 0 {
        eprintln!("left out {} messages of other programs", tally.strange);
    }
    if tally.finished && tally.damages.is_empty() {
        eprintln!("nothing was damaged: the new file has what the old one has");
    }
    Ok(())
}
