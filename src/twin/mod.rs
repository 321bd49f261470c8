//! The digital twin of the sensor: a moving mirror, a laser on a steering stage, detectors, a converter, and
//! faults. The same seed gives the same scans.
//!
//! [`Twin`] is pure: it computes scan after scan for the times `index / rate`, as fast as it is called.
//! [`TwinSource`] runs it in real time. The board emulator and `trifacet simulate` also use it.
//!
//! - [`trajectory`]: the motion of the mirror. [`moves`]: its moves by command.
//! - [`stage`], [`outputs`]: the response of the laser to its commands.
//! - [`pointing`]: the drift of the laser.
//! - [`scene`]: the light on the PSDs.
//! - [`own_head`]: the true head, if it is not the one that the estimator believes; [`distortion`]: that of its PSDs.
//! - [`temperature`]: the temperature of the head, and what it changes.
//! - [`electronics`]: from light to codes.
//! - [`faults`]: injected faults.
//! - [`emulator`]: a board with the twin behind it; [`pty`], [`board_socket`]: its serial line, and its socket on a network.
//! - [`labjack`]: a LabJack T7 with the twin behind it.

pub mod applied;
pub mod board_socket;
pub mod board_state;
pub mod distortion;
pub mod electronics;
pub mod emulator;
pub mod faults;
pub mod labjack;
pub mod moves;
pub mod outputs;
pub mod own_head;
pub mod pointing;
pub mod pty;
pub mod scene;
pub mod source;
pub mod stage;
pub mod temperature;
pub mod trajectory;

pub use board_socket::{BoardSocket, ListenAt};
use electronics::{Electronics, Noise};
pub use emulator::Emulator;
pub use faults::Fate;
use faults::{Active, Faults};
pub use moves::{MirrorMove, MoveRequest};
pub use outputs::{OUTPUT_BITS, Outputs};
use own_head::OwnHead;
use pointing::Pointing;
pub use pty::Pty;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use scene::Lighting;
pub use scene::{Scene, Spot};
pub use source::TwinSource;
use stage::StageSim;
use temperature::Temperature;
use trajectory::Trajectory;
use trifacet_core::signals::{Identity, Scan};
use trifacet_core::time::Mono;
use trifacet_optics::Pose;
use trifacet_wire::channel::{MAX_CHANNELS, Role, SIGNALS};

use crate::config::{Config, Fault, FaultKind};

/// The highest rate of the twin, scans per second.
pub const MAX_RATE_HZ: f64 = 20_000.0;

/// Error: the twin cannot be created, or a fault cannot be injected.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{key}: {reason}")]
pub struct TwinError {
    /// The key in the configuration.
    pub key: String,
    /// The error, and the allowed values.
    pub reason: String,
}

impl TwinError {
    fn new(key: impl Into<String>, reason: impl Into<String>) -> Self {
        Self { key: key.into(), reason: reason.into() }
    }
}

/// One scan of the twin, with the true state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwinScan {
    /// Counts every scan from 0.
    pub index: u64,
    /// Time of the scan: `index / rate`, seconds since the start of the twin.
    pub t_s: f64,
    /// The same time by the clock of the board.
    pub clock_s: f64,
    /// The codes; only the first `Identity::roles.len()` are used.
    pub codes: [i32; MAX_CHANNELS],
    /// Whether the scan arrives. The codes are valid also for a scan that does not arrive.
    pub fate: Fate,
    /// The board sends in bursts at this interval, seconds; 0: at once.
    pub burst_s: f64,
    /// The stage is at one of its limits.
    pub output_railed: bool,
    /// Mirror, laser and light at `t_s`, before faults of detection.
    pub truth: Scene,
}

impl TwinScan {
    /// The scan as received at this time, if it arrives.
    pub fn arrived(&self, time: Mono, lost: u32) -> Option<Scan> {
        (self.fate == Fate::Sent).then_some(Scan {
            index: self.index,
            time,
            time_sigma_ns: Some(0.0),
            lost,
            codes: self.codes,
            output_railed: self.output_railed,
            applied: None,
        })
    }
}

