//! Guided measurement: an operator moves the stage, and a running daemon gives the readings, point by
//! point.

use std::fs;
use std::io::{self, BufRead, IsTerminal, Write};

use anyhow::Context;
use tokio::sync::mpsc;
use trifacet::client::Endpoint;
use trifacet::exit::{self, Failure};
use trifacet::experiment::live::{DaemonStream, Trouble};
use trifacet::experiment::observation::Observation;
use trifacet::experiment::protocol::Protocol;
use trifacet::experiment::reading::{self, Part, Reading, Record};
use trifacet::experiment::{place, quantity, three};

use super::plausibility::{implausible, opposite};
use super::steps::{Step, steps};
use super::{ExperimentArgs, READINGS, bar, fresh, keep, long_enough, options};
use crate::commands::watch::{opening_failed, unavailable};

/// Number of attempts to take a record at rest.
const ATTEMPTS: u32 = 3;

/// What the operator entered.
enum Said {
    /// Take the readings of this point; the value is the reference.
    Reference(f64),
    /// Take the record at rest.
    StaticRecord,
    /// Omit the record at rest: the input has ended.
    NoRest,
    /// Repeat the previous point.
    Back,
    /// Stop the session.
    Stop,
}

struct GuidedSession<'a> {
    args: &'a ExperimentArgs,
    feed: DaemonStream,
    lines: mpsc::UnboundedReceiver<String>,
    record: Record,
    /// Number of readings in the file.
    kept: usize,
}

/// Takes the readings of all points together with the operator, and then the record at rest.
///
/// Every completed point is stored in the file at once.
pub(super) fn guided(
    args: &ExperimentArgs,
    endpoint: &Endpoint,
    protocol: &Protocol,
) -> anyhow::Result<Record> {
    let steps = steps(protocol);
    let file = args.out.join(READINGS);
    let options = options(protocol, args.average.unwrap_or(1));
    let mut record = Record { source: endpoint.to_string(), options, readings: Vec::new() };
    if args.resume && file.exists() {
        let before = reading::read(&file)?;
        belongs(&before, &record)?;
        record = before;
    } else {
        fresh(&args.out)?;
    }
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let feed = DaemonStream::connect(endpoint).await.map_err(|e| opening_failed(endpoint, &e))?;
        let kept = record.readings.len();
        let mut session = GuidedSession { args, feed, lines: typed(), record, kept };
        eprintln!("connected to {endpoint}; at each point: b repeats the previous point, q stops; continue later with --resume");
        if args.rest > 0.0 {
            let poses = session.feed.poses(args.rest).await.map_err(|why| lost(&why))?;
            long_enough(args.rest, poses as f64)?;
        }
        let done = session.all(&steps).await;
        done.map_err(|e| session.kept(&e))?;
        Ok(session.record)
    })
}

/// Checks that stored readings have the same source and the same options.
fn belongs(before: &Record, now: &Record) -> Result<(), Failure> {
    for (what, before, now) in
        [("source", &before.source, &now.source), ("options", &before.options, &now.options)]
    {
        if before != now {
            let message = format!(
                "{READINGS} contains \"{what}: {before}\", but now it is \"{now}\": use the same options as before, \
                or choose a new folder with --out"
            );
            return Err(Failure::new(exit::USAGE, message));
        }
    }
    Ok(())
}

/// Lines of standard input. A separate thread reads them; it is not joined at the end.
fn typed() -> mpsc::UnboundedReceiver<String> {
    let (sender, lines) = mpsc::unbounded_channel();
    std::thread::spawn(move || {
        io::stdin().lock().lines().map_while(Result::ok).try_for_each(|line| sender.send(line))
    });
    lines
}

