//! The sections of the file, key by key.

use serde::Deserialize;
use std::net::SocketAddr;
use std::path::PathBuf;

/// The whole file.
#[derive(Clone, Debug, Default, Deserialize)]
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
    /// Where poses go.
    pub publishing: PublishingConfig,
    /// The digital twin.
    pub twin: TwinConfig,
    /// Priority, memory and CPU of the fast thread.
    pub realtime: RealtimeConfig,
    /// Logs.
    pub log: LogConfig,
}

/// `[head]`: four numbers build the nominal head; the rest is for heads that were calibrated.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HeadConfig {
    /// From the origin to each PSD.
    pub psd_distance_mm: f64,
    /// Side of the sensitive area.
    pub psd_size_mm: f64,
    /// Inclination of the facets to the mirror's base.
    pub facet_angle_deg: f64,
    /// 1/e^2 diameter of the beam.
    pub beam_diameter_mm: f64,
    /// Direction in which the light travels, world frame.
    pub beam_direction: Option<[f64; 3]>,
    /// Facet A and its PSD where they differ from the nominal ones.
    pub a: FacetConfig,
    /// Facet B and its PSD.
    pub b: FacetConfig,
    /// Facet C and its PSD.
    pub c: FacetConfig,
}

/// `[head.a]`, `[head.b]`, `[head.c]`.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FacetConfig {
    /// Normal of the facet in the mirror frame.
    pub normal: Option<[f64; 3]>,
    /// Centre of the PSD, world frame.
    pub psd_origin_mm: Option<[f64; 3]>,
    /// Normal of the PSD, towards the mirror, world frame.
    pub psd_normal: Option<[f64; 3]>,
    /// Direction of the PSD's v-axis, world frame.
    pub psd_up: Option<[f64; 3]>,
}

/// Which source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SourceKind {
    /// The digital twin.
    Twin,
    /// An acquisition board on a serial port.
    Serial,
}

/// `[acquisition]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AcquisitionConfig {
    /// Where samples come from.
    pub source: SourceKind,
    /// Samples per second.
    pub rate_hz: f64,
    /// The serial board.
    pub serial: SerialConfig,
}

/// `[acquisition.serial]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SerialConfig {
    /// Device path of the port.
    pub port: PathBuf,
    /// Bits per second on the wire. Ten bits carry a byte.
    pub baud: u32,
    /// Fixed time from the end of a scan to its arrival, subtracted from the arrival times.
    pub latency_us: f64,
}

/// `[channels]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ChannelsConfig {
    /// Below this sum signal (dark offset subtracted) a PSD has no position.
    pub sum_threshold_v: f64,
    /// Fraction of the converter's range beyond which a code counts as clipped.
    pub clip_limit: f64,
    /// Power per volt of the sum signal.
    pub power_mw_per_v: f64,
    /// Position of the stage per volt of its readback signal.
    pub readback_um_per_v: f64,
    /// PSD A.
    pub a: PsdChannels,
    /// PSD B.
    pub b: PsdChannels,
    /// PSD C.
    pub c: PsdChannels,
}

/// What the amplifier of a PSD puts out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Amplifier {
    /// Positions, already divided by the sum: `full_scale_v` is the edge of the PSD.
    Normalised,
    /// Differences, not divided: a difference equal to the sum is the edge of the PSD.
    Difference,
}

/// `[channels.a]`, `[channels.b]`, `[channels.c]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PsdChannels {
    /// What the amplifier puts out.
    pub amplifier: Amplifier,
    /// Volts at the edge of the PSD, for a normalised amplifier.
    pub full_scale_v: f64,
    /// Gain of u, v and power on top of the nominal one; negative turns an axis around.
    pub gain: [f64; 3],
    /// Readings of the u, v and sum channel with the laser off; `trifacet dark` measures them.
    pub dark_v: [f64; 3],
    /// Correction table of the PSD's non-linearity, a CSV file relative to this one.
    pub correction: Option<PathBuf>,
}