/// The digital twin.
#[derive(Clone, Debug)]
pub struct Twin {
    rate_hz: f64,
    skew_s: f64,
    identity: Identity,
    trajectory: Trajectory,
    laser_rest: [f64; 2],
    pointing: Pointing,
    /// Motion of the laser per motion of the stage axes.
    matrix: [[f64; 2]; 2],
    stage: StageSim,
    outputs: Outputs,
    lighting: Lighting,
    electronics: Electronics,
    temperature: Option<Temperature>,
    faults: Faults,
    noise: Pcg64,
    fates: Pcg64,
    index: u64,
    /// Codes of the previous scan.
    codes: [i32; MAX_CHANNELS],
    /// By how much the clock of the board is ahead, seconds.
    clock_ahead_s: f64,
}

impl Twin {
    /// The twin of this configuration, at rest before its first scan.
    ///
    /// # Errors
    /// A value of the configuration is not possible; the error names its key.
    pub fn new(config: &Config) -> Result<Self, TwinError> {
        let (twin, seed) = (&config.twin, config.twin.seed);
        let rate_hz = config.acquisition.rate_hz;
        check(config)?;
        let temperature = twin.temperature.as_ref().map(|config| Temperature::new(config, seed));
        let (lighting, electronics) = optics_and_electronics(config, temperature.as_ref())?;
        let identity = identity(config, &electronics);
        let steering = &twin.steering;
        Ok(Self {
            rate_hz,
            skew_s: twin.channel_skew_us * 1e-6,
            identity,
            trajectory: Trajectory::new(&twin.motion, seed)?,
            laser_rest: twin.laser_offset_um.map(|um| um * 1e-6),
            pointing: Pointing::new(twin.pointing_um * 1e-6, twin.pointing_s, 1.0 / rate_hz, random(seed, 2)),
            matrix: steering.matrix,
            stage: StageSim::new(steering.delay_ms * 1e-3, steering.lag_ms * 1e-3, steering.limit_um * 1e-6),
            outputs: Outputs::new(&config.steering),
            lighting,
            electronics,
            temperature,
            faults: Faults::new(&twin.fault)?,
            noise: random(seed, 0),
            fates: random(seed, 1),
            index: 0,
            codes: [0; MAX_CHANNELS],
            clock_ahead_s: 0.0,
        })
    }

    /// The identity of the twin as a source.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// The steering outputs of the board: codes to metres, range, leases and parking position.
    pub fn outputs(&self) -> &Outputs {
        &self.outputs
    }

    /// Index of the next scan.
    pub fn next_index(&self) -> u64 {
        self.index
    }

    /// Time of the next scan, seconds since the start of the twin.
    pub fn next_s(&self) -> f64 {
        self.index as f64 / self.rate_hz
    }

    /// Power of the whole beam in watts, without faults.
    pub fn laser_w(&self) -> f64 {
        self.electronics.laser_w()
    }

    /// A steering command in output codes, given at `t_s` seconds since the start of the twin. Range and
    /// lease are checked by [`Outputs`].
    pub fn steer(&mut self, codes: [i32; 2], t_s: f64) {
        self.stage.command(self.outputs.metres(codes), t_s);
    }

    /// The id that the board acknowledges for a command with this id; `None` if it sends no acknowledgement.
    pub fn acknowledged(&self, id: u32) -> Option<u32> {
        self.faults.active(self.next_s()).acknowledged(id)
    }

    /// Injects a fault from the next scan on, for `for_s` seconds or, with `None`, without end.
    ///
    /// # Errors
    /// A value of the fault is out of range.
    pub fn inject(&mut self, kind: FaultKind, for_s: Option<f64>) -> Result<(), TwinError> {
        self.faults.inject(Fault { at_s: self.next_s(), for_s, kind })
    }

