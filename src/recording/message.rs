//! Messages of a recording: the fields of `msg/*.msg`, in the same order.

use serde::{Deserialize, Deserializer, Serialize};
use trifacet_core::centering::LoopState;
use trifacet_core::signals::{Identity, PsdState, Sample as Taken, Scan};
use trifacet_core::steering::StagePosition;
use trifacet_core::time::{Mono, NS_PER_S};
use trifacet_optics::Pose;
use trifacet_wire::channel::{Converter, Role};
use trifacet_wire::{LockState, PoseFrame, Status};

/// `builtin_interfaces/Time`: a time in UTC.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Time {
    sec: i32,
    nanosec: u32,
}

impl Time {
    /// From nanoseconds since 1970.
    pub fn new(ns: i64) -> Self {
        Self { sec: ns.div_euclid(NS_PER_S) as i32, nanosec: ns.rem_euclid(NS_PER_S) as u32 }
    }
}

/// A number without a meaning in its field.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0} is not a {1}")]
pub struct Unknown(u8, &'static str);

fn lock(number: u8) -> Result<LockState, Unknown> {
    LockState::ALL.get(usize::from(number)).copied().ok_or(Unknown(number, "lock state"))
}

/// `None` becomes NaN.
fn pair(known: Option<[f64; 2]>) -> [f64; 2] {
    known.unwrap_or([f64::NAN; 2])
}

fn known(pair: [f64; 2]) -> Option<[f64; 2]> {
    (!pair.iter().all(|x| x.is_nan())).then_some(pair)
}

/// `/trifacet/frame`.
#[derive(Debug, Serialize, Deserialize)]
pub struct Frame {
    stamp: Time,
    monotonic_ns: i64,
    session: u32,
    config: u32,
    sequence: u64,
    sample_index: u64,
    time_ns: i64,
    solve_delay_ns: u32,
    send_delay_ns: u32,
    status: u32,
    clock_quality: u16,
    lock: u8,
    iterations: u8,
    pose: [f64; 6],
    deviations: [f32; 6],
    beam_offset: [f32; 2],
    steering_residual: f32,
    averaged: u16,
    lost: u16,
    spots: [f32; 6],
    powers: [f32; 3],
    steering: [f32; 2],
    /// NaN in recordings of versions without it: their messages end before this field, which must remain the last.
    #[serde(deserialize_with = "systematic_if_recorded")]
    systematic: [f32; 6],
}

#[expect(clippy::unnecessary_wraps, reason = "the signature that serde expects")]
fn systematic_if_recorded<'de, D: Deserializer<'de>>(from: D) -> Result<[f32; 6], D::Error> {
    Ok(<[f32; 6]>::deserialize(from).unwrap_or([f32::NAN; 6]))
}

impl Frame {
    /// The message of a frame, with the monotonic time of its `time_ns`.
    pub fn new(frame: &PoseFrame, time: Mono) -> Self {
        Self {
            stamp: Time::new(frame.time_ns),
            monotonic_ns: time.0,
            session: frame.session,
            config: frame.config,
            sequence: frame.sequence,
            sample_index: frame.sample_index,
            time_ns: frame.time_ns,
            solve_delay_ns: frame.solve_delay_ns,
            send_delay_ns: frame.send_delay_ns,
            status: frame.status.0,
            clock_quality: frame.clock_quality,
            lock: frame.lock as u8,
            iterations: frame.iterations,
            pose: frame.pose,
            deviations: frame.deviations,
            beam_offset: frame.beam_offset,
            steering_residual: frame.steering_residual,
            averaged: frame.averaged,
            lost: frame.lost,
            spots: frame.spots,
            powers: frame.powers,
            steering: frame.steering,
            systematic: frame.systematic.unwrap_or([f32::NAN; 6]),
        }
    }

    /// The frame, and the monotonic time of its `time_ns`.
    ///
    /// # Errors
    /// The lock state is not a valid number.
    pub fn read(&self) -> Result<(PoseFrame, Mono), Unknown> {
        let frame = PoseFrame {
            session: self.session,
            config: self.config,
            sequence: self.sequence,
            sample_index: self.sample_index,
            time_ns: self.time_ns,
            solve_delay_ns: self.solve_delay_ns,
            send_delay_ns: self.send_delay_ns,
            status: Status(self.status),
            clock_quality: self.clock_quality,
            lock: lock(self.lock)?,
            iterations: self.iterations,
            pose: self.pose,
            deviations: self.deviations,
            beam_offset: self.beam_offset,
            steering_residual: self.steering_residual,
            averaged: self.averaged,
            lost: self.lost,
            spots: self.spots,
            powers: self.powers,
            steering: self.steering,
            systematic: (!self.systematic.iter().all(|x| x.is_nan())).then_some(self.systematic),
        };
        Ok((frame, Mono(self.monotonic_ns)))
    }
}

/// `/trifacet/sample`.
#[derive(Debug, Serialize, Deserialize)]
pub struct Sample {
    stamp: Time,
    monotonic_ns: i64,
    index: u64,
    time_sigma_ns: f64,
    lost: u32,
    unhandled: u32,
    output_railed: bool,
    lock: u8,
    codes: [i32; 16],
    spots: [f64; 6],
    powers: [f64; 3],
    psds: [u8; 3],
    steering: [f64; 2],
    commanded: [f64; 2],
}

impl Sample {
    /// The message of a sample that estimation is about to process.
    pub fn new(stamp: Time, scan: &Scan, sample: &Taken, steering: &LoopState) -> Self {
        Self {
            stamp,
            monotonic_ns: scan.time.0,
            index: scan.index,
            time_sigma_ns: scan.time_sigma_ns.unwrap_or(f64::NAN),
            lost: sample.lost,
            unhandled: sample.lost.saturating_sub(scan.lost),
            output_railed: scan.output_railed,
            lock: steering.lock as u8,
            codes: scan.codes,
            spots: sample.spots,
            powers: sample.powers,
            psds: sample.psds.map(|psd| psd as u8),
            steering: pair(sample.steering),
            commanded: pair(steering.position.map(Into::into)),
        }
    }

    /// The scan, the sample computed from it, and the state of the loop as estimation knew it.
    ///
    /// # Errors
    /// The lock state or the state of a PSD is not a valid number.
    pub fn read(&self) -> Result<(Scan, Taken, LoopState), Unknown> {
        let psd = |number| match number {
            0 => Ok(PsdState::Good),
            1 => Ok(PsdState::Low),
            2 => Ok(PsdState::Clipped),
            3 => Ok(PsdState::Frozen),
            _ => Err(Unknown(number, "PSD state")),
        };
        let [a, b, c] = self.psds;
        let scan = Scan {
            index: self.index,
            time: Mono(self.monotonic_ns),
            time_sigma_ns: Some(self.time_sigma_ns).filter(|sigma| !sigma.is_nan()),
            lost: self.lost.saturating_sub(self.unhandled),
            codes: self.codes,
            output_railed: self.output_railed,
            applied: None,
        };
        let sample = Taken {
            index: scan.index,
            time: scan.time,
            time_sigma_ns: scan.time_sigma_ns,
            lost: self.lost,
            spots: self.spots,
            powers: self.powers,
            psds: [psd(a)?, psd(b)?, psd(c)?],
            steering: known(self.steering),
            output_railed: scan.output_railed,
            applied: None,
            uncovered: false,
        };
        let steering =
            LoopState { lock: lock(self.lock)?, position: known(self.commanded).map(StagePosition) };
        Ok((scan, sample, steering))
    }
}

/// `/trifacet/silence`.
#[derive(Debug, Serialize, Deserialize)]
pub struct Silence {
    stamp: Time,
    monotonic_ns: i64,
    lock: u8,
    commanded: [f64; 2],
    why: String,
}

impl Silence {
    /// The message of a report that there are no samples.
    pub fn new(stamp: Time, time: Mono, steering: &LoopState, why: Option<&str>) -> Self {
        let commanded = pair(steering.position.map(Into::into));
        let why = why.unwrap_or_default().to_owned();
        Self { stamp, monotonic_ns: time.0, lock: steering.lock as u8, commanded, why }
    }

    /// The time, the state of the loop as estimation knew it, and why the source went down, if it did then.
    ///
    /// # Errors
    /// The lock state is not a valid number.
    pub fn read(self) -> Result<(Mono, LoopState, Option<String>), Unknown> {
        let steering =
            LoopState { lock: lock(self.lock)?, position: known(self.commanded).map(StagePosition) };
        Ok((Mono(self.monotonic_ns), steering, Some(self.why).filter(|why| !why.is_empty())))
    }
}

/// `/trifacet/lock`.
#[derive(Debug, Serialize, Deserialize)]
pub struct Lock {
    stamp: Time,
    monotonic_ns: i64,
    before: u8,
    after: u8,
    cause: String,
}

impl Lock {
    /// The message of a change.
    pub fn new(stamp: Time, time: Mono, [before, after]: [LockState; 2], cause: &str) -> Self {
        let [before, after] = [before, after].map(|state| state as u8);
        Self { stamp, monotonic_ns: time.0, before, after, cause: cause.to_owned() }
    }

    /// Time, states before and after, and cause.
    ///
    /// # Errors
    /// A lock state is not a valid number.
    pub fn read(self) -> Result<(Mono, [LockState; 2], String), Unknown> {
        Ok((Mono(self.monotonic_ns), [lock(self.before)?, lock(self.after)?], self.cause))
    }
}

/// `/trifacet/config`.
#[derive(Debug, Serialize, Deserialize)]
pub struct Config {
    /// Time of writing.
    pub stamp: Time,
    /// Version of the program.
    pub version: String,
    /// Identifier of the configuration, as in the frames.
    pub id: u32,
    /// The configuration in TOML.
    pub toml: String,
    /// Contents of the correction tables of PSD A, B and C; empty: no table.
    pub tables: (Vec<u8>, Vec<u8>, Vec<u8>),
    /// The calibration in force, in JSON; empty in recordings of versions without calibration records. This and the next
    /// field must remain the last, in this order: the messages of earlier versions end before them.
    #[serde(deserialize_with = "if_recorded")]
    pub calibration: String,
    /// What the calibration leaves unknown of poses; empty: nothing is known of it.
    #[serde(deserialize_with = "if_recorded")]
    pub spread: Vec<u8>,
}

/// The value; empty where the message ends before it.
#[expect(clippy::unnecessary_wraps, reason = "the signature that serde expects")]
fn if_recorded<'de, D: Deserializer<'de>, T: Deserialize<'de> + Default>(from: D) -> Result<T, D::Error> {
    Ok(T::deserialize(from).unwrap_or_default())
}