/// What the loop brings to zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Target {
    /// The offset between beam and apex, by the wedges of the last pose.
    Apex,
    /// The differences between the three powers, as in the paper.
    Balance,
}

/// `[centering]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CenteringConfig {
    /// Whether the loop is closed.
    pub enabled: bool,
    /// What the loop brings to zero.
    pub target: Target,
    /// From a sample to the effect of its command, everything included; sets the gains.
    pub loop_delay_ms: f64,
    /// First-order lag of the stage; sets the proportional gain.
    pub lag_ms: f64,
    /// Proportional gain, if not from the delay.
    pub kp: Option<f64>,
    /// Integral gain, if not from the delay.
    pub ki_per_s: Option<f64>,
    /// Locked while offset and its rms stay within this.
    pub lock_limit_um: f64,
    /// ... for this long.
    pub lock_time_ms: f64,
    /// Held becomes lost after this long.
    pub lost_time_ms: f64,
}

/// What the steering does when the daemon ends, or the lease of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OnExit {
    /// Stays where it is.
    Hold,
    /// Goes to the parking position.
    Park,
}

/// `[steering]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SteeringConfig {
    /// Position at the full-scale output code.
    pub full_scale_um: f64,
    /// The command never leaves plus/minus this.
    pub limit_um: f64,
    /// The command never moves faster.
    pub slew_mm_per_s: f64,
    /// Parking position.
    pub park_um: [f64; 2],
    /// When the daemon ends.
    pub on_exit: OnExit,
    /// How long a command is good for.
    pub lease_ms: u16,
    /// When a command's lease ends.
    pub on_lease: OnExit,
}

/// Which model of the beam.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Model {
    /// A ray through the apex, as in the paper: six signals.
    Ray,
    /// A Gaussian beam: nine signals.
    Gaussian,
}

/// `[estimation]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EstimationConfig {
    /// Which model of the beam.
    pub model: Model,
    /// Samples per pose: means over blocks that do not overlap.
    pub average: u16,
    /// One standard deviation of each spot coordinate.
    pub spot_noise_um: f64,
    /// One standard deviation of each power, relative to it.
    pub power_noise: f64,
    /// Width of the margin on a PSD in which a spot is flagged.
    pub edge_margin_mm: f64,
    /// Largest difference of a power from a third of the sum, relative to the sum, before UNBALANCED.
    pub balance_limit: f64,
}

/// `[publishing]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PublishingConfig {
    /// Where TCP clients connect; none switches the server off.
    pub tcp: Option<SocketAddr>,
    /// Most TCP clients at a time.
    pub tcp_clients: usize,
    /// Frames that a TCP client may be behind before the oldest are dropped.
    pub tcp_queue: usize,
    /// Where datagrams go.
    pub udp: Vec<SocketAddr>,
}

/// `[twin]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TwinConfig {
    /// Starts the random numbers: the same seed gives the same samples.
    pub seed: u64,
    /// Radius of the mirror; light outside is lost.
    pub mirror_radius_mm: f64,
    /// Power of the laser.
    pub laser_mw: f64,
    /// Beam position at rest, world x and y, before steering.
    pub laser_offset_um: [f64; 2],
    /// One standard deviation of each spot coordinate.
    pub spot_noise_um: f64,
    /// One standard deviation of each power, relative to it.
    pub power_noise: f64,
    /// Resolution of the converter.
    pub converter_bits: u8,
    /// Range of the converter, plus and minus.
    pub converter_range_v: f64,
    /// What the nine channels read without light, volts: u, v, sum of A, of B, of C.
    pub dark_v: [f64; 9],
    /// Delay from one channel of the converter to the next.
    pub channel_skew_us: f64,
    /// Bow of the PSDs: how far the reading is off at the middle of an edge.
    pub bow_um: f64,
    /// The steering stage.
    pub steering: TwinSteering,
    /// How the mirror moves; motions add up.
    pub motion: Vec<Motion>,
    /// What goes wrong, and when.
    pub fault: Vec<Fault>,
}

