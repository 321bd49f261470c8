//! The steering stage: its positions and commands, and the map between stage and beam.

use std::ops::Deref;

use nalgebra::{Matrix2, Vector2};
use trifacet_wire::actuator::LeaseAction;

/// Two axes with a meaning of their own, so that a position of the stage is never taken for one of the beam.
macro_rules! axes {
    ($(#[doc = $doc:literal])* $name:ident) => {
        $(#[doc = $doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        pub struct $name(pub [f64; 2]);

        /// Read access to the two axes.
        impl Deref for $name {
            type Target = [f64; 2];

            fn deref(&self) -> &[f64; 2] {
                &self.0
            }
        }

        impl IntoIterator for $name {
            type Item = f64;
            type IntoIter = std::array::IntoIter<f64, 2>;

            fn into_iter(self) -> Self::IntoIter {
                self.0.into_iter()
            }
        }

        impl From<[f64; 2]> for $name {
            fn from(axes: [f64; 2]) -> Self {
                Self(axes)
            }
        }

        impl From<$name> for [f64; 2] {
            fn from(axes: $name) -> Self {
                axes.0
            }
        }

        impl From<Vector2<f64>> for $name {
            fn from(vector: Vector2<f64>) -> Self {
                Self(vector.into())
            }
        }

        impl From<$name> for Vector2<f64> {
            fn from(axes: $name) -> Self {
                Self::from(axes.0)
            }
        }
    };
}

axes!(
    /// A position of the stage, metres on each axis of the stage.
    StagePosition
);
axes!(
    /// A difference of two stage positions, metres; or a velocity of the stage, metres per second.
    StageMove
);
axes!(
    /// A point across the beam, in which the beam or the apex stands; x and y, metres.
    BeamPoint
);
axes!(
    /// A difference of two beam points, as beam minus apex, metres; or a velocity, metres per second.
    BeamOffset
);

/// A target position for the stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// Counts the commands of a daemon; the acknowledgement repeats it.
    pub id: u32,
    /// Position of both axes, metres. Always finite and within the limits of the configuration.
    pub position: StagePosition,
    /// Validity of the command, milliseconds, for stages that support leases.
    pub lease_ms: u16,
    /// The action when the lease expires.
    pub on_expiry: LeaseAction,
}

/// The codes, of `bits` bits, nearest to a position; `full_scale` is the position of the full-scale code,
/// metres.
pub fn codes(position: StagePosition, full_scale: f64, bits: u8) -> [i32; 2] {
    let full = f64::from(1_i32 << (bits - 1));
    position.map(|p| (p / full_scale * full).round().clamp(-full, full - 1.0) as i32)
}

/// The steering matrix with its origin: a stage at `q` puts the beam, in the plane across the beam, at `s =
/// origin + matrix q`. Metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeamMap {
    matrix: Matrix2<f64>,
    inverse: Matrix2<f64>,
    origin: Vector2<f64>,
}

/// The identity: the beam moves with the stage, along the same axes.
impl Default for BeamMap {
    fn default() -> Self {
        Self::new([[1.0, 0.0], [0.0, 1.0]], BeamPoint::default())
    }
}

impl BeamMap {
    /// The map of a matrix (rows: x, y of the beam; columns: axes of the stage), which must have an inverse,
    /// and an origin in metres.
    pub fn new([[a, b], [c, d]]: [[f64; 2]; 2], origin: BeamPoint) -> Self {
        let (matrix, origin) = (Matrix2::new(a, b, c, d), Vector2::from(origin));
        Self { matrix, inverse: matrix.try_inverse().unwrap_or_else(Matrix2::identity), origin }
    }

    /// Position of the beam for a position of the stage, metres.
    pub fn beam(&self, stage: StagePosition) -> BeamPoint {
        (self.origin + self.matrix * Vector2::from(stage)).into()
    }

    /// Position of the stage that puts the beam at `beam`, metres.
    pub fn stage(&self, beam: BeamPoint) -> StagePosition {
        (self.inverse * (Vector2::from(beam) - self.origin)).into()
    }

    /// The motion of the stage that moves the beam by `step`; also for velocities.
    pub fn stage_step(&self, step: BeamOffset) -> StageMove {
        (self.inverse * Vector2::from(step)).into()
    }

    /// Largest motion of the beam per unit motion of the stage.
    pub fn largest_gain(&self) -> f64 {
        self.matrix.singular_values().max()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_beam_map_and_its_inverse_agree() {
        let map = BeamMap::new([[0.0, -2.0], [0.5, 0.1]], BeamPoint([30e-6, -10e-6]));
        let close =
            |a: [f64; 2], b: [f64; 2]| assert!((0..2).all(|i| (a[i] - b[i]).abs() < 1e-15), "{a:?} {b:?}");
        close(map.beam(StagePosition([1e-6, 0.0])).0, [30e-6, -9.5e-6]);
        close(map.beam(StagePosition([0.0, 1e-6])).0, [28e-6, -9.9e-6]);
        close(map.stage(map.beam(StagePosition([7e-6, -3e-6]))).0, [7e-6, -3e-6]);
        close(map.stage_step(BeamOffset([-2e-6, 0.1e-6])).0, [0.0, 1e-6]);
        assert!((map.largest_gain() - 2.0).abs() < 0.01);
    }
}
