//! The distortion of a PSD: its reading as a function of the true spot.
//!
//! `reading = spot + d(spot)`. A correction table is the inverse, a function of the reading. `d` is explicit, so that
//! it is exact; the inverse exists as long as the slopes of `d` are far below one, as the allowed values make them.

use std::f64::consts::TAU;

use rand::{Rng, RngExt};

/// The distortion of one PSD, metres.
#[derive(Clone, Debug)]
pub struct Distortion {
    /// Half the side of the sensitive area.
    pub half_size: f64,
    /// A lateral-effect detector stretches outwards with the cube of the distance: `r' = r (1 + bow / half (r/half)^2)`.
    /// A spot at the middle of an edge is measured `bow` too far out, a spot in a corner twice that along each axis.
    pub bow: f64,
    /// Terms of u in x^2, x y, y^2, then of v, with x and y in units of half the side.
    pub asymmetry: [f64; 6],
    /// Ripple of u and of v.
    pub ripple: [Ripple; 2],
}

impl Distortion {
    /// The reading of a spot.
    pub fn reading(&self, at: [f64; 2]) -> [f64; 2] {
        let [x, y] = at.map(|a| a / self.half_size);
        let stretch = 1.0 + self.bow / self.half_size * (x * x + y * y);
        let bowed = at.map(|a| a * stretch);
        let [u2, uv, v2] = [x * x, x * y, y * y];
        let asymmetry = |[a, b, c]: [f64; 3]| a * u2 + b * uv + c * v2;
        let [a, b, c, d, e, f] = self.asymmetry;
        let [ru, rv] = &self.ripple;
        [bowed[0] + asymmetry([a, b, c]) + ru.at(at), bowed[1] + asymmetry([d, e, f]) + rv.at(at)]
    }
}

/// Waves in a plane: they add up to nearly normally distributed errors with this rms.
#[derive(Clone, Debug, Default)]
pub struct Ripple {
    waves: Vec<Wave>,
    amplitude: f64,
}

/// Number of waves.
const WAVES: usize = 12;

/// A wave: radians per metre along u and v, and its phase.
#[derive(Clone, Copy, Debug)]
struct Wave {
    k: [f64; 2],
    phase: f64,
}

impl Ripple {
    /// A ripple with this rms, of waves with random directions and lengths between these two (metres).
    pub fn new(rms: f64, [shortest, longest]: [f64; 2], rng: &mut impl Rng) -> Self {
        let mut wave = |_| {
            let length = shortest + (longest - shortest) * rng.random::<f64>();
            let (sin, cos) = (TAU * rng.random::<f64>()).sin_cos();
            let k = TAU / length;
            Wave { k: [k * cos, k * sin], phase: TAU * rng.random::<f64>() }
        };
        let waves = (0..WAVES).map(&mut wave).collect();
        Self { waves, amplitude: rms * (2.0 / WAVES as f64).sqrt() }
    }

    fn at(&self, [u, v]: [f64; 2]) -> f64 {
        self.amplitude * self.waves.iter().map(|w| (w.k[0] * u + w.k[1] * v + w.phase).sin()).sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::*;

    const HALF: f64 = 6.5e-3;

    fn flat() -> Distortion {
        Distortion { half_size: HALF, bow: 0.0, asymmetry: [0.0; 6], ripple: Default::default() }
    }

    #[test]
    fn each_term_has_its_size_at_the_middle_of_an_edge() {
        let near = |a: [f64; 2], b: [f64; 2]| (0..2).all(|i| (a[i] - b[i]).abs() < 1e-15);
        let bow = Distortion { bow: 1e-4, ..flat() };
        assert!(near(bow.reading([HALF, 0.0]), [HALF + 1e-4, 0.0]));
        assert!(near(bow.reading([-HALF, HALF]), [-HALF - 2e-4, HALF + 2e-4]));
        let skewed = Distortion { asymmetry: [1e-5, 2e-5, 3e-5, 4e-5, 5e-5, 6e-5], ..flat() };
        assert!(near(skewed.reading([-HALF, 0.0]), [-HALF + 1e-5, 4e-5]));
        assert!(near(skewed.reading([0.0, HALF]), [3e-5, HALF + 6e-5]));
        assert!(near(skewed.reading([HALF, -HALF]), [HALF + 2e-5, -HALF + 5e-5]));
    }

    #[test]
    fn the_ripple_has_its_rms_and_its_waves() {
        let mut rng = Pcg64::seed_from_u64(5);
        let (mut square, mut slope, mut n) = (0.0, 0.0, 0.0);
        for _ in 0..400 {
            let map = Distortion {
                ripple: std::array::from_fn(|_| Ripple::new(1.5e-6, [2e-3, 5e-3], &mut rng)),
                ..flat()
            };
            for k in 0..40 {
                let at = [(f64::from(k) / 20.0 - 1.0) * HALF, 1e-3];
                let error = |at: [f64; 2]| map.reading(at)[1] - at[1];
                square += error(at).powi(2);
                slope += ((error([at[0] + 1e-6, at[1]]) - error(at)) / 1e-6).powi(2);
                n += 1.0;
            }
        }
        let rms = (square / n).sqrt();
        assert!((rms / 1.5e-6 - 1.0).abs() < 0.05, "{rms:e}");
        // Along one axis, the mean square of the wave number is half of (2 pi)^2 / (shortest * longest).
        let number = (slope / square).sqrt();
        assert!((number / (TAU / (2.0_f64 * 2e-3 * 5e-3).sqrt()) - 1.0).abs() < 0.1, "{number}");
    }
}
