//! Evaluates the record at rest.

use trifacet_core::time::NS_PER_S;

use super::allan::{Allan, allan, drift};
use super::fit::{Slope, median};
use super::observation::Observation;
use super::reading::{Part, Reading};
use crate::exit::{self, Failure};

/// Smallest number of readings for which an Allan deviation is computed.
pub const LEAST: usize = 64;
/// Readings farther apart than this number of periods have a gap between them. A single lost sample is
/// tolerated.
const HOLE: f64 = 2.5;
/// Largest relative difference between the length of the record and that of the same number of periods.
const UNEVEN: f64 = 0.01;
/// Number of sections in the plot.
const STRETCHES: usize = 60;

/// A record with the mirror at rest.
#[derive(Clone, Debug, PartialEq)]
pub struct StaticRecord {
    /// Number of readings.
    pub readings: usize,
    /// Time between adjacent readings, seconds: the median.
    pub period_s: f64,
    /// Time from the first to the last reading, seconds.
    pub span_s: f64,
    /// Why there is no Allan deviation: the readings are not equally spaced. `None` if there is one.
    pub uneven: Option<String>,
    /// Results of each axis, in the order of a pose.
    pub axes: [Still; 6],
    /// Centres of the sections of the plot, seconds after the first reading.
    pub times_s: Vec<f64>,
}

/// Results of one axis at rest, metres or radians.
#[derive(Clone, Debug, PartialEq)]
pub struct Still {
    /// The Allan deviation for increasing averaging times; empty if the record is not equally spaced.
    pub allan: Vec<Allan>,
    /// Standard uncertainty of a reading, as published with the poses: the median.
    pub stated: f64,
    /// Drift per second.
    pub drift: Slope,
    /// Means over the sections of the plot, relative to the mean of all readings.
    pub course: Vec<f64>,
}

impl StaticRecord {
    /// Evaluates the readings at rest. `None` without readings.
    ///
    /// # Errors
    /// Fails if the record is too short, or if the configuration of the sensor changed within it (for
    /// example by a tare).
    pub fn of(readings: &[Reading]) -> Result<Option<Self>, Failure> {
        let rest: Vec<&Reading> = readings.iter().filter(|r| r.part == Part::StaticRecord).collect();
        let [first, .., last] = rest[..] else { return Ok(None) };
        if rest.len() < LEAST {
            let message =
                format!("the record at rest has {} readings: at least {LEAST} are needed", rest.len());
            return Err(Failure::new(exit::DATA, message));
        }
        if let Some(other) = rest.iter().find(|r| r.look.config != first.look.config) {
            let at_s = seconds(&first.look, &other.look);
            let message = format!("the record at rest: {CHANGED}, {at_s:.3} s after its start");
            return Err(Failure::new(exit::DATA, message));
        }
        let times: Vec<f64> = rest.iter().map(|r| seconds(&first.look, &r.look)).collect();
        // Times are whole nanoseconds; further digits are rounding errors.
        let period_s = (median(times.windows(2).map(|t| t[1] - t[0])) * 1e9).round() / 1e9;
        let uneven = uneven(&times, period_s);
        Ok(Some(Self {
            readings: rest.len(),
            period_s,
            span_s: seconds(&first.look, &last.look),
            axes: std::array::from_fn(|i| still(i, &times, &rest, uneven.is_none())),
            times_s: stretches(&times),
            uneven,
        }))
    }
}

const CHANGED: &str = "geometry, calibration or frames of the sensor have changed (a tare?)";

fn seconds(from: &Observation, to: &Observation) -> f64 {
    (to.time_ns - from.time_ns) as f64 / NS_PER_S as f64
}

/// Why two consecutive observations cannot belong to one record at rest with this period (seconds). `None`:
/// they can.
pub fn parted(last: &Observation, next: &Observation, period_s: f64) -> Option<String> {
    if last.config != next.config {
        return Some(CHANGED.into());
    }
    hole(seconds(last, next), period_s)
}

