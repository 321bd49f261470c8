//! Parses the TOML configuration file into checked settings.
//!
//! Every key has a default and carries its unit in its name. Unknown keys and values out of range are
//! refused with file, line, key and what is allowed. `docs/configuration.md` describes every key.
//!
//! - [`load()`] reads a file.
//! - Each section has a module with its settings, defaults and allowed ranges.
//! - `check` collects problems, `cross_checks` checks values against each other, `locate` finds the lines.

mod acquisition;
mod assembly;
mod board_place;
mod calibration;
mod calibration_context;
mod centering;
mod channels;
mod check;
mod control;
mod correction;
mod cross_checks;
mod destination;
pub mod edit;
mod error;
mod estimation;
mod fault;
mod file;
mod frames;
mod gcs;
mod head;
mod id;
mod labjack;
mod laser;
mod load;
mod locate;
mod log;
mod monitor;
mod motion;
mod network;
pub mod places;
mod publishing;
mod realtime;
mod recording;
pub mod reload;
mod replay;
mod rewrite;
mod steering;
mod text;
mod tilt;
mod tune;
mod twin;
mod twin_head;
mod uncertainty;

pub use acquisition::{AcquisitionConfig, SerialConfig, SourceKind};
pub use assembly::AssemblyError;
pub use board_place::BoardPlace;
pub use calibration::{
    AtCalibration, CalibrationConfig, CalibrationState, FORMAT, RecordError, RecordHeader, SharedSpread,
    Standing, SteeringResidual, fingerprint,
};
pub(crate) use calibration::{contents, parsed, spread_bytes};
pub use calibration_context::{CalibrationContext, TableError, Tables};
pub use centering::{CenteringConfig, Gains};
pub use channels::{ChannelsConfig, PsdChannelsConfig};
pub use control::ControlConfig;
pub use destination::{Destination, DestinationError, Host};
pub use error::{ConfigError, InvalidValues, Problem};
pub use estimation::{EstimationConfig, Model};
pub use fault::{Fault, FaultKeyError, FaultKind};
pub use frames::{FramesConfig, TransformConfig};
pub use gcs::GcsConfig;
pub use head::{FacetConfig, HeadConfig};
pub use labjack::{LabjackConfig, LabjackOutputs};
pub use laser::LaserConfig;
pub use load::{load, load_again, parse};
pub use locate::Place;
pub use log::{LogConfig, LogFormat};
pub use monitor::{MonitorConfig, Token};
pub use motion::{Axis, Motion, MotionKind};
pub use network::{Network, NetworkError};
pub use publishing::{Deviations, PublishingConfig, UdpTarget};
pub use realtime::RealtimeConfig;
pub use recording::{Compression, RecordingConfig, RecordingMode};
pub use replay::ReplayConfig;
use serde::{Deserialize, Serialize};
pub use steering::{NO_TILT, POINTING_UM, SteeringConfig, SteeringKind, UnknownSteeringKind};
pub use tilt::TiltConfig;
pub use tune::TuneConfig;
pub use twin::{TwinConfig, TwinSteering};
pub use twin_head::{TwinBeam, TwinPsd, TwinPsds, TwinStage, TwinTemperature, TwinTolerances};
pub use uncertainty::{Components, Group, NotCovered, UncertaintyConfig, Unit};

/// The whole configuration.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Geometry of the sensor head.
    pub head: HeadConfig,
    /// Source of the samples.
    pub acquisition: AcquisitionConfig,
    /// Conversion of codes to spots and powers.
    pub channels: ChannelsConfig,
    /// The record of the head's calibration.
    pub calibration: CalibrationConfig,
    /// The centering loop.
    pub centering: CenteringConfig,
    /// The laser's steering stage.
    pub steering: SteeringConfig,
    /// The light that is expected.
    pub laser: LaserConfig,
    /// Limits of `trifacet tune`.
    pub tune: TuneConfig,
    /// Computation of poses.
    pub estimation: EstimationConfig,
    /// Coordinate frames of the poses.
    pub frames: FramesConfig,
    /// What the readings do not tell about the uncertainty of a pose.
    pub uncertainty: UncertaintyConfig,
    /// Outlets of the poses.
    pub publishing: PublishingConfig,
    /// The control socket.
    pub control: ControlConfig,
    /// Health, metrics and the live page.
    pub monitor: MonitorConfig,
    /// Recording to files.
    pub recording: RecordingConfig,
    /// A recording as the source.
    pub replay: ReplayConfig,
    /// The digital twin.
    pub twin: TwinConfig,
    /// Priority, memory and CPU of the fast thread.
    pub realtime: RealtimeConfig,
    /// Level and format of the log.
    pub log: LogConfig,
}

impl Config {
    /// Checks every value against its own range and then, if all are valid, values against each other.
    fn check(&self, at: &mut check::Checker<'_>) {
        self.head.check(at.section("head"));
        self.acquisition.check(at.section("acquisition"));
        self.channels.check(at.section("channels"));
        self.calibration.check(at.section("calibration"));
        self.centering.check(at.section("centering"));
        self.steering.check(at.section("steering"));
        self.laser.check(at.section("laser"));
        self.tune.check(at.section("tune"));
        self.estimation.check(at.section("estimation"));
        self.frames.check(at.section("frames"));
        self.uncertainty.check(at.section("uncertainty"));
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
