//! How many samples a point of a calibration needs.

use crate::config::Config;

/// Fewest samples of a point: their scatter is its standard uncertainty.
pub const FEWEST: u32 = 10;
/// Most samples of a point.
pub const MOST: u32 = 100_000;

/// Standard uncertainties of the reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceNoise {
    /// Of each translation, metres.
    pub metres: f64,
    /// Of each rotation, radians.
    pub radians: f64,
}

impl ReferenceNoise {
    /// The six standard uncertainties, in the order of a pose.
    pub fn of_pose(self) -> [f64; 6] {
        [self.metres, self.metres, self.metres, self.radians, self.radians, self.radians]
    }

    /// What the reference leaves uncertain of a spot, at the least: by its translations or by its rotations,
    /// metres.
    pub fn at_psd(self, config: &Config) -> f64 {
        self.metres.min(self.radians * config.head.psd_distance_mm * 1e-3)
    }

    /// Number of samples whose mean has less noise than the reference, for spots with the configured noise.
    pub fn samples(self, config: &Config) -> u32 {
        let ratio = config.estimation.spot_noise_um * 1e-6 / self.at_psd(config);
        (ratio * ratio).ceil().clamp(FEWEST.into(), MOST.into()) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_good_reference_needs_a_hundred_samples_and_a_coarse_one_the_fewest() {
        let samples = |metres, radians| ReferenceNoise { metres, radians }.samples(&Config::default());
        assert_eq!(samples(0.1e-6, 0.5e-6), 117);
        assert_eq!(samples(1e-6, 20e-6), FEWEST);
        // Rotations that are known better than translations decide: 0.2 urad are 0.05 um at 250 mm.
        assert_eq!(samples(1e-6, 0.2e-6), 467);
        assert_eq!(samples(1e-12, 1e-12), MOST);
    }
}