/// `[twin.steering]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TwinSteering {
    /// From command to the start of the movement.
    pub delay_ms: f64,
    /// Time constant of the movement.
    pub lag_ms: f64,
    /// Mechanical limits, plus and minus.
    pub limit_um: f64,
    /// One standard deviation of the readback; absent without a readback channel.
    pub readback_noise_um: Option<f64>,
}

/// An axis of the mirror.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Axis {
    /// Translation along x.
    Tx,
    /// Translation along y.
    Ty,
    /// Translation along z.
    Tz,
    /// Turn about x.
    Roll,
    /// Turn about y.
    Pitch,
    /// Turn about z.
    Yaw,
}

/// `[[twin.motion]]`: one movement of one axis.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Motion {
    /// Which axis.
    pub axis: Axis,
    /// How far (the rms of a vibration), for translations.
    pub amount_um: Option<f64>,
    /// How far, for turns.
    pub amount_urad: Option<f64>,
    /// What kind of movement, and its own keys.
    pub kind: MotionKind,
    /// When it starts; 0 if absent.
    #[serde(default)]
    pub from_s: f64,
    /// When it ends; never if absent. A ramp covers its amount between the two and stays there.
    pub until_s: Option<f64>,
    /// Frequency of a sine; lowest frequency of a vibration.
    pub frequency_hz: Option<f64>,
    /// Highest frequency of a vibration.
    pub high_hz: Option<f64>,
    /// Phase of a sine at its start.
    #[serde(default)]
    pub phase_deg: f64,
}

/// Kinds of movement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MotionKind {
    /// A jump at `from_s`, there until `until_s`; from 0 on it is simply a place to rest.
    Step,
    /// A steady movement from `from_s` to `until_s`.
    Ramp,
    /// A sine between the two times.
    Sine,
    /// Band-limited noise between the two times.
    Vibration,
}

/// What can go wrong.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum FaultKind {
    /// No light at all.
    BeamBlocked,
    /// One PSD (0 to 2 for A to C) sees no light.
    PsdDark {
        /// Which one.
        psd: u8,
    },
    /// One channel (0 to 8) stands at its rail.
    Clipped {
        /// Which one.
        channel: u8,
    },
    /// This fraction of the scans never leaves the board.
    Dropped {
        /// 0 to 1.
        fraction: f64,
    },
    /// This fraction of the scans is damaged on the way.
    Corrupted {
        /// 0 to 1.
        fraction: f64,
    },
    /// The board stops sending.
    Stalled,
    /// The stage ignores its commands.
    SteeringStuck,
    /// The laser's power is multiplied.
    LaserPower {
        /// By this.
        factor: f64,
    },
}

/// `[[twin.fault]]`: a fault from `at_s` on, for `for_s` seconds.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
pub struct Fault {
    /// When it starts.
    pub at_s: f64,
    /// How long it lasts; without, for ever.
    pub for_s: Option<f64>,
    /// What it is.
    #[serde(flatten)]
    pub kind: FaultKind,
}

/// `[realtime]`.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RealtimeConfig {
    /// `SCHED_FIFO` priority of the fast thread, 1 to 99; 0 leaves it an ordinary thread.
    pub priority: u8,
    /// CPU to which the fast thread is pinned.
    pub cpu: Option<usize>,
    /// Keep all memory in RAM.
    pub lock_memory: bool,
}

/// Form of the log lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

/// `[log]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LogConfig {
    /// What is logged: error, warn, info, debug, trace, or a filter such as `trifacet::twin=debug`.
    pub level: String,
    /// In which form.
    pub format: LogFormat,
}

impl Default for HeadConfig {
    fn default() -> Self {
        Self {
            psd_distance_mm: 250.0,
            psd_size_mm: 13.0,
            facet_angle_deg: 45.0,
            beam_diameter_mm: 0.46,
            beam_direction: None,
            a: FacetConfig::default(),
            b: FacetConfig::default(),
            c: FacetConfig::default(),
        }
    }
}