    /// Holds the mirror at this pose from the next scan on, instead of its configured motion.
    pub fn place(&mut self, pose: Pose) {
        self.trajectory = Trajectory::rest(pose);
    }

    /// Moves the mirror from where it is in the next scan to this pose, within `over_s` seconds, and holds it
    /// there; its configured motion ends. Returns the time of arrival, seconds since the start of the twin.
    pub fn travel(&mut self, to: Pose, over_s: f64) -> f64 {
        let now_s = self.next_s();
        self.trajectory = Trajectory::travel(&self.trajectory.pose(now_s), &to, now_s, over_s);
        now_s + over_s
    }

    /// Takes the next scan.
    pub fn next_scan(&mut self) -> TwinScan {
        let (index, t_s) = (self.index, self.next_s());
        let clock_s = t_s + self.clock_ahead_s;
        self.index += 1;
        let mut faults = self.faults.active(t_s);
        for (shift, drift) in faults.shift.iter_mut().zip(self.pointing.advance()) {
            *shift += drift;
        }
        let noise = Noise::draw(&mut self.noise).louder(faults.noise);
        let fate = faults.fate(self.fates.random(), self.fates.random());
        let mut moment = self.moment(t_s, &faults);
        let truth = moment.scene;
        let mut codes = [0; MAX_CHANNELS];
        for (channel, code) in codes.iter_mut().enumerate().take(self.identity.roles.len()) {
            if channel > 0 && self.skew_s > 0.0 {
                let t_s = t_s + channel as f64 * self.skew_s;
                faults.power = self.faults.active(t_s).power; // the power may change within a scan
                moment = self.moment(t_s, &faults);
            }
            *code = self.code(channel, &moment, &faults, &noise);
        }
        for (channel, _) in faults.frozen.iter().enumerate().filter(|(_, frozen)| **frozen) {
            codes[channel] = self.codes[channel];
        }
        if faults.readback_frozen {
            for (channel, _) in readbacks(&self.identity.roles) {
                codes[channel] = self.codes[channel];
            }
        }
        self.codes = codes;
        self.clock_ahead_s += (faults.clock - 1.0) / self.rate_hz;
        let (burst_s, output_railed) = (faults.burst_s, self.stage.railed());
        TwinScan { index, t_s, clock_s, codes, fate, burst_s, output_railed, truth }
    }

    fn moment(&mut self, t_s: f64, faults: &Active) -> Moment {
        let stage = self.stage.advance(t_s, faults.stuck);
        let moved = self.matrix.map(|row| row[0] * stage[0] + row[1] * stage[1]);
        let laser = [0, 1].map(|i| self.laser_rest[i] + faults.shift[i] + moved[i]);
        let kelvin = self.temperature.as_ref().map_or(0.0, |temperature| temperature.kelvin(t_s));
        Moment { scene: self.lighting.scene(self.trajectory.pose(t_s), laser, kelvin), stage, kelvin }
    }

    fn code(&self, channel: usize, moment: &Moment, faults: &Active, noise: &Noise) -> i32 {
        match self.identity.roles[channel] {
            Role::Steering(axis) => {
                let axis = usize::from(axis);
                return self.electronics.readback(axis, moment.stage[axis], noise);
            }
            Role::Auxiliary => return self.electronics.temperature(moment.kelvin),
            Role::U(_) | Role::V(_) | Role::Sum(_) => {}
        }
        if faults.clipped[channel] {
            return self.electronics.rail();
        }
        let mut spots = moment.scene.spots;
        for (spot, dark) in spots.iter_mut().zip(faults.dark) {
            *spot = spot.filter(|_| !dark);
        }
        self.electronics.signal(channel, &spots, [faults.power, faults.ambient], noise, moment.kelvin)
    }
}