/// `/trifacet/source`.
#[derive(Debug, Serialize, Deserialize)]
pub struct Source {
    stamp: Time,
    name: String,
    rate_hz: f64,
    bits: u8,
    range_v: f64,
    roles: Vec<u8>,
    skew_ns: Vec<u32>,
    output_bits: u8,
    simulated: bool,
}

impl Source {
    /// The message of a source.
    pub fn new(stamp: Time, identity: &Identity) -> Self {
        let Converter { bits, range_v } = identity.converter;
        Self {
            stamp,
            name: identity.name.clone(),
            rate_hz: identity.rate_hz,
            bits,
            range_v,
            roles: identity.roles.iter().map(|role| role.number()).collect(),
            skew_ns: identity.skew_ns.clone(),
            output_bits: identity.output_bits,
            simulated: identity.simulated,
        }
    }

    /// The source.
    pub fn read(self) -> Identity {
        Identity {
            name: self.name,
            rate_hz: self.rate_hz,
            converter: Converter { bits: self.bits, range_v: self.range_v },
            roles: self.roles.into_iter().map(Role::of).collect(),
            skew_ns: self.skew_ns,
            output_bits: self.output_bits,
            simulated: self.simulated,
        }
    }
}

/// `/trifacet/keyframe`.
#[derive(Debug, Serialize, Deserialize)]
pub struct Keyframe {
    /// Time of writing.
    pub stamp: Time,
    /// Version of the program that can read `state`.
    pub version: String,
    /// Whether a source is up.
    pub source: bool,
    /// Last scan and state of the estimation.
    pub state: Vec<u8>,
}

