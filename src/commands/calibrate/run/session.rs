//! A session: pose after pose, with the scans of the steering before and after.

use std::collections::{BTreeSet, HashSet};
use std::path::PathBuf;

use indicatif::{ProgressBar, ProgressStyle};
use trifacet::acquisition::Source;
use trifacet::calibration::bench::Bench;
use trifacet::calibration::measure::{Goal, NoReading, measure};
use trifacet::calibration::points_writer;
use trifacet::calibration::reading::Reading;
use trifacet::clock::utc;
use trifacet::config::Config;
use trifacet::core::time::Clock;
use trifacet::exit::{self, Failure};
use trifacet_optics::calibration::plan::{Planned, cells};
use trifacet_optics::{Model, Optics, Pose, Vec2};

use super::RunArgs;
use super::folder::RunFolder;
use super::reference::{Reference, Said};
use super::scan::{Scanned, scan};

/// A scan before the first point, and after the last one.
const SCANS: [&str; 2] = ["scan.csv", "scan-end.csv"];
/// Points in a row without a reading after which the session ends.
const VAIN: usize = 3;
/// The spots must follow a move of the reference that is expected to shift them by this much, metres, ...
const SHIFT: f64 = 50e-6;
/// ... by at least this part of it.
const FOLLOWED: f64 = 0.2;

/// The session.
pub(super) struct Session<'a, S, C> {
    args: &'a RunArgs,
    optics: Optics,
    goal: Goal,
    plan: &'a [Planned],
    bench: Bench<S, C>,
    reference: Reference,
    folder: RunFolder,
    clocks: (i64, i64),
    done: BTreeSet<u32>,
    skipped: BTreeSet<u32>,
    left_out: u64,
    cells: [HashSet<[i32; 2]>; 3],
    /// The reference and the spots of the point before.
    last: Option<(u32, [f64; 6], [f64; 6])>,
    bar: ProgressBar,
}

/// What a session leaves.
pub(super) struct Outcome {
    file: PathBuf,
    done: usize,
    of: usize,
    skipped: BTreeSet<u32>,
}

impl Outcome {
    /// An error with the state of the session.
    pub(super) fn explain(&self, error: anyhow::Error) -> anyhow::Error {
        let kept =
            format!("{} of {} poses are in {}; --resume continues", self.done, self.of, self.file.display());
        match error.downcast::<Failure>() {
            Ok(failure) => Failure::new(failure.code, format!("{}\n{kept}", failure.message)).into(),
            Err(other) => other.context(kept),
        }
    }

    /// An error if points are missing.
    pub(super) fn into_result(self) -> anyhow::Result<()> {
        eprintln!("{} of {} poses are in {}", self.done, self.of, self.file.display());
        if self.skipped.is_empty() {
            return Ok(());
        }
        let points = self.skipped.iter().map(u32::to_string).collect::<Vec<_>>().join(", ");
        let what = format!("not measured: poses {points}; --resume measures them");
        Err(Failure::new(exit::DATA, what).into())
    }
}

impl<'a, S: Source, C: Clock> Session<'a, S, C> {
    /// A session before its first pose.
    pub(super) fn new(
        args: &'a RunArgs,
        config: &Config,
        plan: &'a [Planned],
        bench: Bench<S, C>,
        reference: Reference,
        folder: RunFolder,
    ) -> Result<Self, Failure> {
        let optics = config.optics().map_err(|e| Failure::new(exit::CONFIG, e.to_string()))?;
        let noise = args.noise.noise().at_psd(config);
        let done: BTreeSet<u32> = folder.done.iter().copied().collect();
        let style = ProgressStyle::with_template("{bar:30} {pos}/{len} poses, {eta} left, {msg}");
        let bar = ProgressBar::new(plan.len() as u64)
            .with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
            .with_position(done.len() as u64);
        if reference.is_manual() {
            bar.set_draw_target(indicatif::ProgressDrawTarget::hidden()); // the prompts show the progress
        }
        Ok(Self {
            args,
            optics,
            goal: Goal { noise, patience_s: args.rest_timeout, manual: false },
            plan,
            bench,
            reference,
            folder,
            clocks: utc_clocks(),
            done,
            skipped: BTreeSet::new(),
            left_out: 0,
            cells: Default::default(),
            last: None,
            bar,
        })
    }

    /// The result so far, and the bench.
    pub(super) fn into_parts(self) -> (Outcome, Bench<S, C>) {
        self.bar.finish_and_clear();
        let (done, of) = (self.done.len(), self.plan.len());
        (Outcome { file: self.folder.file(), done, of, skipped: self.skipped }, self.bench)
    }

    /// Measures all poses that are missing.
    pub(super) async fn all(&mut self) -> anyhow::Result<()> {
        let mut vain = 0;
        if !self.done.is_empty() {
            self.again_at_start().await?;
        }
        for (number, planned) in (1..).zip(self.plan) {
            if self.done.contains(&number) {
                continue;
            }
            if self.point(number, planned).await? {
                vain = 0;
            } else {
                vain += 1;
                self.skipped.insert(number);
            }
            if vain >= VAIN && !self.reference.is_manual() {
                let what = format!("{VAIN} poses in a row have no reading");
                return Err(Failure::new(exit::UNAVAILABLE, what).into());
            }
            if number == 1 && vain == 0 {
                self.scan(SCANS[0]).await?;
            }
            self.report(number, planned);
        }
        if self.last.is_some_and(|(number, ..)| number as usize == self.plan.len()) {
            self.scan(SCANS[1]).await?;
        }
        if self.left_out > 0 {
            eprintln!(
                "samples left out of the means because others before them were lost: {}",
                self.left_out
            );
        }
        Ok(())
    }

