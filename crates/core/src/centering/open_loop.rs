//! Where the stage is led while the error is not known: straight to a place, or along a spiral.

use super::search::Spiral;
use crate::centering::LoopParams;
use crate::steering::Xy;

/// A movement that does not depend on what is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OpenLoopMove {
    /// None.
    Still,
    /// Straight to a place.
    Jump {
        /// Metres.
        to: Xy,
        /// For so long it is waited there, seconds: the samples are to show that place.
        left_s: f64,
    },
    /// Along a spiral; `at` is its last point, none at the start and at the end.
    Search {
        /// The rest of the way.
        spiral: Spiral,
        /// Metres.
        at: Xy,
        /// All of the range was passed.
        over: bool,
    },
}

impl OpenLoopMove {
    /// To a place, and waits there.
    pub fn jump(to: Xy, wait_s: f64) -> Self {
        OpenLoopMove::Jump { to, left_s: wait_s }
    }

    /// From a place over all of the range, for a beam of this radius, metres.
    pub fn search(centre: Xy, radius: f64, params: &LoopParams) -> Self {
        let centre = params.controller.within(centre);
        let spiral = Spiral::of(params, centre, radius);
        OpenLoopMove::Search { spiral, at: centre, over: false }
    }

    /// The same movement under another params: a spiral starts over, where it is, within the new limits.
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

    /// Whether it has come to its end.
    pub fn arrived(&self) -> bool {
        match *self {
            OpenLoopMove::Still => true,
            OpenLoopMove::Jump { left_s, .. } => left_s <= 0.0,
            OpenLoopMove::Search { over, .. } => over,
        }
    }

    /// Where to go next, with the stage sent to `from` last, `dt` seconds ago. It does not go on before the
    /// stage is there: the slew limit may be slower than the way.
    pub fn next(&mut self, from: Xy, dt: f64) -> Option<Xy> {
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