fn hole(step_s: f64, period_s: f64) -> Option<String> {
    let wrong = !(step_s > 0.0 && step_s <= HOLE * period_s);
    wrong.then(|| format!("{step_s:.4} s from one reading to the next instead of {period_s:.4} s"))
}

fn uneven(times: &[f64], period_s: f64) -> Option<String> {
    let holed =
        times.windows(2).find_map(|t| Some(format!("{}, at {:.3} s", hole(t[1] - t[0], period_s)?, t[0])));
    let (span, even) = (times[times.len() - 1], period_s * (times.len() - 1) as f64);
    let stretched = (span - even).abs() > UNEVEN * even;
    holed.or_else(|| {
        stretched
            .then(|| format!("{span:.3} s in total instead of {even:.3} s with periods of {period_s:.4} s"))
    })
}

fn still(axis: usize, times: &[f64], rest: &[&Reading], even: bool) -> Still {
    let values: Vec<f64> = rest.iter().map(|r| r.look.pose[axis]).collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let values: Vec<f64> = values.iter().map(|x| x - mean).collect();
    Still {
        allan: if even { allan(&values) } else { Vec::new() },
        stated: median(rest.iter().map(|r| r.look.sigmas[axis].into())),
        drift: drift(times, &values),
        course: stretches(&values),
    }
}

/// Means over sections of equal length, at most as many as the plot has.
fn stretches(values: &[f64]) -> Vec<f64> {
    let long = values.len().div_ceil(STRETCHES);
    values.chunks(long).map(|chunk| chunk.iter().sum::<f64>() / chunk.len() as f64).collect()
}

#[cfg(test)]
mod tests {
    use trifacet_wire::Status;

    use super::*;

    /// Readings at rest at these times (ms).
    fn at(times: &[i64]) -> Vec<Reading> {
        let look = |ms: i64| Observation {
            time_ns: ms * 1_000_000,
            pose: [1e-6 * (ms % 7) as f64; 6],
            sigmas: [1e-6; 6],
            averaged: 1,
            config: 3,
            status: Status::POSE_VALID,
        };
        let one = |ms: &i64| Reading {
            part: Part::StaticRecord,
            moved: None,
            point: 0,
            number: 1,
            look: look(*ms),
        };
        times.iter().map(one).collect()
    }

    fn rest(times: &[i64]) -> StaticRecord {
        StaticRecord::of(&at(times)).unwrap().unwrap()
    }

    #[test]
    fn an_uneven_record_has_no_allan_deviation() {
        let even: Vec<i64> = (0..1000).map(|k| 10 * k).collect();
        assert_eq!((rest(&even).period_s, rest(&even).uneven), (0.01, None));
        let dropped: Vec<i64> = even.iter().copied().filter(|ms| *ms != 500).collect();
        assert!(!rest(&dropped).axes[0].allan.is_empty());
        let blocked: Vec<i64> = even.iter().map(|ms| if *ms > 500 { ms + 3000 } else { *ms }).collect();
        let many: Vec<i64> = even.iter().copied().filter(|ms| ms % 500 != 0).collect();
        let back: Vec<i64> = even.iter().rev().copied().collect();
        for (times, expected) in [
            (blocked, "3.0100 s from one reading to the next instead of 0.0100 s, at 0.500 s"),
            (many, "s in total instead of"),
            (back, "-0.0100 s from one"),
        ] {
            let rest = rest(&times);
            assert!(rest.uneven.unwrap().contains(expected) && rest.axes[0].allan.is_empty());
            assert!(rest.axes[0].drift.value.is_finite());
        }
    }

    #[test]
    fn a_tare_within_it_is_refused() {
        let mut readings = at(&(0..100).collect::<Vec<_>>());
        readings[40].look.config = 4;
        let error = StaticRecord::of(&readings).unwrap_err().message;
        assert!(error.contains("have changed (a tare?), 0.040 s after its start"), "{error}");
        assert!(parted(&readings[39].look, &readings[40].look, 0.001).is_some());
    }
}
