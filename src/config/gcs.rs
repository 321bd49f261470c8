//! `[steering.gcs]`: a PI stage whose controller uses the General Command Set 2.0.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::check::{Checker, above_zero};

/// Settings of `[steering.gcs]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GcsConfig {
    /// Host and TCP port of the controller.
    pub address: Option<String>,
    /// Serial port of the controller, as an alternative to `address`.
    pub port: Option<PathBuf>,
    /// Line rate of the serial port, bits per second.
    pub baud: u32,
    /// The controller's names of the two axes.
    pub axes: [String; 2],
    /// The controller's unit of position, micrometres.
    pub um_per_unit: f64,
    /// Position reading of the controller at the daemon's zero, micrometres.
    pub zero_um: [f64; 2],
    /// Whether a servo that is off is switched on.
    pub servo_on: bool,
    /// Longest time that the controller may take to answer, milliseconds.
    pub timeout_ms: u16,
}

impl Default for GcsConfig {
    fn default() -> Self {
        Self {
            address: None,
            port: None,
            baud: 115_200,
            axes: ["1".into(), "2".into()],
            um_per_unit: 1.0,
            zero_um: [0.0; 2],
            servo_on: false,
            timeout_ms: 500,
        }
    }
}

const ADDRESS: &str = "a host and its port, such as \"192.168.1.20:50000\"";
const AXIS: &str = "two different names of 1 to 16 letters, digits and _";

impl GcsConfig {
    /// `used`: this stage moves the laser.
    pub(super) fn check(&self, mut at: Checker<'_>, used: bool) {
        let (address, port) = (&self.address, &self.port);
        if let Some(address) = address {
            at.demand(is_address(address), "address", format!("{address:?}"), ADDRESS);
        } else if used && port.is_none() {
            let needed =
                format!("{ADDRESS}, or steering.gcs.port: steering.kind = \"gcs\" needs one of them");
            at.demand(false, "address", "absent", needed);
        }
        if let Some(port) = port {
            let port = port.to_string_lossy();
            at.demand(!port.trim().is_empty(), "port", format!("{port:?}"), "the path of a serial port");
            at.demand(
                address.is_none(),
                "port",
                format!("{port:?}"),
                "absent, because steering.gcs.address is set",
            );
        }
        at.number("baud", self.baud, 1200.0..=20_000_000.0);
        let [x, y] = &self.axes;
        at.demand(is_axis(x) && is_axis(y) && x != y, "axes", format!("{:?}", self.axes), AXIS);
        at.number("um_per_unit", self.um_per_unit, above_zero(1_000_000.0));
        at.numbers("zero_um", &self.zero_um, -1_000_000.0..=1_000_000.0);
        at.number("timeout_ms", self.timeout_ms, 10.0..=10_000.0);
    }
}

fn is_address(address: &str) -> bool {
    let parts = address.rsplit_once(':');
    parts.is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok_and(|port| port > 0))
}

fn is_axis(name: &str) -> bool {
    (1..=16).contains(&name.len()) && name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_')
}
