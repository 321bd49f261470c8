//! The points of a protocol, in order.

use trifacet::config::Axis;
use trifacet::experiment::protocol::{Course, Protocol};
use trifacet::experiment::reading::Reading;

/// One point of the protocol.
#[derive(Clone, Copy)]
pub(super) struct Step {
    pub(super) axis: Axis,
    /// Number of the point on its axis, from 1.
    pub(super) point: u32,
    /// Number of points of the axis.
    pub(super) of: usize,
    /// Target position of the mirror, metres or radians. With a file of references, the actual position.
    pub(super) target: f64,
}

impl Step {
    /// Whether a reading was taken at this point.
    pub(super) fn took(&self, reading: &Reading) -> bool {
        reading.moved.is_some_and(|(axis, _)| (axis, reading.point) == (self.axis, self.point))
    }
}

/// All points of a protocol, in order.
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