    /// A continued session visits the first pose again: drift during the break shows.
    async fn again_at_start(&mut self) -> anyhow::Result<()> {
        eprintln!("{} of {} poses are measured already", self.done.len(), self.plan.len());
        let Some(first) = self.plan.first().filter(|first| first.tare) else { return Ok(()) };
        if self.done.len() < self.plan.len() && self.point(1, first).await? {
            self.scan(SCANS[0]).await?;
        }
        Ok(())
    }

    /// Measures a pose. Returns false if it is omitted.
    async fn point(&mut self, number: u32, planned: &Planned) -> anyhow::Result<bool> {
        loop {
            let said = self.reference.ask(number, self.plan.len(), planned, &mut self.bench).await?;
            let Said::At(pose) = said else { return Ok(false) };
            let why = match measure(&mut self.bench, self.goal, &self.optics).await {
                Ok(reading) => match self.contradiction(&pose, &reading) {
                    None => {
                        self.keep(number, &pose, &reading)?;
                        self.bench.wait_for_recorder().await;
                        return Ok(true);
                    }
                    Some(why) if self.reference.is_manual() => why,
                    Some(why) => {
                        return Err(Failure::new(exit::DATA, format!("point {number}: {why}")).into());
                    }
                },
                Err(NoReading::Restless(why)) => why,
                Err(NoReading::Failed(failure)) => return Err(failure.into()),
            };
            self.bar.suspend(|| eprintln!("point {number}: {why}"));
            // The operator is asked again, and can omit the point; nobody else can be asked.
            if !self.reference.is_manual() {
                return Ok(false);
            }
        }
    }

    /// Why the reference and the spots cannot both be right: the one has moved since the point before, the others
    /// have not.
    fn contradiction(&self, pose: &[f64; 6], reading: &Reading) -> Option<String> {
        let (number, before, spots) = self.last.filter(|_| !self.reference.is_twin())?;
        if before.map(f64::is_nan) != pose.map(f64::is_nan) {
            return None; // other coordinates are measured: nothing to compare
        }
        let expected = |pose: &[f64; 6]| {
            let pose = Pose::from_array(pose.map(|x| if x.is_nan() { 0.0 } else { x }));
            self.optics.trace(Model::Gaussian, &pose, Vec2::zeros()).ok().map(|reading| reading.spots)
        };
        let way = |from: [f64; 6], to: [f64; 6]| {
            from.iter().zip(to).map(|(from, to)| (to - from).powi(2)).sum::<f64>().sqrt()
        };
        let (shift, seen) = (way(expected(&before)?, expected(pose)?), way(spots, reading.spots));
        (shift > SHIFT && seen < FOLLOWED * shift).then(|| {
            format!(
                "by the reference, the spots must have moved by {:.0} um since point {number}, but they moved by \
                 {:.1} um: has the mirror moved?",
                shift * 1e6,
                seen * 1e6
            )
        })
    }

    fn keep(&mut self, number: u32, pose: &[f64; 6], reading: &Reading) -> anyhow::Result<()> {
        let mut sigmas = self.args.noise.noise().of_pose();
        for (sigma, x) in sigmas.iter_mut().zip(pose) {
            *sigma = if x.is_nan() { f64::NAN } else { *sigma };
        }
        let reference = points_writer::Reference { pose: *pose, sigmas };
        self.folder.points.append(number, utc_s(self.clocks, reading), reading, Some(&reference))?;
        self.done.insert(number);
        self.skipped.remove(&number);
        self.left_out += u64::from(reading.left_out);
        self.last = Some((number, *pose, reading.spots));
        for (hit, cell) in self.cells.iter_mut().zip(cells(&reading.spots)) {
            hit.insert(cell);
        }
        Ok(())
    }

    /// Shows how far the session is.
    fn report(&mut self, number: u32, planned: &Planned) {
        let [a, b, c] = [0, 1, 2].map(|i| self.cells[i].len());
        let covered = format!("cells of 0.4 mm hit: A {a}, B {b}, C {c}");
        self.bar.set_position(self.done.len() as u64);
        self.bar.set_message(covered.clone());
        if planned.tare && self.bar.is_hidden() {
            eprintln!("pose {number} of {}; {covered}", self.plan.len());
        }
    }

    /// Scans the steering, unless that was done before.
    async fn scan(&mut self, name: &str) -> anyhow::Result<()> {
        let Some(mut file) = self.folder.scan(name)? else { return Ok(()) };
        self.bar.suspend(|| eprintln!("scan of the steering: the mirror must stay at rest"));
        let goal = Goal { manual: true, ..self.goal };
        let clocks = self.clocks;
        let utc = move |reading: &Reading| utc_s(clocks, reading);
        let done = scan(&mut self.bench, goal, &self.optics, &mut file, utc).await;
        match done {
            Ok(Scanned::Done(taken)) => {
                self.bar.suspend(|| eprintln!("{name}: {taken} positions"));
                Ok(())
            }
            Ok(Scanned::Omitted(why)) => {
                self.folder.discard_scan(name);
                self.bar.suspend(|| eprintln!("no {name}: {why}"));
                Ok(())
            }
            Err(e) => {
                self.folder.discard_scan(name);
                Err(e)
            }
        }
    }
}

/// The monotonic clock and UTC at the same moment, nanoseconds.
fn utc_clocks() -> (i64, i64) {
    let (mono, utc_ns) = utc::read_clocks();
    (mono.0, utc_ns)
}

/// The time of a reading, UTC seconds since 1970.
fn utc_s((mono, utc_ns): (i64, i64), reading: &Reading) -> f64 {
    (utc_ns + (reading.time.0 - mono)) as f64 * 1e-9
}
