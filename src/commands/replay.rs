//! `trifacet replay`: computes the poses of recorded samples again, with the same code as the daemon.

mod ending;
mod output;
mod statistics;

use std::io::{self, Write};
use std::path::PathBuf;
use std::thread::sleep;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use output::Output;
use statistics::Statistics;
use trifacet::clock::SystemClock;
use trifacet::config::{self, CalibrationContext};
use trifacet::exit::{self, Failure};
use trifacet::recording::reader::{Gap, Read, Tally};
use trifacet::recording::{Entry, Keyframe};
use trifacet::replay::read_ahead::{self, News};
use trifacet::replay::{Comparison, Engine};
use trifacet_core::time::{Clock, Mono, NS_PER_S};

use super::written;

/// Options of `replay`.
#[derive(Debug, clap::Args)]
pub(crate) struct ReplayArgs {
    /// Recordings; the files of a rotated recording in their order
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Use this configuration instead of the recorded one; the differences are then reported as statistics
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Speed relative to that of the recording; by default as fast as possible
    #[arg(long, value_name = "N")]
    speed: Option<f64>,
    /// Write the results: .mcap for a recording, .csv for a table of frames
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// Computes all poses again and reports whether they equal the published ones.
pub(crate) fn replay(args: &ReplayArgs) -> anyhow::Result<()> {
    if let Some(speed) = args.speed.filter(|speed| !(*speed >= 0.001 && *speed <= 1e6)) {
        let why = format!("--speed {speed}: allowed is 0.001 to 1000000");
        return Err(Failure::new(exit::USAGE, why).into());
    }
    let engine = match &args.config {
        None => Engine::new(),
        Some(file) => Engine::with(CalibrationContext::read(config::load(Some(file))?)?),
    };
    let source = args.files.first().and_then(|file| file.metadata().ok());
    let output = args.output.as_deref().map(|path| Output::create(path, source.as_ref())).transpose()?;
    let size = args.files.iter().filter_map(|file| file.metadata().ok()).map(|about| about.len()).sum();
    let mut run = Run {
        engine,
        comparison: Comparison::default(),
        statistics: args.config.is_some().then(Statistics::default),
        pace: args.speed.map(Pace::new),
        output,
        cold: false,
        next_file: false,
    };
    let bar = bar(size);
    let mut tallies = Vec::new();
    for news in read_ahead::read(args.files.clone()) {
        match news {
            News::Read(reads, at) => {
                bar.set_position(at);
                for read in &reads {
                    bar.suspend_if(read);
                    run.take(read)?;
                }
            }
            News::End(file, tally) => {
                run.next_file = true;
                tallies.push((file, tally));
            }
            News::Failed(error) => {
                bar.0.finish_and_clear();
                return Err(error.into());
            }
        }
    }
    bar.0.finish_and_clear();
    run.end(&tallies)
}

/// A progress bar on standard error, if it is a terminal.
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

    /// Prints damage and gaps of the file above the bar.
    fn suspend_if(&self, read: &Read) {
        let line = match read {
            Read::Damage(damage) => format!("damage {damage}"),
            Read::Gap { entries, reason } => format!("gap: {}", gap(*entries, reason)),
            Read::Foreign { .. } | Read::Entry(_) => return,
        };
        self.0.suspend(|| eprintln!("trifacet: {line}"));
    }
}

/// Maps recorded times to present times.
struct Pace {
    speed: f64,
    /// A recorded time and the present time that corresponds to it.
    start: Option<(Mono, Mono)>,
}

impl Pace {
    fn new(speed: f64) -> Self {
        Self { speed, start: None }
    }

    /// Waits until a recorded time is due.
    fn wait(&mut self, entry: &Entry) {
        let (Entry::Sample { scan: trifacet_core::signals::Scan { time, .. }, .. }
        | Entry::Silence { time, .. }) = entry
        else {
            return;
        };
        let now = SystemClock.now();
        let (then, start) = *self.start.get_or_insert((*time, now));
        let due_s = time.seconds_since(then) / self.speed - now.seconds_since(start);
        // Another boot of the machine or another recording: its time starts again.
        if !(-1.0..=10.0).contains(&(due_s * self.speed)) {
            self.start = Some((*time, now));
        } else if due_s > 0.0 {
            sleep(Duration::from_nanos((due_s * NS_PER_S as f64) as u64));
        }
    }
}

struct Run {
    engine: Engine,
    comparison: Comparison,
    statistics: Option<Statistics>,
    pace: Option<Pace>,
    output: Option<Output>,
    /// The state was written by another version, so it cannot be used.
    cold: bool,
    /// Another file has begun, and its first keyframe has not been read yet.
    next_file: bool,
}

impl Run {
    fn take(&mut self, read: &Read) -> anyhow::Result<()> {
        match read {
            Read::Entry(entry) => self.entry(entry)?,
            Read::Gap { entries, reason } => self.hole(gap(*entries, reason)),
            Read::Damage(damage) => {
                self.hole(gap(0, &format!("damaged in the original recording: {damage}")));
            }
            Read::Foreign { context, source, why } => {
                if !std::mem::replace(&mut self.cold, true) {
                    eprintln!(
                        "trifacet: {why}: the replay starts without it, so the results are not identical bit by bit"
                    );
                }
                self.engine.cold(context, source.as_ref())?;
            }
        }
        Ok(())
    }

    fn entry(&mut self, entry: &Entry) -> anyhow::Result<()> {
        if let Entry::Keyframe(keyframe) = entry {
            self.seam(keyframe);
        }
        if let Some(pace) = &mut self.pace {
            pace.wait(entry);
        }
        self.engine.take(entry)?;
        let pair = self.comparison.take(entry, self.engine.report());
        if let Some((statistics, pair)) = self.statistics.as_mut().zip(pair) {
            statistics.push(&pair);
        }
        match &mut self.output {
            None => Ok(()),
            Some(output) => output.take(entry, pair.as_ref(), &self.engine),
        }
    }

    /// Checks that a file continues the previous one.
    fn seam(&mut self, keyframe: &Keyframe) {
        if std::mem::take(&mut self.next_file)
            && let Some(now) = self.engine.now()
            && now.last.map(|scan| scan.index) != keyframe.last.map(|scan| scan.index)
        {
            self.hole(gap(0, "another file begins here that does not continue the previous one"));
        }
    }

    /// Data are missing: frames can be computed again from the next keyframe on.
    fn hole(&mut self, gap: Gap) {
        self.engine.hole();
        self.comparison.hole();
        if let Some(output) = &mut self.output {
            output.gap(gap);
        }
    }

    fn end(self, tallies: &[(PathBuf, Box<Tally>)]) -> anyhow::Result<()> {
        ending::print_irregularities(tallies);
        let Comparison { same, renamed, other, .. } = self.comparison;
        let compared = same + renamed + other;
        if compared == 0 {
            return Err(ending::nothing(tallies).into());
        }
        if let Some(output) = self.output {
            output.finish()?;
        }
        let text = match &self.statistics {
            Some(statistics) => statistics.text(self.comparison.same),
            None => ending::text(&self.comparison, &self.engine),
        };
        written(io::stdout().write_all(text.as_bytes()))?;
        let first = self.comparison.first.filter(|_| self.statistics.is_none() && !self.cold);
        if let Some(difference) = first {
            return Err(ending::different(&difference).into());
        }
        let passed_over = if self.statistics.is_some() { 0 } else { self.comparison.unrepeated };
        ending::holes(tallies, passed_over).map_err(Into::into)
    }
}

fn gap(entries: u64, reason: &str) -> Gap {
    Gap { entries, reason: reason.to_owned() }
}