impl Default for AcquisitionConfig {
    fn default() -> Self {
        Self { source: SourceKind::Twin, rate_hz: 1000.0, serial: SerialConfig::default() }
    }
}

impl Default for SerialConfig {
    fn default() -> Self {
        Self { port: "/dev/ttyACM0".into(), baud: 921_600, latency_us: 0.0 }
    }
}

impl Default for ChannelsConfig {
    fn default() -> Self {
        Self {
            sum_threshold_v: 0.05,
            clip_limit: 0.999,
            power_mw_per_v: 0.0667,
            readback_um_per_v: 50.0,
            a: PsdChannels::default(),
            b: PsdChannels::default(),
            c: PsdChannels::default(),
        }
    }
}

impl Default for PsdChannels {
    fn default() -> Self {
        Self {
            amplifier: Amplifier::Normalised,
            full_scale_v: 10.0,
            gain: [1.0; 3],
            dark_v: [0.0; 3],
            correction: None,
        }
    }
}

impl Default for CenteringConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            target: Target::Apex,
            loop_delay_ms: 2.5,
            lag_ms: 0.5,
            kp: None,
            ki_per_s: None,
            lock_limit_um: 3.0,
            lock_time_ms: 50.0,
            lost_time_ms: 50.0,
        }
    }
}

impl Default for SteeringConfig {
    fn default() -> Self {
        Self {
            full_scale_um: 500.0,
            limit_um: 400.0,
            slew_mm_per_s: 50.0,
            park_um: [0.0; 2],
            on_exit: OnExit::Hold,
            lease_ms: 200,
            on_lease: OnExit::Hold,
        }
    }
}

impl Default for EstimationConfig {
    fn default() -> Self {
        Self {
            model: Model::Gaussian,
            average: 1,
            spot_noise_um: 1.08,
            power_noise: 1e-3,
            edge_margin_mm: 0.5,
            balance_limit: 0.05,
        }
    }
}

impl Default for PublishingConfig {
    fn default() -> Self {
        Self {
            tcp: Some(([127, 0, 0, 1], 7361).into()),
            tcp_clients: 64,
            tcp_queue: 1024,
            udp: vec![([127, 0, 0, 1], 7362).into()],
        }
    }
}

impl Default for TwinConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            mirror_radius_mm: 5.0,
            laser_mw: 0.8,
            laser_offset_um: [0.0; 2],
            spot_noise_um: 1.08,
            power_noise: 1e-3,
            converter_bits: 18,
            converter_range_v: 10.0,
            dark_v: [0.0; 9],
            channel_skew_us: 0.0,
            bow_um: 0.0,
            steering: TwinSteering::default(),
            motion: demo_motion(),
            fault: Vec::new(),
        }
    }
}

impl Default for TwinSteering {
    fn default() -> Self {
        Self { delay_ms: 1.0, lag_ms: 0.5, limit_um: 500.0, readback_noise_um: Some(0.1) }
    }
}

impl Default for LogConfig {
    fn default() -> Self {
        Self { level: "info".into(), format: LogFormat::Text }
    }
}

/// The mirror of the demo wanders slowly by some tens of micrometres and microradians on every axis.
fn demo_motion() -> Vec<Motion> {
    let wander = [
        (Axis::Tx, 40.0, 0.11),
        (Axis::Ty, 30.0, 0.07),
        (Axis::Tz, 20.0, 0.05),
        (Axis::Roll, 60.0, 0.09),
        (Axis::Pitch, 50.0, 0.13),
        (Axis::Yaw, 80.0, 0.04),
    ];
    wander
        .into_iter()
        .map(|(axis, amount, frequency_hz)| {
            let turn = matches!(axis, Axis::Roll | Axis::Pitch | Axis::Yaw);
            Motion {
                axis,
                amount_um: (!turn).then_some(amount),
                amount_urad: turn.then_some(amount),
                kind: MotionKind::Sine,
                from_s: 0.0,
                until_s: None,
                frequency_hz: Some(frequency_hz),
                high_hz: None,
                phase_deg: 0.0,
            }
        })
        .collect()
}
