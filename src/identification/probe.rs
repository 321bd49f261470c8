//! One small step of an axis, and a long look at what follows: is the movement over within a dwell?
//!
//! The steps go to and fro. If the beam answered later than a dwell, each answer would be taken for that of
//! the next step, which goes the other way: a gain with the wrong sign and a delay that is too short. So
//! nothing is measured before this is ruled out.

use trifacet_core::steering::Xy;
use trifacet_core::time::Mono;

use super::findings::AXES;
use super::observation::{self, Observation};
use super::plan::{Plan, refused, um};
use crate::exit::Failure;

/// The part of the movement that may be missing at the end of a dwell.
const MISSING: f64 = 0.1;
/// A movement is so many deviations of what the beam does by itself, and so is what disturbs one.
const SEEN: f64 = 6.0;
const DISTURBS: f64 = 4.0;
/// A dwell is so many times the start of the movement, and so many times its end.
const STARTS: f64 = 3.0;
const ENDS: f64 = 2.0;

/// What was seen of a single step.
#[derive(Debug)]
pub(super) struct Probe<'a> {
    /// 0 or 1.
    pub(super) axis: usize,
    /// How far the axis was sent, metres.
    pub(super) sent: f64,
    /// The sample on which it was sent.
    pub(super) zero: Mono,
    /// While nothing moves.
    pub(super) rest: &'a [Observation],
    /// The last samples before the step.
    pub(super) before: &'a [Observation],
    /// All samples after it.
    pub(super) after: &'a [Observation],
}

impl Probe<'_> {
    /// Whether the movement is there within a dwell of `period` times its samples, and nothing moves later.
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
        // The course in parts of the movement, each the mean over a block.
        let part = |at: Xy| ((at[0] - start[0]) * moved[0] + (at[1] - start[1]) * moved[1]) / (size * size);
        let course: Vec<f64> = self.after.windows(block).filter_map(|w| Some(part(middle(w)?))).collect();
        let allowed = MISSING.max(DISTURBS * unrest / size);
        // So many samples of a block make it differ that much at a jump.
        let few = (allowed * block as f64).ceil() as usize;
        let first = course.iter().position(|p| p.abs() > allowed).map_or(0, |i| i + block - few);
        let last = course.iter().rposition(|p| (p - 1.0).abs() > allowed).map_or(0, |i| i + few);
        let time = |i: usize| self.after[i.min(self.after.len() - 1)].time.seconds_since(self.zero);
        let (begins, over) = (time(first), time(last.max(first)));
        let dwell = plan.dwell as f64 * period;
        // The fit looks for the start within half of a dwell.
        if begins <= dwell / 2.0 && over <= dwell {
            return Ok(());
        }
        Err(refused(format!(
            "the movement of the {} axis begins {:.0} ms after the command and is over after {:.0} ms, \
             too late for a dwell of {:.0} ms: say --dwell {:.0}",
            AXES[self.axis],
            begins * 1e3,
            over * 1e3,
            dwell * 1e3,
            rounded_up((STARTS * begins).max(ENDS * over) * 1e3)
        )))
    }

    /// The beam has hardly moved.
    fn still(&self, size: f64, unrest: f64) -> Failure {
        let name = AXES[self.axis];
        let read = |looks: &[Observation]| observation::mean(looks.iter().filter_map(|look| look.readback));
        let half = &self.after[self.after.len() / 2..];
        let read = read(self.before).zip(read(half)).map(|(a, b)| (b[self.axis] - a[self.axis]).abs());
        let seen = format!(
            "the beam moves by {} um within {:.0} ms of a step of {} um, and by {} um by itself",
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
                "the {name} axis does not move the beam, or too little: the stage follows by its readback, but {seen}"
            ),
            None => format!("the stage does not follow on the {name} axis: {seen}"),
        })
    }
}

fn middle(looks: &[Observation]) -> Option<Xy> {
    observation::mean(looks.iter().map(|look| look.beam))
}

/// What the mean of a block of samples differs by from that of all, rms, metres.
fn unrest(rest: &[Observation], block: usize) -> f64 {
    let Some(all) = middle(rest) else { return 0.0 };
    let far = |w: &[Observation]| middle(w).map(|m| (m[0] - all[0]).powi(2) + (m[1] - all[1]).powi(2));
    let squares: Vec<f64> = rest.chunks_exact(block).filter_map(far).collect();
    (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
}

/// To one digit.
fn rounded_up(x: f64) -> f64 {
    let digit = 10_f64.powf(x.log10().floor());
    (x / digit).ceil() * digit
}
