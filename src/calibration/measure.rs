//! The measurement of a point: waits until the mirror is at rest, and averages until the noise is small enough.

use std::fmt::Write as _;

use trifacet_core::time::Clock;
use trifacet_optics::{Estimator, Model, Optics, Signals};

use super::bench::{Bench, usable};
use super::effort;
use super::reading::{Flaw, RawSample, Reading};
use super::rest::{self, Motion};
use crate::acquisition::Source;
use crate::config::Axis;
use crate::exit::Failure;

/// Time in which the mirror must be at rest, seconds.
const REST_S: f64 = 0.128;
/// Samples are judged again after this fraction of the time at rest.
const STRIDE: usize = 4;
/// Deviations of the pose per deviation of a spot: metres, then radians per metre. By these, the axis is found that
/// moves.
const SENSITIVITY: [f64; 6] = [0.91, 0.91, 0.58, 1.63, 1.63, 2.31];

/// What a point must satisfy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Largest standard uncertainty of the mean of a spot coordinate, metres.
    pub noise: f64,
    /// Time after which the point is given up, seconds.
    pub patience_s: f64,
    /// Whether the loop is manual, so that the beam is not on the apex.
    pub manual: bool,
}

/// Why a point was not measured.
#[derive(Debug, thiserror::Error)]
pub enum NoReading {
    /// It did not come to rest, or its samples do not count. The next attempt may succeed.
    #[error("{0}")]
    Restless(String),
    /// The measurement cannot go on.
    #[error(transparent)]
    Failed(#[from] Failure),
}

/// The samples of a point so far.
struct Samples {
    taken: Vec<RawSample>,
    left_out: u32,
    /// Number of samples that are judged next.
    size: usize,
    motion: Option<Motion>,
    flaw: Option<Flaw>,
}

/// Measures a point at which the mirror arrives, or has arrived.
///
/// # Errors
/// The mirror does not come to rest in time; no samples arrive; the measurement is interrupted.
pub async fn measure<S: Source, C: Clock>(
    bench: &mut Bench<S, C>,
    goal: Goal,
    optics: &Optics,
) -> Result<Reading, NoReading> {
    // In a scan the mirror has been at rest before, and only the stage moves.
    let rest_s = if goal.manual { 0.0 } else { REST_S };
    let fewest = rest::FEWEST.max((rest_s * bench.rate_hz()) as usize);
    let mut samples = Samples { taken: Vec::new(), left_out: 0, size: fewest, motion: None, flaw: None };
    let mut since = None;
    loop {
        let sample = bench.next().await?;
        let seconds = sample.time.seconds_since(*since.get_or_insert(sample.time));
        samples.push(sample, goal.manual);
        if samples.taken.len() >= samples.size
            && let Some(reading) = samples.judged(bench, goal, fewest)
        {
            return Ok(reading);
        }
        if seconds > goal.patience_s {
            return Err(NoReading::Restless(samples.complaint(bench.stage_trouble(), goal, optics)));
        }
    }
}

impl Samples {
    fn push(&mut self, sample: RawSample, manual: bool) {
        if usable(&sample, manual) {
            self.taken.push(sample);
            return;
        }
        self.flaw = sample.flaw;
        if sample.flaw.is_some_and(Flaw::interrupts) {
            self.taken.clear();
            self.left_out = 0;
        } else {
            self.left_out += 1;
        }
    }

    /// The reading, if the mirror was at rest in all these samples and they are enough.
    fn judged<S: Source, C: Clock>(
        &mut self,
        bench: &Bench<S, C>,
        goal: Goal,
        fewest: usize,
    ) -> Option<Reading> {
        self.flaw = None;
        let spots: Vec<[f64; 6]> = self.taken.iter().map(|sample| sample.spots).collect();
        let motion = rest::motion(&spots, &bench.steps().spots);
        if motion.is_some() {
            self.motion = motion;
            let keep = fewest - fewest / STRIDE;
            self.taken.drain(..self.taken.len() - keep);
            (self.size, self.left_out) = (fewest, 0);
            return None;
        }
        let reading = Reading::new(&self.taken, bench.steps(), self.left_out)?;
        let most = effort::MOST as usize;
        if reading.noise() <= goal.noise || self.taken.len() >= most {
            return Some(reading);
        }
        let times = (reading.noise() / goal.noise).powi(2);
        let more = self.taken.len() + fewest / STRIDE;
        self.size = ((self.taken.len() as f64 * times) as usize).clamp(more, most);
        None
    }

    fn complaint(&self, stage: Option<&str>, goal: Goal, optics: &Optics) -> String {
        let seconds = goal.patience_s;
        if let Some(flaw) = self.flaw {
            let stage = stage.map_or_else(String::new, |why| format!("; {why}"));
            return format!("no reading within {seconds} s: {flaw}{stage}");
        }
        let Some(motion) = self.motion else {
            let (taken, noise) = (self.taken.len(), goal.noise * 1e6);
            return format!(
                "no reading within {seconds} s: {taken} samples have more noise than {noise:.3} um"
            );
        };
        let mut text = format!("the mirror is not at rest after {seconds} s: {motion}");
        if let Some((axis, rms)) = self.moving_axis(optics) {
            // Writing to a string cannot fail.
            let _ =
                write!(text, "; mostly {} moves, by {:.2} {} rms", axis.name(), rms * 1e6, axis.micro_unit());
        }
        text
    }

    /// The axis of the mirror that moves most, compared with the noise, and the rms of its motion.
    fn moving_axis(&self, optics: &Optics) -> Option<(Axis, f64)> {
        let estimator = Estimator::new(optics.clone(), Model::Gaussian);
        let pose = |s: &RawSample| {
            estimator
                .solve(&Signals { spots: s.spots, powers: s.powers }, None)
                .ok()
                .map(|s| s.pose.to_array())
        };
        let poses: Vec<[f64; 6]> = self.taken.iter().filter_map(pose).collect();
        let n = poses.len() as f64;
        let rms = |axis: Axis| {
            let mean = poses.iter().map(|p| p[axis as usize]).sum::<f64>() / n;
            (poses.iter().map(|p| (p[axis as usize] - mean).powi(2)).sum::<f64>() / n).sqrt()
        };
        let all = Axis::ALL.into_iter().map(|axis| (axis, rms(axis))).filter(|(_, rms)| rms.is_finite());
        all.max_by(|(a, x), (b, y)| (x / SENSITIVITY[*a as usize]).total_cmp(&(y / SENSITIVITY[*b as usize])))
    }
}