/// `/trifacet/gap`.
#[derive(Debug, Serialize, Deserialize)]
pub struct Gap {
    /// End of the gap.
    pub stamp: Time,
    /// Number of missing entries; 0: unknown.
    pub entries: u64,
    /// Cause of the gap.
    pub reason: String,
}

/// `geometry_msgs/PoseWithCovarianceStamped`.
#[derive(Debug, Serialize)]
pub struct PoseStamped {
    stamp: Time,
    frame_id: &'static str,
    position: [f64; 3],
    orientation: [f64; 4],
    covariance: [[f64; 6]; 6],
}

impl PoseStamped {
    /// The message of a valid frame; `covariance` in m and rad, of roll, pitch and yaw.
    pub fn new(frame: &PoseFrame, covariance: &nalgebra::Matrix6<f64>) -> Self {
        let pose = Pose::from_array(frame.pose);
        // ROS expects small rotations about the fixed axes; `covariance` is of roll, pitch and yaw.
        let mut axes = nalgebra::Matrix6::identity();
        axes.fixed_view_mut::<3, 3>(3, 3).copy_from(&pose.euler_axes());
        let turned = axes * covariance * axes.transpose();
        let covariance = std::array::from_fn(|i| std::array::from_fn(|k| rounded(turned[(i, k)])));
        Self {
            stamp: Time::new(frame.time_ns),
            frame_id: "trifacet",
            position: pose.t.into(),
            orientation: quaternion(&pose),
            covariance,
        }
    }
}

