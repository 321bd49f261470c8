//! The points of the measurement: those of Table 2 in the paper, or those that the user chooses.

use crate::config::Axis;

/// A row of the paper's Table 2, in micrometres or microradians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Printed {
    /// The axis that is moved.
    pub axis: Axis,
    /// Distance from the first to the last point.
    pub range: f64,
    /// Distance between adjacent points.
    pub interval: f64,
    /// The median over the points of the standard deviations of fifty readings.
    pub std: f64,
    /// The relative uncertainty, percent, which the paper does not define.
    pub relative: f64,
    /// Number of the figure in the paper.
    pub figure: u8,
}

/// Number of readings at each point in the paper.
pub const READINGS: u32 = 50;
/// Number of points of each axis in the paper: every range is twenty intervals.
pub const POINTS: u32 = 21;

/// Table 2 of the paper.
pub const TABLE_2: [Printed; 6] = [
    Printed { axis: Axis::Tx, range: 28.8, interval: 1.44, std: 0.98, relative: 11.0, figure: 5 },
    Printed { axis: Axis::Ty, range: 28.3, interval: 1.42, std: 0.95, relative: 16.0, figure: 6 },
    Printed { axis: Axis::Tz, range: 18.6, interval: 0.93, std: 0.63, relative: 12.0, figure: 7 },
    Printed { axis: Axis::Roll, range: 309.0, interval: 15.5, std: 1.83, relative: 2.5, figure: 8 },
    Printed { axis: Axis::Pitch, range: 310.0, interval: 15.5, std: 1.80, relative: 6.1, figure: 9 },
    Printed { axis: Axis::Yaw, range: 326.0, interval: 16.3, std: 2.43, relative: 4.3, figure: 10 },
];

/// The values in the paper for an axis.
pub fn printed(axis: Axis) -> &'static Printed {
    &TABLE_2[axis as usize]
}

/// The points of one axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Course {
    /// The axis that is moved; all others stay at zero.
    pub axis: Axis,
    /// Positions relative to the middle, metres or radians.
    pub points: Vec<f64>,
}

impl Course {
    /// `points` points at equal intervals (metres or radians); the middle one is at zero.
    pub fn even(axis: Axis, interval: f64, points: u32) -> Self {
        let middle = f64::from(points - 1) / 2.0;
        // Rounded to picometres or picoradians; further digits are rounding errors.
        let pico = |x: f64| (x * 1e12).round() / 1e12;
        let points = (0..points).map(|k| pico(interval * (f64::from(k) - middle))).collect();
        Self { axis, points }
    }

    /// The points in the paper.
    pub fn paper(axis: Axis) -> Self {
        Self::even(axis, printed(axis).interval * 1e-6, POINTS)
    }
}

/// The points of all axes, and the number of readings.
#[derive(Clone, Debug, PartialEq)]
pub struct Protocol {
    /// The points of each axis, in order of measurement.
    pub courses: Vec<Course>,
    /// Number of readings at each point.
    pub readings: u32,
}

impl Protocol {
    /// Total number of readings.
    pub fn total(&self) -> u64 {
        self.courses.iter().map(|course| course.points.len() as u64 * u64::from(self.readings)).sum()
    }
}

impl std::fmt::Display for Protocol {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{} readings at each point", self.readings)?;
        for Course { axis, points } in &self.courses {
            let [first, last] = [points.first(), points.last()].map(|x| x.unwrap_or(&0.0) * 1e6);
            let (name, n, unit) = (axis.name(), points.len(), axis.micro_unit());
            write!(f, ", {name} {n} points from {first:.6} to {last:.6} {unit}")?;
        }
        Ok(())
    }
}

impl Default for Protocol {
    /// The protocol of the paper.
    fn default() -> Self {
        Self { courses: Axis::ALL.map(Course::paper).to_vec(), readings: READINGS }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_ranges_are_its_intervals_and_lie_about_the_middle() {
        for course in Protocol::default().courses {
            let (first, last) = (course.points[0], course.points[20]);
            let printed = printed(course.axis);
            assert_eq!(printed.axis, course.axis);
            assert_eq!(course.points.len(), 21);
            assert!((last + first).abs() < 1e-18);
            // The paper rounds both values.
            assert!(((last - first) * 1e6 / printed.range - 1.0).abs() < 0.005, "{course:?}");
        }
        assert_eq!(Protocol::default().total(), 6300);
    }
}
