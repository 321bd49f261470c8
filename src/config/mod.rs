//! The configuration file: TOML to checked settings.
//!
//! Every key has a default and carries its unit in its name. Unknown keys and values out of range are
//! refused with file, line, key and what is allowed. `docs/configuration.md` has every key.
//!
//! - [`load()`] reads a file; the sections follow, one module each, with defaults and allowed ranges.
//! - `check` collects what is wrong, `together` knows what must fit across sections, and `locate` finds
//!   the lines.

mod acquisition;
mod assembly;
mod calibration_context;
mod centering;
mod channels;
mod check;
mod control;
mod correction;
mod cross_checks;
pub mod edit;
mod error;
mod estimation;
mod fault;
mod frames;
mod gcs;
mod head;
mod id;
mod load;
mod locate;
mod log;
mod monitor;
mod motion;
mod network;
mod publishing;
mod realtime;
mod recording;
pub mod reload;
mod replay;
mod steering;
mod text;
mod twin;

pub use acquisition::{AcquisitionConfig, SerialConfig, SourceKind};
pub use assembly::AssemblyError;
pub use calibration_context::{CalibrationContext, TableError, Tables};
pub use centering::{CenteringConfig, Gains};
pub use channels::{ChannelsConfig, PsdChannelsConfig};
pub use control::ControlConfig;
pub use error::{ConfigError, Problem};
pub use estimation::{EstimationConfig, Model};
pub use fault::{Fault, FaultKind};
pub use frames::{FramesConfig, TransformConfig};
pub use gcs::GcsConfig;
pub use head::{FacetConfig, HeadConfig};
pub use load::{load, parse};
pub use locate::Place;
pub use log::{LogConfig, LogFormat};
pub use monitor::{MonitorConfig, Token};
pub use motion::{Axis, Motion, MotionKind};
pub use network::Network;
pub use publishing::{PublishingConfig, UdpTarget};
pub use realtime::RealtimeConfig;
pub use recording::{Compression, RecordingConfig, RecordingMode};
pub use replay::ReplayConfig;
use serde::{Deserialize, Serialize};
pub use steering::{NO_TILT, SteeringConfig, SteeringKind};
pub use twin::{TwinConfig, TwinSteering};

/// The whole file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Geometry of the sensor head.
    pub head: HeadConfig,
    /// Where samples come from.
    pub acquisition: AcquisitionConfig,
    /// From codes to spots and powers.
    pub channels: ChannelsConfig,
    /// The centering loop.
    pub centering: CenteringConfig,
    /// The laser's steering stage.
    pub steering: SteeringConfig,
    /// From samples to poses.
    pub estimation: EstimationConfig,
    /// In which frame poses are told.
    pub frames: FramesConfig,
    /// Where poses go.
    pub publishing: PublishingConfig,
    /// The control socket.
    pub control: ControlConfig,
    /// Health, metrics and the live page.
    pub monitor: MonitorConfig,
    /// What is written to files.
    pub recording: RecordingConfig,
    /// A recording as a source.
    pub replay: ReplayConfig,
    /// The digital twin.
    pub twin: TwinConfig,
    /// Priority, memory and CPU of the fast thread.
    pub realtime: RealtimeConfig,
    /// Logs.
    pub log: LogConfig,
}

impl Config {
    /// Every value against its own range, then, if all are fine, against each other.
    fn check(&self, at: &mut check::Checker<'_>) {
        self.head.check(at.section("head"));
        self.acquisition.check(at.section("acquisition"));
        self.channels.check(at.section("channels"));
        self.centering.check(at.section("centering"));
        self.steering.check(at.section("steering"));
        self.estimation.check(at.section("estimation"));
        self.frames.check(at.section("frames"));
        self.publishing.check(at.section("publishing"));
        self.control.check(at.section("control"));
        self.monitor.check(at.section("monitor"));
        self.recording.check(at.section("recording"));
        self.twin.check(at.section("twin"), self.acquisition.rate_hz);
        self.replay.check(at.section("replay"));
        self.realtime.check(at.section("realtime"));
        self.log.check(at.section("log"));
        if at.clean() {
            cross_checks::check(self, at);
        }
    }
}