/// The state at one moment.
#[derive(Clone, Copy, Debug)]
struct Moment {
    /// Mirror, laser and light.
    scene: Scene,
    /// Position of the stage that moves the laser, metres.
    stage: [f64; 2],
    /// Temperature after the start, kelvin.
    kelvin: f64,
}

/// The channels of the readback.
fn readbacks(roles: &[Role]) -> impl Iterator<Item = (usize, &Role)> {
    roles.iter().enumerate().filter(|(_, role)| matches!(role, Role::Steering(_)))
}

/// The true head: that of the configuration, or one of its own.
fn optics_and_electronics(
    config: &Config,
    temperature: Option<&Temperature>,
) -> Result<(Lighting, Electronics), TwinError> {
    let radius = config.twin.mirror_radius_mm * 1e-3;
    let own = OwnHead::of(config)?;
    let head = match &own {
        Some(own) => own.head.clone(),
        None => config.head.build().map_err(|e| TwinError::new("head", e.to_string()))?,
    };
    let mut lighting =
        own.as_ref().map_or_else(|| Lighting::new(&head, radius), |own| Lighting::of(own, radius));
    let mut electronics = Electronics::new(config, lighting.half_sizes());
    if let Some(own) = &own {
        electronics = electronics.with_errors(&own.psds);
    }
    if let Some(temperature) = temperature {
        lighting = lighting.warming(head, temperature.clone());
        electronics = electronics.warming(temperature.clone());
    }
    Ok((lighting, electronics))
}

/// An independent random stream for each use of a seed.
fn random(seed: u64, stream: u64) -> Pcg64 {
    Pcg64::seed_from_u64(seed ^ stream.wrapping_mul(0x9E37_79B9_7F4A_7C15))
}

/// The name of the twin, which states whether its head is the one that the estimator believes.
fn name(config: &Config) -> String {
    let own = match &config.twin.tolerances {
        Some(tolerances) => format!(", with a head of its own, seed {}", tolerances.seed),
        None if config.twin.has_own_head() => ", with a head of its own".into(),
        None => String::new(),
    };
    format!("digital twin, seed {}{own}", config.twin.seed)
}

fn identity(config: &Config, electronics: &Electronics) -> Identity {
    let mut roles = SIGNALS.to_vec();
    if config.twin.steering.readback_noise_um.is_some() {
        roles.extend([Role::Steering(0), Role::Steering(1)]);
    }
    if config.twin.temperature.is_some() {
        roles.push(Role::Auxiliary);
    }
    let skew = |channel| (config.twin.channel_skew_us * 1e3 * channel as f64).round() as u32;
    Identity {
        name: name(config),
        rate_hz: config.acquisition.rate_hz,
        converter: electronics.converter(),
        skew_ns: (0..roles.len()).map(skew).collect(),
        roles,
        output_bits: OUTPUT_BITS,
        simulated: true,
    }
}

/// Checks the values that would break the twin. The useful ranges are checked with the configuration, if it
/// comes from a file.
fn check(config: &Config) -> Result<(), TwinError> {
    let bits = config.twin.converter_bits;
    let rate_hz = config.acquisition.rate_hz;
    if !(rate_hz > 0.0 && rate_hz <= MAX_RATE_HZ) {
        let reason = format!("must be above 0 and at most {MAX_RATE_HZ} with the twin, not {rate_hz}");
        return Err(TwinError::new("acquisition.rate_hz", reason));
    }
    if !(8..=24).contains(&bits) {
        let reason = format!("must be from 8 to 24, not {bits}");
        return Err(TwinError::new("twin.converter_bits", reason));
    }
    let channels = config.twin.channel_count();
    if config.twin.channel_skew_us * 1e-6 * (channels - 1) as f64 * rate_hz >= 1.0 {
        let reason = format!("{channels} channels must fit into one sample period");
        return Err(TwinError::new("twin.channel_skew_us", reason));
    }
    Ok(())
}

#[cfg(test)]
mod tests;
