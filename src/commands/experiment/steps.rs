//! The points of a protocol, one after the other.

use trifacet::config::Axis;
use trifacet::exit::{self, Failure};
use trifacet::experiment::protocol::{Course, Protocol};
use trifacet::experiment::reading::Reading;

use super::READINGS;

/// One point of the protocol.
#[derive(Clone, Copy)]
pub(super) struct Step {
    pub(super) axis: Axis,
    /// Counts the points of an axis from 1.
    pub(super) point: u32,
    /// Points of the axis.
    pub(super) of: usize,
    /// Where the mirror is to go, metres or radians; with a file of references where it is.
    pub(super) target: f64,
}

impl Step {
    /// It is this one.
    fn is(&self, axis: Axis, point: u32) -> bool {
        self.axis == axis && self.point == point
    }

    /// A reading was taken there.
    pub(super) fn took(&self, reading: &Reading) -> bool {
        reading.moved.is_some_and(|(axis, _)| self.is(axis, reading.point))
    }
}

/// Every point of a protocol, in order.
pub(super) fn steps(protocol: &Protocol) -> Vec<Step> {
    let of_course = |c: &Course| {
        let (axis, of) = (c.axis, c.points.len());
        (1..)
            .zip(c.points.clone())
            .map(move |(point, target)| Step { axis, point, of, target })
            .collect::<Vec<_>>()
    };
    protocol.courses.iter().flat_map(of_course).collect()
}

/// What is there was measured with this protocol.
pub(super) fn fits(readings: &[Reading], steps: &[Step]) -> Result<(), Failure> {
    let moved = readings.iter().filter_map(|r| Some((r.moved?.0, r.point)));
    let mut strange = moved.filter(|(axis, point)| !steps.iter().any(|s| s.is(*axis, *point)));
    strange.next().map_or(Ok(()), |(axis, point)| {
        let what = format!("{READINGS} has point {point} of {}, which is none of this protocol", axis.name());
        Err(Failure::new(exit::USAGE, format!("{what}: go on with the same options as before")))
    })
}
