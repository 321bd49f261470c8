//! `trifacet replay`: recorded samples through the same code once more.

mod output;
mod statistics;

use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::Duration;

use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use trifacet::clock::{Clock, Mono, NS_PER_S, SystemClock};
use trifacet::config::{self, Meaning};
use trifacet::exit::{self, Failure};
use trifacet::publishing::columns::{Value, rfc3339};
use trifacet::recording::Entry;
use trifacet::recording::reader::{Read, Tally};
use trifacet::replay::feed::{self, News};
use trifacet::replay::verdict::Difference;
use trifacet::replay::{Engine, Verdict};

use output::Output;
use statistics::Statistics;

/// Arguments of `replay`.
#[derive(Debug, clap::Args)]
pub(crate) struct ReplayArgs {
    /// Recordings; the files of one that was rotated in their order
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// With this configuration instead of the recorded one; the differences are then statistics
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// So many times as fast as it was recorded; by default as fast as possible
    #[arg(long, value_name = "N")]
    speed: Option<f64>,
    /// Write what comes out: .mcap as a recording, .csv as a table of frames
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// Computes all poses again, and says whether they are what was published then.
pub(crate) fn replay(args: &ReplayArgs) -> anyhow::Result<()> {
    if let Some(speed) = args.speed.filter(|speed| !(*speed >= 0.001 && *speed <= 1e6)) {
        let why = format!("--speed {speed}: allowed is 0.001 to 1000000");
        return Err(Failure::new(exit::USAGE, why).into());
    }
    let engine = match &args.config {
        None => Engine::new(),
        Some(file) => Engine::with(Meaning::read(config::load(Some(file))?)?),
    };
    let output = args.output.as_deref().map(Output::create).transpose()?;
    let size = args.files.iter().filter_map(|file| file.metadata().ok()).map(|about| about.len()).sum();
    let mut run = Run {
        engine,
        verdict: Verdict::default(),
        statistics: args.config.is_some().then(Statistics::default),
        pace: args.speed.map(Pace::new),
        output,
        cold: false,
    };
    let bar = bar(size);
    let mut tallies = Vec::new();
    for news in feed::read(args.files.clone()) {
        match news {
            News::Read(reads, at) => {
                bar.set_position(at);
                for read in &reads {
                    bar.suspend_if(read);
                    run.take(read)?;
                }
            }
            News::End(file, tally) => tallies.push((file, tally)),
            News::Failed(error) => {
                bar.0.finish_and_clear();
                return Err(error.into());
            }
        }
    }
    bar.0.finish_and_clear();
    run.end(&tallies)
}

/// A bar on standard error, if that is a terminal.
struct Bar(ProgressBar);

fn bar(size: u64) -> Bar {
    let style = ProgressStyle::with_template("{bar:40} {percent} %, {eta} left");
    let style = style.unwrap_or_else(|_| ProgressStyle::default_bar());
    Bar(ProgressBar::new(size).with_style(style))
}

impl Bar {
    fn set_position(&self, at: u64) {
        self.0.set_position(at);
    }

    /// Says what is wrong with the file above the bar.
    fn suspend_if(&self, read: &Read) {
        let line = match read {
            Read::Damage(damage) => format!("damage {damage}"),
            Read::Gap { entries, reason } => format!("gap: {entries} entries were not recorded: {reason}"),
            Read::Foreign { .. } | Read::Entry(_) => return,
        };
        self.0.suspend(|| eprintln!("trifacet: {line}"));
    }
}

/// Recorded time to present time.
struct Pace {
    speed: f64,
    /// A recorded moment and the present one that belongs to it.
    start: Option<(Mono, Mono)>,
}

impl Pace {
    fn new(speed: f64) -> Self {
        Self { speed, start: None }
    }