/// Rounds to 1 part in 8000. A covariance is less accurate than that, and the file becomes a fifth smaller,
/// because the value stays the same from sample to sample.
fn rounded(x: f64) -> f64 {
    const DROPPED: u32 = 0x7ff;
    f64::from(f32::from_bits((x as f32).to_bits().saturating_add(DROPPED / 2 + 1) & !DROPPED))
}

/// The rotation as a quaternion: x, y, z, w.
fn quaternion(pose: &Pose) -> [f64; 4] {
    let q = nalgebra::UnitQuaternion::from_euler_angles(pose.roll, pose.pitch, pose.yaw);
    [q.i, q.j, q.k, q.w]
}

#[cfg(test)]
mod tests {
    use trifacet_optics::{Mat3, Vec3};

    use super::*;

    #[test]
    fn the_quaternion_is_the_rotation() {
        let pose = Pose { t: Vec3::zeros(), roll: 0.3, pitch: -0.2, yaw: 1.1 };
        let [i, j, k, w] = quaternion(&pose);
        let q = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, i, j, k));
        let difference: Mat3 = q.to_rotation_matrix().matrix() - pose.rotation();
        assert!(difference.norm() < 1e-14, "{difference}");
    }

    #[test]
    fn a_covariance_is_rounded_to_the_stated_accuracy() {
        for x in [1.0, -3.7e-13, 2.999e-12, 0.0, 1e-300] {
            assert!((rounded(x) - x).abs() <= x.abs() / 8000.0 + 1e-44, "{x}");
        }
    }

    #[test]
    fn times_before_1970_have_positive_nanoseconds() {
        assert_eq!(Time::new(-1), Time { sec: -1, nanosec: 999_999_999 });
        assert_eq!(Time::new(5 * NS_PER_S + 7), Time { sec: 5, nanosec: 7 });
    }
}
