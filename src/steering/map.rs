//! From the stage to the beam, and back.

use nalgebra::{Matrix2, Vector2};

use super::Xy;
use crate::config::SteeringConfig;

/// The steering matrix with its origin: a stage at `q` puts the beam, seen across itself, at
/// `s = origin + matrix q`. Metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeamMap {
    matrix: Matrix2<f64>,
    inverse: Matrix2<f64>,
    origin: Vector2<f64>,
}

impl BeamMap {
    /// From a checked configuration: its matrix has an inverse.
    pub fn new(config: &SteeringConfig) -> Self {
        let [[a, b], [c, d]] = config.matrix;
        let matrix = Matrix2::new(a, b, c, d);
        let origin = Vector2::from(config.origin_um) * 1e-6;
        Self { matrix, inverse: matrix.try_inverse().unwrap_or_else(Matrix2::identity), origin }
    }

    /// Where the beam is while the stage stands at `stage`.
    pub fn beam(&self, stage: Xy) -> Xy {
        (self.origin + self.matrix * Vector2::from(stage)).into()
    }

    /// Where the stage must stand for the beam to be at `beam`.
    pub fn stage(&self, beam: Xy) -> Xy {
        (self.inverse * (Vector2::from(beam) - self.origin)).into()
    }

    /// The movement of the stage that moves the beam by `step`; velocities likewise.
    pub fn stage_step(&self, step: Xy) -> Xy {
        (self.inverse * Vector2::from(step)).into()
    }

    /// The most by which the beam moves per length that the stage moves.
    pub fn largest_gain(&self) -> f64 {
        self.matrix.singular_values().max()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_and_back() {
        let config = SteeringConfig {
            matrix: [[0.0, -2.0], [0.5, 0.1]],
            origin_um: [30.0, -10.0],
            ..SteeringConfig::default()
        };
        let map = BeamMap::new(&config);
        let close = |a: Xy, b: Xy| assert!((0..2).all(|i| (a[i] - b[i]).abs() < 1e-15), "{a:?} {b:?}");
        close(map.beam([1e-6, 0.0]), [30e-6, -9.5e-6]);
        close(map.beam([0.0, 1e-6]), [28e-6, -9.9e-6]);
        close(map.stage(map.beam([7e-6, -3e-6])), [7e-6, -3e-6]);
        close(map.stage_step([-2e-6, 0.1e-6]), [0.0, 1e-6]);
        assert!((map.largest_gain() - 2.0).abs() < 0.01);
    }
}
