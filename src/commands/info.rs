//! `trifacet info`: prints the contents of recordings, and whether they are complete.

use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use serde_json::json;
use trifacet::exit::{self, Failure};
use trifacet::publishing::columns::rfc3339;
use trifacet::recording::reader::{Read, ReadError, Tally};
use trifacet::recording::{Entry, Reader, Topic};

use super::written;

/// Options of `info`.
#[derive(Debug, clap::Args)]
pub(crate) struct InfoArgs {
    /// Recordings
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Print one JSON object per file
    #[arg(long)]
    json: bool,
}

/// Prints the contents of each file. Fails if a file is not complete.
pub(crate) fn info(args: &InfoArgs) -> anyhow::Result<()> {
    let mut worst = None;
    let mut broken = 0;
    for file in &args.files {
        let (text, code) = match look(file) {
            Ok((tally, rate_hz)) => {
                let text =
                    if args.json { object(file, &tally, rate_hz) } else { lines(file, &tally, rate_hz) };
                (text, (!tally.whole()).then_some(exit::DATA))
            }
            Err(error) => {
                eprintln!("trifacet: {error}");
                let text = if args.json { unread(file, &error) } else { String::new() };
                (text, Some(error.code()))
            }
        };
        written(io::stdout().write_all(text.as_bytes()))?;
        broken += u32::from(code.is_some());
        worst = worst.max(code);
    }
    match worst {
        None => Ok(()),
        Some(code) => Err(Failure::new(
            code,
            format!("{broken} of {} files are not complete, or cannot be read", args.files.len()),
        )
        .into()),
    }
}

fn look(file: &Path) -> Result<(Tally, Option<f64>), ReadError> {
    let mut reader = Reader::open(file, Reader::REPLAY)?;
    let mut rate_hz = None;
    while let Some(read) = reader.read()? {
        if let Read::Entry(Entry::Keyframe(keyframe)) = read {
            rate_hz = keyframe.source.as_ref().map(|source| source.rate_hz).or(rate_hz);
        }
    }
    Ok((reader.tally().clone(), rate_hz))
}

fn unread(file: &Path, error: &ReadError) -> String {
    format!("{}\n", json!({ "file": file, "whole": false, "error": error.to_string() }))
}

fn object(file: &Path, tally: &Tally, rate_hz: Option<f64>) -> String {
    let messages: serde_json::Map<_, _> =
        Topic::ALL.iter().map(|topic| (topic.name().to_owned(), tally.of(*topic).into())).collect();
    let time = tally.time_ns.map(|times| times.map(rfc3339));
    let object = json!({
        "file": file,
        "bytes": tally.size,
        "whole": tally.whole(),
        "finished": tally.finished,
        "torn_bytes": tally.torn,
        "start": time.as_ref().map(|[start, _]| start),
        "end": time.as_ref().map(|[_, end]| end),
        "seconds": tally.seconds(),
        "rate_hz": rate_hz,
        "messages": messages,
        "other_messages": tally.strange,
        "configs": tally.configs.iter().map(|id| format!("{id:08x}")).collect::<Vec<_>>(),
        "lost_samples": tally.lost,
        "lock": tally.locks,
        "gaps": tally.gaps.iter()
            .map(|gap| json!({ "entries": gap.entries, "reason": gap.reason }))
            .collect::<Vec<_>>(),
        "damage": tally.damages.iter()
            .map(|d| json!({ "at": d.at, "bytes": d.bytes, "what": d.what }))
            .collect::<Vec<_>>(),
    });
    format!("{object}\n")
}

fn lines(file: &Path, tally: &Tally, rate_hz: Option<f64>) -> String {
    let mut text = String::new();
    let mut say = |subject: &str, what: String| {
        let _ = writeln!(text, "{subject:<10} {what}"); // writing to a String cannot fail
    };
    say("file", format!("{}, {} bytes", file.display(), tally.size));
    match tally.time_ns {
        Some(times) => {
            let [start, end] = times.map(rfc3339);
            say("time", format!("{start} to {end}, {:.3} s", tally.seconds()));
        }
        None => say("time", "the file contains no trifacet data".into()),
    }
    if let Some(rate_hz) = rate_hz {
        say("source", format!("{rate_hz} Hz, {} samples lost before recording", tally.lost));
    }
    for (i, id) in tally.configs.iter().enumerate() {
        say(if i == 0 { "config" } else { "changed to" }, format!("{id:08x}"));
    }
    for topic in Topic::ALL.into_iter().filter(|topic| tally.of(*topic) > 0) {
        say("messages", format!("{:>9} on {}", tally.of(topic), topic.name()));
    }
    if tally.strange > 0 {
        say("messages", format!("{:>9} of other programs", tally.strange));
    }
    for change in &tally.locks {
        say("lock", change.clone());
    }
    for gap in &tally.gaps {
        say("gap", gap.to_string());
    }
    for damage in &tally.damages {
        say("damage", damage.to_string());
    }
    if let Some(cost) = tally.without_config() {
        say("damage", cost);
    }
    say("end", tally.unfinished().unwrap_or_else(|| "closed properly".into()));
    text
}
