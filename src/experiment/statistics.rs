//! Statistics of the readings: standard deviations at each point, errors against the reference, and
//! crosstalk.

use super::fit::{Slope, median, slope};
use super::protocol::{Printed, printed};
use super::reading::{Part, Reading};
use crate::config::Axis;
use crate::exit::{self, Failure};

/// Smallest number of points for a line with a standard uncertainty.
const POINTS: usize = 3;
/// Smallest number of readings for a standard deviation.
const READINGS: usize = 2;

/// The readings at one point.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// Reference of the axis, metres or radians.
    pub reference: f64,
    /// Number of readings.
    pub readings: usize,
    /// Mean of each axis, metres or radians.
    pub means: [f64; 6],
    /// Standard deviation of the moved axis about the mean of this point.
    pub std: f64,
    /// Smallest reading of the moved axis.
    pub min: f64,
    /// Largest reading of the moved axis.
    pub max: f64,
}

/// Results of one axis that was moved, metres or radians.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// The axis.
    pub axis: Axis,
    /// Results of each point.
    pub points: Vec<Point>,
    /// Mean over the points of measured value minus reference. It is not an error: the zero of an
    /// interferometer is arbitrary.
    pub offset: f64,
    /// Difference of the largest and the smallest reference.
    pub range: f64,
    /// The range divided by the number of steps.
    pub interval: f64,
    /// Median of the standard deviations of the points, as in the paper.
    pub std: f64,
    /// Square root of the mean variance of the points.
    pub pooled: f64,
    /// Relative standard uncertainty of `pooled`, from the limited number of readings.
    pub pooled_part: f64,
    /// Median of the standard uncertainties that were published with the poses.
    pub predicted: f64,
    /// Rms over the points of the error of the mean, relative to the interval.
    pub relative: f64,
    /// The value of `relative` that the predicted noise alone would give.
    pub relative_noise: f64,
    /// Slope of each axis against the reference of this one: ideally 1 for the axis itself, and 0 for the
    /// others (crosstalk).
    pub response: [Slope; 6],
}

impl Measured {
    /// The values in the paper for this axis.
    pub fn printed(&self) -> &'static Printed {
        printed(self.axis)
    }

    /// Error of the mean of a point against the reference.
    pub fn error(&self, point: &Point) -> f64 {
        point.means[self.axis as usize] - point.reference - self.offset
    }
}

/// Results of all axes that were moved in this part of the experiment.
///
/// # Errors
/// Fails if an axis has too few points or readings, or if its readings do not belong together.
pub fn measured(readings: &[Reading], part: Part) -> Result<Vec<Measured>, Failure> {
    let of =
        |axis| readings.iter().filter(move |r| r.part == part && r.moved.is_some_and(|(a, _)| a == axis));
    let moved = Axis::ALL.into_iter().filter(|axis| of(*axis).next().is_some());
    moved.map(|axis| measured_axis(axis, &of(axis).collect::<Vec<_>>())).collect()
}

fn measured_axis(axis: Axis, readings: &[&Reading]) -> Result<Measured, Failure> {
    if readings.iter().any(|r| r.look.config != readings[0].look.config) {
        let what = "its readings were made with different geometries, calibrations or frames";
        return Err(Failure::new(
            exit::DATA,
            format!("{}: {what}; was the sensor tared in between?", axis.name()),
        ));
    }
    let numbers: std::collections::BTreeSet<u32> = readings.iter().map(|r| r.point).collect();
    let of = |number| readings.iter().filter(move |r| r.point == number).copied().collect::<Vec<_>>();
    if let Some((due, _)) = (1..).zip(&numbers).find(|(due, number)| due != *number) {
        let message = format!("{} point {due} is missing, but a later point exists", axis.name());
        return Err(Failure::new(exit::DATA, message));
    }
    let points = numbers.into_iter().map(|number| point(axis, number, &of(number)));
    let points = points.collect::<Result<Vec<_>, _>>()?;
    if points.len() < POINTS {
        let message =
            format!("{} has readings at {} points: at least {POINTS} are needed", axis.name(), points.len());
        return Err(Failure::new(exit::DATA, message));
    }
    let n = points.len() as f64;
    let references: Vec<f64> = points.iter().map(|p| p.reference).collect();
    let smallest = references.iter().copied().fold(f64::INFINITY, f64::min);
    let range = references.iter().copied().fold(f64::NEG_INFINITY, f64::max) - smallest;
    if range <= 0.0 {
        let message =
            format!("{}: the reference is the same at all points: the axis must be moved", axis.name());
        return Err(Failure::new(exit::DATA, message));
    }
    let interval = range / (n - 1.0);
    let i = axis as usize;
    let offset = points.iter().map(|p| p.means[i] - p.reference).sum::<f64>() / n;
    let square = points.iter().map(|p| (p.means[i] - p.reference - offset).powi(2)).sum::<f64>() / n;
    let freedom: f64 = points.iter().map(|p| (p.readings - 1) as f64).sum();
    let variance = points.iter().map(|p| (p.readings - 1) as f64 * p.std * p.std).sum::<f64>() / freedom;
    let predicted = median(readings.iter().map(|r| r.look.sigmas[i].into()));
    let each = points.iter().map(|p| 1.0 / p.readings as f64).sum::<f64>() / n;
    Ok(Measured {
        axis,
        offset,
        range,
        interval,
        std: median(points.iter().map(|p| p.std)),
        pooled: variance.sqrt(),
        pooled_part: 1.0 / (2.0 * freedom).sqrt(),
        predicted,
        relative: square.sqrt() / interval,
        // The offset uses one degree of freedom of the points.
        relative_noise: predicted * (each * (n - 1.0) / n).sqrt() / interval,
        response: std::array::from_fn(|k| {
            let means: Vec<f64> = points.iter().map(|p| p.means[k]).collect();
            slope(&references, &means)
        }),
        points,
    })
}

