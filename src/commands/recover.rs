//! `trifacet recover`: writes a new recording with the readable parts of a damaged one.

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

/// Memory limit of the child process that reads the damaged file, bytes.
const MEMORY: u64 = 1 << 30;

/// Options of `recover`.
#[derive(Debug, clap::Args)]
pub(crate) struct RecoverArgs {
    /// Damaged recording; it is not changed
    file: PathBuf,
    /// New recording; by default beside the damaged one, as NAME.recovered.mcap
    out: Option<PathBuf>,
    /// Read and write in this process, with a memory limit
    #[arg(long, hide = true)]
    child: bool,
}

/// Writes a new recording with the readable parts.
pub(crate) fn recover(args: &RecoverArgs) -> anyhow::Result<()> {
    let out = args.out.clone().unwrap_or_else(|| args.file.with_extension("recovered.mcap"));
    if args.child {
        return child(&args.file, &out);
    }
    // A child process reads the damaged file, so that a failure there cannot affect this process.
    let program = std::env::current_exe().context("cannot find this program")?;
    let status = Command::new(program).arg("recover").arg("--child").arg(&args.file).arg(&out).status();
    let status = status.context("cannot start the child process")?;
    if status.success() {
        return Ok(());
    }
    let failure = match status.code().and_then(|code| u8::try_from(code).ok()) {
        // The child has printed the reason.
        Some(code) => Failure::new(code, ""),
        None => Failure::new(
            exit::SOFTWARE,
            format!("nothing was recovered from {}: its reader ended with {status}", args.file.display()),
        ),
    };
    Err(failure.into())
}

fn child(file: &Path, out: &Path) -> anyhow::Result<()> {
    setrlimit(Resource::As, Rlimit { current: Some(MEMORY), maximum: Some(MEMORY) })
        .context("cannot limit the memory")?;
    let mut reader = Reader::open(file, Reader::REPLAY)?;
    let new = NewFile::create(out, file.metadata().ok().as_ref())?;
    let saved = copy(&mut reader, new.writer()?, out)?;
    let tally = reader.tally();
    if tally.time_ns.is_none() {
        let why = tally.unfinished().unwrap_or_else(|| "it is closed, and contains none".into());
        let message = format!("{}: no trifacet data can be read: {why}", file.display());
        return Err(Failure::new(exit::DATA, message).into());
    }
    new.keep()?;
    print_summary(out, tally, &saved);
    Ok(())
}

/// Number of messages per topic.
type Saved = [u64; Topic::ALL.len()];

/// Copies all readable messages. Where some are not readable, a gap is recorded.
fn copy(reader: &mut Reader, to: File, out: &Path) -> anyhow::Result<Saved> {
    let to = BufWriter::new(to);
    let mut writer = cannot_write(Writer::new(to, Some(mcap::Compression::Zstd)), out)?;
    let mut saved = Saved::default();
    let (mut missing, mut recorded) = (Vec::new(), 0);
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
        missing.extend(
            damages[recorded..].iter().map(|damage| format!("damaged in the original file: {damage}")),
        );
        recorded = damages.len();
    }
    let end_ns = reader.tally().time_ns.map_or(0, |[_, end]| end);
    cannot_write(gaps(&mut writer, end_ns, &mut missing), out)?;
    let to = cannot_write(writer.finish(), out)?.into_inner();
    cannot_write(to.map_err(IntoInnerError::into_error), out)?;
    Ok(saved)
}

/// Records, at this time, the gaps before it.
fn gaps(
    writer: &mut Writer<BufWriter<File>>,
    time_ns: i64,
    missing: &mut Vec<String>,
) -> Result<(), RecordError> {
    for why in missing.drain(..) {
        // The number of lost entries is unknown.
        Encoder::new((Mono(0), time_ns)).gap(0, &why, |gap| Ok::<_, RecordError>(writer.put(gap)?))?;
    }
    Ok(())
}

/// Prints what was saved and what was lost.
fn print_summary(out: &Path, tally: &Tally, saved: &Saved) {
    let count = |topic: Topic| saved[topic as usize];
    eprintln!(
        "saved in {}: {} samples, {} frames, {} valid poses, {:.3} s",
        out.display(),
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
        (false, torn) => eprintln!("lost {torn} bytes at the end: an incomplete chunk of up to one second"),
        (true, _) => eprintln!("nothing is lost at the end: only the index after the data was damaged"),
    }
    if tally.strange > 0 {
        eprintln!("omitted {} messages of other programs", tally.strange);
    }
    if tally.finished && tally.damages.is_empty() {
        eprintln!("no damage found: the new file has the same contents");
    }
}
