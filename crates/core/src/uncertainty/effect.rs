//! The input quantities of a pose, by what they act on.

/// When a reading was taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moment {
    /// At the pose that is measured.
    Pose,
    /// At the tare.
    Tare,
}

/// What a quantity acts on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect {
    /// Adds to a spot coordinate: u, v of A, B, C.
    Spot(Moment, usize),
    /// Scales a power.
    Power(Moment, usize),
    /// Adds to the beam offset that the powers show: offset times relative error of the diameter, x or y.
    Offset(Moment, usize),
    /// Turns the beam about x or y, at the pose.
    Direction(usize),
    /// Scales all spot coordinates at the pose.
    Gain,
    /// Scales the distance of the PSDs at the pose.
    Distance,
    /// Moves the mirror against the PSDs along the world's z-axis, at the pose.
    Height,
    /// Scales the spot coordinates of a PSD, at the pose and at the tare.
    SumOffset(usize),
    /// Adds to a coordinate of the pose in the sensor's world frame.
    Pose(usize),
    /// Adds to a coordinate of the pose, relative to the tare, of the table with which the head was calibrated.
    Relative(usize),
    /// Adds to a coordinate of the tool's translation.
    Tool(usize),
    /// Scales a translation.
    Scale(usize),
    /// Scales an angle.
    AngleScale(usize),
    /// Angle between two axes: xy, xz, yz.
    Squareness(usize),
}
