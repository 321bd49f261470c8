//! The temperature of the head, and what it changes.

use std::array::from_fn;
use std::f64::consts::TAU;

use rand::RngExt;
use trifacet_optics::{Head, Vec3};

use super::random;
use crate::config::TwinTemperature;

/// The temperature as a function of time, and the drifts of this head.
#[derive(Clone, Debug)]
pub struct Temperature {
    config: TwinTemperature,
    /// Drift of u, v of A, B, C, metres per kelvin.
    zero: [[f64; 2]; 3],
    /// Relative drift of their gains per kelvin.
    gain: [[f64; 2]; 3],
    /// Rotation of the light, radians per kelvin.
    tilt: Vec3,
}

impl Temperature {
    /// The drifts of the head with this seed: they have the configured sizes and random signs.
    pub fn new(config: &TwinTemperature, seed: u64) -> Self {
        let mut rng = random(seed, 2000);
        let mut signed = |size: f64| if rng.random::<bool>() { size } else { -size };
        let zero = from_fn(|_| from_fn(|_| signed(config.psd_zero_um_per_k * 1e-6)));
        let gain = from_fn(|_| from_fn(|_| signed(config.psd_gain_ppm_per_k * 1e-6)));
        let (sin, cos) = (TAU * rng.random::<f64>()).sin_cos();
        let tilt = Vec3::new(cos, sin, 0.0) * (config.beam_tilt_urad_per_k * 1e-6);
        Self { config: config.clone(), zero, gain, tilt }
    }

    /// The temperature at this time after the start, less that at the start, kelvin.
    pub fn kelvin(&self, t_s: f64) -> f64 {
        let c = &self.config;
        c.warm_up_k * -(-t_s / c.warm_up_s).exp_m1() + c.swing_k * (TAU * t_s / c.swing_s).sin()
    }

    /// The reading of a PSD at this temperature, from that at the start.
    pub fn reading(&self, psd: usize, at: [f64; 2], kelvin: f64) -> [f64; 2] {
        from_fn(|i| at[i] * (1.0 + self.gain[psd][i] * kelvin) + self.zero[psd][i] * kelvin)
    }

    /// The head at this temperature, from that at the start.
    pub fn head(&self, head: &Head, kelvin: f64) -> Head {
        let mut head = head.clone();
        let longer = 1.0 + self.config.distance_ppm_per_k * 1e-6 * kelvin;
        for psd in &mut head.psds {
            psd.origin.x *= longer;
            psd.origin.y *= longer;
            psd.origin.z += self.config.height_um_per_k * 1e-6 * kelvin;
        }
        let direction = head.beam_direction;
        head.beam_direction = (direction + (self.tilt * kelvin).cross(&direction)).normalize();
        head
    }

    /// The signal of the temperature channel, volts.
    pub fn volts(&self, kelvin: f64) -> f64 {
        self.config.channel_v_per_k * kelvin
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_drifts_are_proportional_to_the_temperature() {
        let config = TwinTemperature { warm_up_k: 2.0, swing_k: 0.5, ..TwinTemperature::default() };
        let warm = Temperature::new(&config, 3);
        assert_eq!(warm.kelvin(0.0), 0.0);
        let at = 2.0 * (1.0 - (-1.0_f64).exp()); // 1800 s are two periods of the swing
        assert!((warm.kelvin(1800.0) - at).abs() < 1e-12);
        let cold = Head::default();
        let head = warm.head(&cold, 2.0);
        assert!((head.psds[0].origin - Vec3::new(0.25 * (1.0 + 46e-6), 0.0, 2.4e-6)).norm() < 1e-15);
        assert!((head.beam_direction.dot(&cold.beam_direction).acos() - 2e-6).abs() < 1e-7);
        assert_eq!(warm.head(&cold, 0.0), cold);
        for psd in 0..3 {
            for [coordinate, other] in [[0, 1], [1, 0]] {
                let zero = warm.reading(psd, [0.0; 2], 2.0)[coordinate];
                assert!((zero.abs() - 1e-6).abs() < 1e-15);
                let mut at = [0.0; 2];
                at[coordinate] = 5e-3;
                let reading = warm.reading(psd, at, 2.0);
                assert!(((reading[coordinate] - 5e-3 - zero).abs() - 4e-7).abs() < 1e-15);
                assert_eq!(reading[other], warm.reading(psd, [0.0; 2], 2.0)[other]);
            }
        }
        assert!((warm.volts(2.0) - 0.2).abs() < 1e-15);
    }
}
