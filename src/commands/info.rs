//! `trifacet info`: what a recording holds, and whether it is whole.

use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use trifacet::exit::{self, Failure};
use trifacet::publishing::columns::rfc3339;
use trifacet::recording::reader::Tally;
use trifacet::recording::{Reader, Topic};

use super::written;

/// Arguments of `info`.
#[derive(Debug, clap::Args)]
pub(crate) struct InfoArgs {
    /// Recordings
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// One JSON object for each file
    #[arg(long)]
    json: bool,
}

/// Says what is in each file; fails if one is not whole.
pub(crate) fn info(args: &InfoArgs) -> anyhow::Result<()> {
    let mut text = String::new();
    let mut broken = 0;
    for file in &args.files {
        let (tally, rate_hz) = look(file)?;
        broken += u32::from(!tally.whole());
        if args.json {
            let _ = writeln!(text, "{}", object(file, &tally, rate_hz)); // a String takes everything
        } else {
            text.push_str(&lines(file, &tally, rate_hz));
        }
    }
    written(io::stdout().write_all(text.as_bytes()))?;
    match broken {
        0 => Ok(()),
        n => Err(Failure::new(exit::DATA, format!("{n} of {} files not whole", args.files.len())).into()),
    }
}

fn look(file: &Path) -> anyhow::Result<(Tally, Option<f64>)> {
    let mut reader = Reader::open(file, Reader::REPLAY)?;
    let mut rate_hz = None;
    while let Some(read) = reader.read()? {
        if let trifacet::recording::reader::Read::Entry(trifacet::recording::Entry::Keyframe(keyframe)) = read
        {
            rate_hz = keyframe.source.as_ref().map(|source| source.rate_hz).or(rate_hz);
        }
    }
    Ok((reader.tally().clone(), rate_hz))
}

fn object(file: &Path, tally: &Tally, rate_hz: Option<f64>) -> Value {
    let messages: serde_json::Map<_, _> =
        Topic::ALL.iter().map(|topic| (topic.name().to_owned(), tally.of(*topic).into())).collect();
    let time = tally.time_ns.map(|times| times.map(rfc3339));
    json!({
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
        "gaps": tally.gaps.iter().map(|(entries, why)| json!({ "entries": entries, "reason": why })).collect::<Vec<_>>(),
        "damage": tally.damages.iter()
            .map(|d| json!({ "at": d.at, "bytes": d.bytes, "what": d.what }))
            .collect::<Vec<_>>(),
    })
}

fn lines(file: &Path, tally: &Tally, rate_hz: Option<f64>) -> String {
    let mut text = String::new();
    let mut say = |subject: &str, what: String| {
        let _ = writeln!(text, "{subject:<10} {what}"); // a String takes everything
    };
    say("file", format!("{}, {} bytes", file.display(), tally.size));
    match tally.time_ns {
        Some(times) => {
            let [start, end] = times.map(rfc3339);
            say("time", format!("{start} to {end}, {:.3} s", tally.seconds()));
        }
        None => say("time", "nothing is in it".into()),
    }
    if let Some(rate_hz) = rate_hz {
        say("source", format!("{rate_hz} Hz, {} samples lost before they were recorded", tally.lost));
    }
    for (i, id) in tally.configs.iter().enumerate() {
        say(if i == 0 { "config" } else { "then" }, format!("{id:08x}"));
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
    for (entries, why) in &tally.gaps {
        say("gap", format!("{entries} entries were not recorded: {why}"));
    }
    for damage in &tally.damages {
        say("damage", damage.to_string());
    }
    say("end", end(tally));
    text
}

/// How the file ends.
fn end(tally: &Tally) -> String {
    match (tally.finished, tally.torn) {
        (true, _) => "closed as it should be".into(),
        (false, 0) => "not closed: the recorder was stopped, or still writes".into(),
        (false, torn) => format!(
            "not closed: the recorder was stopped, or still writes; {torn} bytes at the end are no whole chunk, \
             which is up to a second"
        ),
    }
}
