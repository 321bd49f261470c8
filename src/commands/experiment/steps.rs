//! The points of a protocol, one after the other.

use trifacet::config::Axis;
use trifacet::experiment::protocol::{Course, Protocol};
use trifacet::experiment::reading::Reading;

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
    /// A reading was taken there.
    pub(super) fn took(&self, reading: &Reading) -> bool {
        reading.moved.is_some_and(|(axis, _)| (axis, reading.point) == (self.axis, self.point))
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
