//! Checks with one small step of an axis whether the movement of the beam ends within a dwell time.
//!
//! The steps alternate in direction. If the beam responded later than a dwell time, each response would be
//! attributed to the next step, in the opposite direction: the gain would have the wrong sign, and the delay
//! would be too short. Nothing is measured before this is ruled out.

use trifacet_core::steering::BeamPoint;
use trifacet_core::time::Mono;

use super::observation::{self, Observation};
use super::plan::{Plan, refused, um};
use super::record::AXES;
use crate::exit::Failure;

/// Largest fraction of the movement that may be missing at the end of a dwell time.
const MISSING: f64 = 0.1;
/// A movement, and a disturbance of it, are significant from this multiple of the rms variation at rest.
const SEEN: f64 = 6.0;
const DISTURBS: f64 = 4.0;
/// The advised dwell time, in multiples of the start of the movement and of its end.
const STARTS: f64 = 3.0;
const ENDS: f64 = 2.0;

/// The observations around a single step.
#[derive(Debug)]
pub(super) struct Probe<'a> {
    /// Axis: 0 or 1.
    pub(super) axis: usize,
    /// Commanded movement of the axis, metres.
    pub(super) sent: f64,
    /// Time of the sample on which the step was commanded.
    pub(super) zero: Mono,
    /// Observations at rest.
    pub(super) rest: &'a [Observation],
    /// The last observations before the step.
    pub(super) before: &'a [Observation],
    /// All observations after the step.
    pub(super) after: &'a [Observation],
}

impl Probe<'_> {
    /// Checks that the movement ends within a dwell time, and that nothing moves later. `period` is the
    /// sample period in seconds.
    pub(super) fn judge(&self, plan: &Plan, period: f64) -> Result<(), Failure> {
        let block = (plan.dwell / 4).max(1);
        let end = &self.after[self.after.len().saturating_sub(plan.dwell)..];
        let (Some(start), Some(end)) = (middle(self.before), middle(end)) else {
            return Err(refused("there are too few samples"));
        };
        let unrest = unrest(self.rest, block);
        let moved = [end[0] - start[0], end[1] - start[1]];
        let size = moved[0].hypot(moved[1]);
        if size < SEEN * unrest || size < MISSING * MISSING * self.sent {
            return Err(self.still(size, unrest));
        }
        // The movement over time as a fraction of its final value, averaged over blocks.
        let part =
            |at: BeamPoint| ((at[0] - start[0]) * moved[0] + (at[1] - start[1]) * moved[1]) / (size * size);
        let course: Vec<f64> = self.after.windows(block).filter_map(|w| Some(part(middle(w)?))).collect();
        let allowed = MISSING.max(DISTURBS * unrest / size);
        // After a jump, this many samples of a block change its mean by the allowed amount.
        let few = (allowed * block as f64).ceil() as usize;
        let first = course.iter().position(|p| p.abs() > allowed).map_or(0, |i| i + block - few);
        let last = course.iter().rposition(|p| (p - 1.0).abs() > allowed).map_or(0, |i| i + few);
        let time = |i: usize| self.after[i.min(self.after.len() - 1)].time.seconds_since(self.zero);
        let (begins, over) = (time(first), time(last.max(first)));
        let dwell = plan.dwell as f64 * period;
        // The fit searches for the start within half a dwell time.
        if begins <= dwell / 2.0 && over <= dwell {
            return Ok(());
        }
        Err(refused(format!(
            "the movement of the {} axis begins {:.0} ms after the command and ends after {:.0} ms, \
             too late for a dwell of {:.0} ms: use --dwell {:.0}",
            AXES[self.axis],
            begins * 1e3,
            over * 1e3,
            dwell * 1e3,
            rounded_up((STARTS * begins).max(ENDS * over) * 1e3)
        )))
    }

    /// The failure for a beam that has hardly moved.
    fn still(&self, size: f64, unrest: f64) -> Failure {
        let name = AXES[self.axis];
        let read = |looks: &[Observation]| observation::mean(looks.iter().filter_map(|look| look.readback));
        let half = &self.after[self.after.len() / 2..];
        let read = read(self.before).zip(read(half)).map(|(a, b)| (b[self.axis] - a[self.axis]).abs());
        let seen = format!(
            "the beam moves by {} um within {:.0} ms of a step of {} um, and by {} um without a step",
            um(size),
            self.after.last().map_or(0.0, |look| look.time.seconds_since(self.zero)) * 1e3,
            um(self.sent),
            um(unrest)
        );
        refused(match read {
            Some(read) if read < self.sent / 2.0 => {
                format!(
                    "the stage does not follow on the {name} axis: its readback moves by {} um and {seen}",
                    um(read)
                )
            }
            Some(_) => format!(
                "the {name} axis moves the beam too little or not at all: the readback of the stage follows, but {seen}"
            ),
            None => format!("the stage does not follow on the {name} axis: {seen}"),
        })
    }
}

fn middle(looks: &[Observation]) -> Option<BeamPoint> {
    observation::mean(looks.iter().map(|look| look.beam))
}

/// Rms difference between the means of blocks of samples and the mean of all samples, metres.
fn unrest(rest: &[Observation], block: usize) -> f64 {
    let Some(all) = middle(rest) else { return 0.0 };
    let far = |w: &[Observation]| middle(w).map(|m| (m[0] - all[0]).powi(2) + (m[1] - all[1]).powi(2));
    let squares: Vec<f64> = rest.chunks_exact(block).filter_map(far).collect();
    (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
}

/// Rounded up to one digit.
fn rounded_up(x: f64) -> f64 {
    let digit = 10_f64.powf(x.log10().floor());
    (x / digit).ceil() * digit
}