fn point(axis: Axis, number: u32, readings: &[&Reading]) -> Result<Point, Failure> {
    let wrong = |what: String| Failure::new(exit::DATA, format!("{} point {number}: {what}", axis.name()));
    if readings.len() < READINGS {
        return Err(wrong(format!("{} readings, at least {READINGS} are needed", readings.len())));
    }
    let (n, i) = (readings.len() as f64, axis as usize);
    let reference = readings[0].moved.map_or(f64::NAN, |(_, reference)| reference);
    if readings.iter().any(|r| r.moved.is_none_or(|(_, other)| other != reference)) {
        return Err(wrong("its readings have different references".into()));
    }
    let means = std::array::from_fn(|k| readings.iter().map(|r| r.look.pose[k]).sum::<f64>() / n);
    let values = readings.iter().map(|r| r.look.pose[i]);
    Ok(Point {
        reference,
        readings: readings.len(),
        means,
        std: (values.clone().map(|x| (x - means[i]).powi(2)).sum::<f64>() / (n - 1.0)).sqrt(),
        min: values.clone().fold(f64::INFINITY, f64::min),
        max: values.fold(f64::NEG_INFINITY, f64::max),
    })
}

#[cfg(test)]
mod tests {
    use trifacet_wire::Status;

    use super::*;
    use crate::experiment::observation::Observation;

    /// Readings about a line of slope 1.1 with an offset. The slope of yaw is a tenth of that of tx.
    fn line(points: u32, readings: u32) -> Vec<Reading> {
        let one = |point: u32, number: u32| {
            let x = f64::from(point) * 2e-6;
            let swing = if number.is_multiple_of(2) { 1e-7 } else { -1e-7 };
            let pose = [1.1 * x + 5e-6 + swing, 0.0, 0.0, 0.0, 0.0, -0.1 * x];
            let look = Observation {
                time_ns: 0,
                pose,
                sigmas: [1e-7; 6],
                averaged: 1,
                config: 0,
                status: Status::POSE_VALID,
            };
            Reading { part: Part::Table2, moved: Some((Axis::Tx, x)), point, number, look }
        };
        (1..=points).flat_map(|p| (1..=readings).map(move |n| one(p, n))).collect()
    }

    #[test]
    fn a_straight_line_gives_its_coefficients() {
        let all = measured(&line(5, 50), Part::Table2).unwrap();
        let [m] = &all[..] else { panic!("{all:?}") };
        let near = |a: f64, b: f64| assert!((a / b - 1.0).abs() < 1e-9, "{a} {b}");
        near(m.range, 8e-6);
        near(m.interval, 2e-6);
        near(m.offset, 5e-6 + 0.1 * 6e-6);
        near(m.std, 1e-7 * (50.0_f64 / 49.0).sqrt());
        near(m.pooled, m.std);
        near(m.pooled_part, 1.0 / (2.0_f64 * 5.0 * 49.0).sqrt());
        near(m.response[0].value, 1.1);
        near(m.response[5].value, -0.1);
        assert!(m.response[0].sigma < 1e-9 && m.response[1].value == 0.0);
        near(m.relative, 0.2e-6 * 2.0_f64.sqrt() / 2e-6);
        near(m.relative_noise, f64::from(1e-7_f32) * (4.0_f64 / 250.0).sqrt() / 2e-6);
        near(m.points[4].max - m.points[4].min, 2e-7);
        assert!((m.error(&m.points[0]) + 0.4e-6).abs() < 1e-15);
    }

    #[test]
    fn too_few_readings_are_refused_with_their_place() {
        for (readings, expected) in [
            (line(2, 5), "tx has readings at 2 points: at least 3"),
            (line(5, 1), "tx point 1: 1 readings, at least 2"),
            (
                [
                    line(4, 5),
                    line(4, 1).iter().map(|r| Reading { moved: Some((Axis::Tx, 0.0)), ..*r }).collect(),
                ]
                .concat(),
                "different references",
            ),
            (
                line(4, 5).iter().map(|r| Reading { moved: Some((Axis::Tx, 1.0)), ..*r }).collect(),
                "must be moved",
            ),
        ] {
            let error = measured(&readings, Part::Table2).unwrap_err().message;
            assert!(error.contains(expected), "{error}");
        }
        assert!(measured(&line(5, 5), Part::Beyond).unwrap().is_empty());
    }
}
