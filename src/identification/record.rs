//! What a measurement has recorded: steps and observations.

use trifacet_core::steering::StagePosition;

use super::observation::Observation;
use super::plan::Plan;

/// The names of the axes.
pub const AXES: [&str; 2] = ["x", "y"];

/// A step of one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Axis: 0 or 1.
    pub axis: usize,
    /// Positive direction.
    pub forth: bool,
    /// Target position, metres.
    pub to: StagePosition,
    /// Index of the observation on which the step was commanded.
    pub on: usize,
    /// Time from the sample to its command, seconds.
    pub computed: f64,
}

/// All observations and steps.
#[derive(Clone, Debug)]
pub struct Recording {
    /// The plan.
    pub plan: Plan,
    /// One observation per sample, in order.
    pub looks: Vec<Observation>,
    /// Number of observations before the first movement.
    pub rest: usize,
    /// The steps, in order.
    pub steps: Vec<Step>,
    /// Number of steps that were repeated because samples stopped.
    pub repeats: u32,
}
