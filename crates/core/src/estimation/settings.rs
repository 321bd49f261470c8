//! Parameters of estimation, in SI units.

use trifacet_optics::{Estimator, Model, Optics};
use trifacet_wire::Status;

use super::Frames;
use super::integrity::Readback;

/// Parameters of estimation.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The solver with its model of the head.
    pub estimator: Estimator,
    /// Samples of which the mean is solved.
    pub average: u16,
    /// Standard uncertainty of a spot coordinate, metres, until it is measured.
    pub spot_noise: f64,
    /// Standard uncertainty of a power, as a fraction of the total, until it is measured.
    pub power_noise: f64,
    /// From the readback of the stage to the position of the beam.
    pub readback: Readback,
    /// Whether the position of the beam by the readback counts as two more signals.
    pub fuse: bool,
    /// A spot nearer than this to the edge of its PSD sets a warning, metres.
    pub edge_margin: f64,
    /// Largest imbalance of the three powers without a warning.
    pub balance_limit: f64,
    /// Status bits that are always set.
    pub fixed: Status,
    /// From the sensor's world to the user's frame.
    pub frames: Frames,
    /// Fingerprint of the configuration, which every report carries.
    pub config: u32,
}

impl Settings {
    /// The parameters of a nominal head for a solver: no averaging, no frames, no fusion.
    pub fn new(optics: Optics, model: Model) -> Self {
        Self {
            estimator: Estimator::new(optics, model),
            average: 1,
            spot_noise: 1.08e-6,
            power_noise: 1e-3,
            readback: Readback::default(),
            fuse: false,
            edge_margin: 0.5e-3,
            balance_limit: 0.05,
            fixed: Status::default(),
            frames: Frames::default(),
            config: 0,
        }
    }

    /// Whether the steering position counts as two more signals, where it is read back.
    pub fn fuses(&self) -> bool {
        self.fuse
    }
}
