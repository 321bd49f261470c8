//! The positions of a scan of the steering.

use trifacet_core::steering::BeamOffset;

/// Positions on each side of the square.
const SIDE: usize = 9;
/// Number of positions.
pub const POINTS: usize = SIDE * SIDE;
/// Half the side of the square at the apex, metres.
pub const HALF: f64 = 150e-6;

/// Offsets of the beam on a square grid around the apex, row by row, back and forth.
pub fn square(half: f64) -> impl Iterator<Item = BeamOffset> {
    let at = move |k: usize| half * (2.0 * k as f64 / (SIDE - 1) as f64 - 1.0);
    (0..POINTS).map(move |k| {
        let (row, column) = (k / SIDE, k % SIDE);
        let column = if row % 2 == 0 { column } else { SIDE - 1 - column };
        BeamOffset([at(column), at(row)])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_beam_moves_in_short_steps_over_the_whole_square() {
        let offsets: Vec<_> = square(HALF).collect();
        assert_eq!((offsets[0], offsets[80]), (BeamOffset([-HALF; 2]), BeamOffset([HALF; 2])));
        assert!(offsets.windows(2).all(|w| (w[1][0] - w[0][0]).hypot(w[1][1] - w[0][1]) < 38e-6));
    }
}