impl GuidedSession<'_> {
    async fn all(&mut self, steps: &[Step]) -> anyhow::Result<()> {
        let mut next = steps.iter().take_while(|s| self.record.readings.iter().any(|r| s.took(r))).count();
        loop {
            let said = match steps.get(next) {
                Some(step) => self.ask(step, steps).await?,
                None if self.rested() => return Ok(()),
                None => self.ask_rest().await?,
            };
            match said {
                Said::Reference(reference) => next += usize::from(self.take(&steps[next], reference).await?),
                Said::StaticRecord => self.rest().await?,
                Said::NoRest => return Ok(()),
                Said::Back if next == 0 => eprintln!("this is the first point"),
                Said::Back => {
                    next -= 1;
                    self.record.readings.retain(|r| !steps[next].took(r));
                    self.keep()?;
                }
                Said::Stop => return Err(Failure::new(exit::INTERRUPTED, "stopped").into()),
            }
        }
    }

    /// Prompts until the operator enters a valid answer.
    async fn ask(&mut self, step: &Step, steps: &[Step]) -> anyhow::Result<Said> {
        let Step { axis, point, of, target } = *step;
        let (name, unit) = (axis.name(), axis.micro_unit());
        let given = self.args.reference.is_some();
        let want =
            if given { "then Enter".into() } else { format!("type the interferometer's reading in {unit}") };
        loop {
            eprint!(
                "{name} point {point} of {of}: move the stage to {} {unit}, {want}: ",
                place(target * 1e6)
            );
            let ended = || Failure::new(exit::DATA, "the input has ended before the last point");
            let line = self.line().await?.ok_or_else(ended)?;
            let wrong = match line.trim() {
                "b" => return Ok(Said::Back),
                "q" => return Ok(Said::Stop),
                "" if given => return Ok(Said::Reference(target)),
                _ if given => {
                    "the reference of this point is in the file: press Enter, or type b or q".into()
                }
                text => match quantity::parse(axis, text) {
                    Ok(reference) => match implausible(step, steps, reference, &self.record.readings) {
                        None => return Ok(Said::Reference(reference)),
                        Some(why) => why,
                    },
                    Err(why) => why.to_string(),
                },
            };
            once_more(exit::DATA, &wrong)?;
        }
    }

    /// Prompts until the operator starts the record at rest.
    async fn ask_rest(&mut self) -> anyhow::Result<Said> {
        let seconds = self.args.rest;
        loop {
            eprint!("record at rest: do not move the mirror for {seconds} s; Enter starts it: ");
            match self.line().await?.as_deref().map(str::trim) {
                Some("") => return Ok(Said::StaticRecord),
                Some("b") => return Ok(Said::Back),
                Some("q") => return Ok(Said::Stop),
                Some(_) => once_more(exit::DATA, "press Enter, or type b or q")?,
                None => {
                    eprintln!("the input has ended: the report is made without a record at rest");
                    return Ok(Said::NoRest);
                }
            }
        }
    }

    /// The next line of input. `None` at the end of the input.
    async fn line(&mut self) -> anyhow::Result<Option<String>> {
        let _ = io::stderr().flush(); // without the prompt, the operator cannot answer
        self.feed.until(self.lines.recv()).await.map_err(|why| lost(&why))
    }

    /// Takes the readings of a point. Returns `false` and prints the reason if there are no usable readings.
    async fn take(&mut self, step: &Step, reference: f64) -> anyhow::Result<bool> {
        let progress = bar(self.args.readings.into());
        let counted = |_: &[Observation]| {
            progress.inc(1);
            Ok(())
        };
        let looks = self.feed.readings(self.args.readings, self.average(), counted).await;
        progress.finish_and_clear();
        let looks = match looks {
            Ok(looks) => looks,
            Err(why @ Trouble::NoPose { .. }) => {
                let why = format!("{why}\nsolve this and try again; `trifacet doctor` may find the cause");
                return once_more(exit::UNAVAILABLE, &why).map(|()| false);
            }
            Err(why) => return Err(lost(&why)),
        };
        if self.other_config(step, &looks) {
            let what = "geometry, calibration or frames of the sensor have changed since the previous points (a tare?)";
            let name = step.axis.name();
            let why = format!("{what}: this point is not stored; undo the change, or repeat {name} with b");
            return once_more(exit::DATA, &why).map(|()| false);
        }
        say(step, reference, &looks);
        if let Some(why) = opposite(step, reference, &looks, &self.record.readings) {
            eprintln!("{why}");
        }
        let moved = Some((step.axis, reference));
        let taken = (1..).zip(looks).map(|(number, look)| Reading {
            part: Part::Table2,
            moved,
            point: step.point,
            number,
            look,
        });
        self.record.readings.extend(taken);
        self.keep()?;
        Ok(true)
    }

    /// Whether the configuration has changed since earlier readings of the same axis, or during these.
    fn other_config(&self, step: &Step, looks: &[Observation]) -> bool {
        let before =
            self.record.readings.iter().filter(|r| r.moved.is_some_and(|(axis, _)| axis == step.axis));
        let mut configs = before.map(|r| r.look.config).chain(looks.iter().map(|look| look.config));
        let first = configs.next();
        configs.any(|config| Some(config) != first)
    }

    fn average(&self) -> u32 {
        self.args.average.unwrap_or(1).into()
    }

    /// Whether the record at rest is complete or not requested.
    fn rested(&self) -> bool {
        self.args.rest == 0.0 || self.record.readings.iter().any(|r| r.part == Part::StaticRecord)
    }

    /// Takes the record at rest, or prints the reason for its absence.
    async fn rest(&mut self) -> anyhow::Result<()> {
        eprintln!("recording");
        match self.record(self.args.rest).await {
            Ok(looks) => {
                let at_rest = |(number, look)| Reading {
                    part: Part::StaticRecord,
                    moved: None,
                    point: 0,
                    number,
                    look,
                };
                self.record.readings.extend((1..).zip(looks).map(at_rest));
                self.keep()
            }
            Err(why @ (Trouble::NoPose { .. } | Trouble::Parted(_))) => {
                let what =
                    "solve this and try again; or stop with q, and continue with --resume and --rest 0";
                once_more(exit::UNAVAILABLE, &format!("{why}\n{what}"))
            }
            Err(why) => Err(lost(&why)),
        }
    }

    /// Updates the file. If there are no readings, removes it.
    fn keep(&mut self) -> anyhow::Result<()> {
        let n = self.record.readings.len();
        if n == 0 {
            let file = self.args.out.join(READINGS);
            fs::remove_file(&file).with_context(|| format!("cannot remove {}", file.display()))?;
        } else {
            keep(&self.record, &self.args.out)?;
        }
        self.kept = n;
        Ok(())
    }

    /// Takes the record at rest. It is started again a few times if it has a gap.
    async fn record(&mut self, seconds: f64) -> Result<Vec<Observation>, Trouble> {
        for _ in 1..ATTEMPTS {
            match self.feed.rest(seconds).await {
                Err(Trouble::Parted(why)) => eprintln!("{why}: the record starts again"),
                other => return other,
            }
        }
        self.feed.rest(seconds).await
    }

    /// Adds to an error which readings are stored.
    fn kept(&self, why: &anyhow::Error) -> anyhow::Error {
        let code = why.downcast_ref::<Failure>().map_or(exit::IO, |failure| failure.code);
        let out = self.args.out.display();
        let go_on = match self.kept {
            0 => "no readings are stored".into(),
            n => {
                format!(
                    "{n} readings are stored in {out}/{READINGS}; continue with the same options and --resume"
                )
            }
        };
        Failure::new(code, format!("{why:#}\n{go_on}")).into()
    }
}

/// At a terminal, the operator is prompted again. In a file or a pipe, the next line belongs to the next
/// point, so the session ends.
fn once_more(code: u8, why: &str) -> anyhow::Result<()> {
    if io::stdin().is_terminal() {
        eprintln!("{why}");
        return Ok(());
    }
    let message = format!("{why}\nthe input is not a terminal: its next line would be used for this point");
    Err(Failure::new(code, message).into())
}

/// Prints a summary of the readings of a point, one line.
fn say(step: &Step, reference: f64, looks: &[Observation]) {
    let (i, n) = (step.axis as usize, looks.len() as f64);
    let mean = looks.iter().map(|look| look.pose[i]).sum::<f64>() / n;
    let std = (looks.iter().map(|look| (look.pose[i] - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
    let unit = step.axis.micro_unit();
    let [mean, reference] = [mean, reference].map(|x| x * 1e6);
    eprintln!(
        "  {n} readings: {mean:+.3} {unit}, standard deviation {} {unit}, reference {reference:+.3} {unit}",
        three(std * 1e6)
    );
}

fn lost(why: &Trouble) -> anyhow::Error {
    unavailable(why.to_string())
}
