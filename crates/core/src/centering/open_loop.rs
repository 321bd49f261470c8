//! Moves of the stage while the error is unknown: straight to a position, or along a spiral.

use super::search::Spiral;
use crate::centering::LoopParams;
use crate::steering::StagePosition;

/// A move that does not depend on the observed beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OpenLoopMove {
    /// No move.
    Still,
    /// Straight to a position.
    Jump {
        /// Destination, metres.
        to: StagePosition,
        /// Remaining wait at the destination, seconds: the samples must show the new position before the next
        /// decision.
        left_s: f64,
    },
    /// Along a spiral over the range of the stage.
    Search {
        /// The spiral, at its current angle.
        spiral: Spiral,
        /// The last point of the spiral, metres.
        at: StagePosition,
        /// The whole range has been covered.
        over: bool,
    },
}

impl OpenLoopMove {
    /// A move to a position, followed by a wait of `wait_s` seconds.
    pub fn jump(to: StagePosition, wait_s: f64) -> Self {
        OpenLoopMove::Jump { to, left_s: wait_s }
    }

    /// A search of the whole range, starting at `centre`, for a beam with this 1/e^2 radius, metres.
    pub fn search(centre: StagePosition, radius: f64, params: &LoopParams) -> Self {
        let centre = params.controller.within(centre);
        let spiral = Spiral::of(params, centre, radius);
        OpenLoopMove::Search { spiral, at: centre, over: false }
    }

    /// The same move with other parameters. A spiral starts again at its last point, within the new limits.
    #[must_use]
    pub fn anew(self, params: &LoopParams, radius: f64) -> Self {
        match self {
            OpenLoopMove::Still => OpenLoopMove::Still,
            OpenLoopMove::Jump { to, left_s } => {
                OpenLoopMove::Jump { to: params.controller.within(to), left_s }
            }
            OpenLoopMove::Search { at, .. } => OpenLoopMove::search(at, radius, params),
        }
    }

    /// Whether the move has ended.
    pub fn arrived(&self) -> bool {
        match *self {
            OpenLoopMove::Still => true,
            OpenLoopMove::Jump { left_s, .. } => left_s <= 0.0,
            OpenLoopMove::Search { over, .. } => over,
        }
    }

    /// The next target, given that the stage was last commanded to `from`, `dt` seconds ago. The move waits
    /// for the command to reach the target, because the slew limit may be lower than the speed of the move.
    pub fn next(&mut self, from: StagePosition, dt: f64) -> Option<StagePosition> {
        match self {
            OpenLoopMove::Still => None,
            OpenLoopMove::Jump { to, left_s } => {
                if from == *to {
                    *left_s -= dt;
                }
                Some(*to)
            }
            OpenLoopMove::Search { spiral, at, over } => {
                if from == *at {
                    match spiral.next(dt) {
                        Some(next) => *at = next,
                        None => *over = true,
                    }
                }
                Some(*at)
            }
        }
    }
}