    /// Waits until it is the turn of a recorded moment.
    fn wait(&mut self, entry: &Entry) {
        let (Entry::Sample { scan: trifacet::acquisition::Scan { time, .. }, .. }
        | Entry::Silence { time, .. }) = entry
        else {
            return;
        };
        let now = SystemClock.now();
        let (then, start) = *self.start.get_or_insert((*time, now));
        let due_s = time.seconds_since(then) / self.speed - now.seconds_since(start);
        // Another boot of the machine, or another recording: its time begins anew.
        if !(-1.0..=10.0).contains(&(due_s * self.speed)) {
            self.start = Some((*time, now));
        } else if due_s > 0.0 {
            sleep(Duration::from_nanos((due_s * NS_PER_S as f64) as u64));
        }
    }
}

struct Run {
    engine: Engine,
    verdict: Verdict,
    statistics: Option<Statistics>,
    pace: Option<Pace>,
    output: Option<Output>,
    /// Another version wrote the state.
    cold: bool,
}

impl Run {
    fn take(&mut self, read: &Read) -> anyhow::Result<()> {
        let entry = match read {
            Read::Entry(entry) => entry,
            Read::Gap { .. } => return Ok(()),
            Read::Foreign { meaning, source, why } => {
                if !std::mem::replace(&mut self.cold, true) {
                    eprintln!(
                        "trifacet: {why}: the replay begins without it, and is not the same bit by bit"
                    );
                }
                return Ok(self.engine.cold(meaning, source.as_ref())?);
            }
            Read::Damage(_) => {
                self.engine.hole();
                self.verdict.hole();
                return Ok(());
            }
        };
        if let Some(pace) = &mut self.pace {
            pace.wait(entry);
        }
        self.engine.take(entry)?;
        let pair = self.verdict.take(entry, self.engine.report());
        if let Some((statistics, pair)) = self.statistics.as_mut().zip(pair) {
            statistics.push(&pair);
        }
        match &mut self.output {
            None => Ok(()),
            Some(output) => output.take(entry, pair.as_ref(), &self.engine),
        }
    }

    fn end(mut self, tallies: &[(PathBuf, Box<Tally>)]) -> anyhow::Result<()> {
        if let Some(output) = self.output.take() {
            output.finish()?;
        }
        for (file, tally) in tallies {
            unfinished(file, tally);
        }
        let Verdict { same, other, unrecorded, unrepeated, first, .. } = &self.verdict;
        if same + other == 0 {
            return Err(Failure::new(
                exit::DATA,
                "no frame can be computed again: is this a recording of trifacet?",
            )
            .into());
        }
        if let Some(statistics) = &self.statistics {
            print!("{}", statistics.text(*same));
            return Ok(());
        }
        println!("{same} of {} frames are identical, bit by bit", same + other);
        if unrecorded + unrepeated > 0 {
            println!(
                "{unrecorded} reports have no frame on record, {unrepeated} frames have nothing on record to compute them from"
            );
        }
        println!(
            "the state was taken from {} keyframes, in between it went on by itself",
            self.engine.taken_up
        );
        match first {
            None => Ok(()),
            Some(_) if self.cold => Ok(()),
            Some(difference) => Err(Failure::new(exit::DIFFERENT, first_difference(difference)).into()),
        }
    }
}

fn unfinished(file: &Path, tally: &Tally) {
    if !tally.finished {
        eprintln!(
            "trifacet: {} was not closed; {} bytes at its end are no whole chunk",
            file.display(),
            tally.torn
        );
    }
}

fn first_difference(difference: &Difference) -> String {
    let Difference { time_ns, index, column, then, now } = difference;
    let by = match (then, now) {
        (Value::Number(then), Value::Number(now)) => format!(", by {:e}", now - then),
        _ => String::new(),
    };
    format!(
        "the first difference is at {}, sample {index}: {column} was {}, and is {}{by}",
        rfc3339(*time_ns),
        then.csv(),
        now.csv()
    )
}

/// A file that is not there yet.
pub(crate) fn new_file(path: &Path) -> anyhow::Result<std::fs::File> {
    std::fs::OpenOptions::new().write(true).create_new(true).open(path).map_err(|e| {
        if e.kind() == std::io::ErrorKind::AlreadyExists {
            anyhow::Error::from(Failure::new(
                exit::IO,
                format!("{} exists already: name another file", path.display()),
            ))
        } else {
            anyhow::Error::from(e).context(format!("cannot write {}", path.display()))
        }
    })
}

/// The same as a context.
pub(crate) fn cannot_write<T, E>(result: Result<T, E>, path: &Path) -> anyhow::Result<T>
where
    Result<T, E>: Context<T, E>,
{
    result.with_context(|| format!("cannot write {}", path.display()))
}
