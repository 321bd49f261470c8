//! What the record at rest says.

use super::allan::{Allan, allan, drift};
use super::fit::{Slope, median};
use super::reading::{Part, Reading};
use crate::clock::NS_PER_S;
use crate::exit::{self, Failure};

/// Fewer readings say nothing of how noise and time go together.
pub const LEAST: usize = 64;
/// Stretches of the drawing.
const STRETCHES: usize = 60;

/// A record of the mirror at rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Rest {
    /// Readings.
    pub readings: usize,
    /// From one to the next, seconds.
    pub period_s: f64,
    /// Each axis, in the order of a pose.
    pub axes: [Still; 6],
    /// The middles of the stretches of the drawing, seconds from the first reading.
    pub times_s: Vec<f64>,
}

/// One axis at rest. Metres or radians.
#[derive(Clone, Debug, PartialEq)]
pub struct Still {
    /// The deviation over means of growing length.
    pub allan: Vec<Allan>,
    /// The deviation of a reading, as stated with the poses.
    pub stated: f64,
    /// Per second.
    pub drift: Slope,
    /// Means over the stretches of the drawing, less the mean of all.
    pub course: Vec<f64>,
}

impl Rest {
    /// The part at rest of all readings, if there is one.
    ///
    /// # Errors
    /// It is too short.
    pub fn of(readings: &[Reading]) -> Result<Option<Self>, Failure> {
        let rest: Vec<&Reading> = readings.iter().filter(|r| r.part == Part::Rest).collect();
        let [first, .., last] = rest[..] else { return Ok(None) };
        if rest.len() < LEAST {
            let message =
                format!("the record at rest has {} readings: at least {LEAST} are needed", rest.len());
            return Err(Failure::new(exit::DATA, message));
        }
        let span_s = (last.look.time_ns - first.look.time_ns) as f64 / NS_PER_S as f64;
        let seconds = |r: &&Reading| (r.look.time_ns - first.look.time_ns) as f64 / NS_PER_S as f64;
        let times: Vec<f64> = rest.iter().map(seconds).collect();
        Ok(Some(Self {
            readings: rest.len(),
            period_s: span_s / (rest.len() - 1) as f64,
            axes: std::array::from_fn(|i| still(i, &times, &rest)),
            times_s: stretches(&times),
        }))
    }
}

fn still(axis: usize, times: &[f64], rest: &[&Reading]) -> Still {
    let values: Vec<f64> = rest.iter().map(|r| r.look.pose[axis]).collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let values: Vec<f64> = values.iter().map(|x| x - mean).collect();
    Still {
        allan: allan(&values),
        stated: median(rest.iter().map(|r| r.look.deviations[axis].into())),
        drift: drift(times, &values),
        course: stretches(&values),
    }
}

/// Means over stretches of equal length, as many as can be drawn.
fn stretches(values: &[f64]) -> Vec<f64> {
    let long = values.len().div_ceil(STRETCHES);
    values.chunks(long).map(|chunk| chunk.iter().sum::<f64>() / chunk.len() as f64).collect()
}
