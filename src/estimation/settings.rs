//! What estimation is told by the configuration.

use trifacet_optics::{Estimator, HeadError, Optics};
use trifacet_wire::Status;

use super::Frames;
use super::integrity::Readback;
use crate::config::Config;

/// What estimation needs to know.
#[derive(Clone, Debug)]
pub struct Settings {
    pub(super) estimator: Estimator,
    pub(super) average: u16,
    pub(super) spot_noise: f64,
    pub(super) power_noise: f64,
    pub(super) readback: Readback,
    pub(super) fuse: bool,
    pub(super) edge_margin: f64,
    pub(super) balance_limit: f64,
    /// Bits that are always set.
    pub(super) fixed: Status,
    pub(super) frames: Frames,
    pub(super) config: u32,
}

impl Settings {
    /// From a checked configuration; `calibrated` if every PSD has a correction table; `id` is the
    /// configuration's fingerprint.
    pub fn new(config: &Config, calibrated: bool, id: u32) -> Result<Self, HeadError> {
        let estimation = &config.estimation;
        let mut fixed = Status::default();
        fixed.set(Status::UNCALIBRATED, !calibrated);
        Ok(Self {
            estimator: Estimator::new(Optics::new(&config.head.build()?), estimation.model.into()),
            average: estimation.average,
            spot_noise: estimation.spot_noise_um * 1e-6,
            power_noise: estimation.power_noise,
            readback: Readback::new(&config.steering),
            fuse: estimation.fuse_steering,
            edge_margin: estimation.edge_margin_mm * 1e-3,
            balance_limit: estimation.balance_limit,
            fixed,
            frames: Frames::new(&config.frames),
            config: id,
        })
    }

    /// Whether the steering position counts as two more signals, where it is read back.
    pub fn fuses(&self) -> bool {
        self.fuse
    }
}
