//! Settings of a controller from the configuration, in metres.

use std::fmt;
use std::path::PathBuf;

use trifacet_core::steering::StagePosition;

use super::protocol::Axes;
use crate::config::GcsConfig;
use crate::exit::{self, Failure};

/// Connection to a controller.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Line {
    /// Host and port.
    Tcp(String),
    /// A serial port.
    Serial {
        /// Path of the port.
        port: PathBuf,
        /// Baud rate.
        baud: u32,
    },
}

impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(address) => f.write_str(address),
            Self::Serial { port, .. } => write!(f, "{}", port.display()),
        }
    }
}

/// Settings of the driver.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Connection to the controller.
    pub line: Line,
    /// Names of the axes.
    pub axes: Axes,
    /// Unit of position of the controller, metres.
    pub unit: f64,
    /// Position of the controller at the zero of the daemon, metres.
    pub zero: StagePosition,
    /// Whether a servo that is off may be switched on.
    pub servo_on: bool,
    /// Time limit for an answer, milliseconds.
    pub timeout_ms: u16,
}

impl Settings {
    /// Settings from the section `[steering.gcs]` of a checked configuration.
    ///
    /// # Errors
    /// [`exit::CONFIG`] if it contains neither an address nor a port.
    pub fn new(gcs: &GcsConfig) -> Result<Self, Failure> {
        let line = match (&gcs.address, &gcs.port) {
            (Some(address), _) => Line::Tcp(address.clone()),
            (None, Some(port)) => Line::Serial { port: port.clone(), baud: gcs.baud },
            (None, None) => {
                let why =
                    "steering.gcs has no connection: allowed is steering.gcs.address or steering.gcs.port";
                return Err(Failure::new(exit::CONFIG, why));
            }
        };
        Ok(Self {
            line,
            axes: gcs.axes.clone(),
            unit: gcs.um_per_unit * 1e-6,
            zero: StagePosition(gcs.zero_um.map(|um| um * 1e-6)),
            servo_on: gcs.servo_on,
            timeout_ms: gcs.timeout_ms,
        })
    }

    /// A position in units of the controller.
    pub fn counted(&self, position: StagePosition) -> [f64; 2] {
        [0, 1].map(|axis| (position[axis] + self.zero[axis]) / self.unit)
    }

    /// A position from units of the controller, metres.
    pub fn position(&self, counted: [f64; 2]) -> StagePosition {
        StagePosition([0, 1].map(|axis| counted[axis] * self.unit - self.zero[axis]))
    }
}
