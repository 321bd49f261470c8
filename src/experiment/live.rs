//! Takes readings from a running daemon through its TCP stream.

use std::time::Duration;

use tokio::time::timeout;
use trifacet_wire::{LockState, Status};

use super::observation::{Mean, Observation, at_rest};
use super::static_record::parted;
use super::twin::UnusablePose;
use crate::client::{Client, ClientError, Endpoint, Message, PoseFrame};

/// The daemon sends a message at least once a second. After this time without one, the link has failed.
const SILENCE: Duration = Duration::from_secs(3);
/// Time for which all frames must have been usable before one is taken, nanoseconds. The operator has then
/// released the stage, and the filters have settled.
const SETTLE_NS: i64 = 600_000_000;
/// Time without a usable frame after which an error is reported, seconds; at least five frame periods.
const FRAME_TIMEOUT_S: f64 = 5.0;
const FRAME_TIMEOUT_PERIODS: f64 = 5.0;

/// Why there is no reading.
#[derive(Debug, thiserror::Error)]
pub enum Trouble {
    /// There is no connection to the daemon.
    #[error("{0}")]
    Lost(String),
    /// The daemon sends frames, but their poses are not usable.
    #[error("no usable pose for {timeout_s:.0} s: {why}")]
    NoPose {
        /// The time limit, seconds.
        timeout_s: f64,
        /// Why the last frame was not usable.
        why: UnusablePose,
    },
    /// The readings do not belong together: a gap, or a change of the configuration.
    #[error("{0}")]
    Parted(String),
}

/// The frame stream of a daemon.
#[derive(Debug)]
pub struct DaemonStream {
    client: Client,
    endpoint: Endpoint,
    /// Frames per second according to the descriptor; 0 before it arrives.
    rate_hz: f64,
}

impl DaemonStream {
    /// Connects to a daemon.
    ///
    /// # Errors
    /// Fails if the daemon does not answer or refuses the connection.
    pub async fn connect(endpoint: &Endpoint) -> Result<Self, ClientError> {
        let silent = |_| ClientError::Refused(format!("{endpoint} does not answer"));
        let client = timeout(SILENCE, Client::connect(endpoint)).await.map_err(silent)??;
        Ok(Self { client, endpoint: endpoint.clone(), rate_hz: 0.0 })
    }

    /// Discards frames until another future is ready.
    ///
    /// # Errors
    /// Fails if the stream ends before.
    pub async fn until<T>(&mut self, other: impl Future<Output = T>) -> Result<T, Trouble> {
        tokio::pin!(other);
        loop {
            tokio::select! {
                biased;
                done = &mut other => return Ok(done),
                frame = self.frame() => drop(frame?),
            }
        }
    }

    /// Takes `count` readings, each the mean of `average` poses. After each reading, `taken` is called with
    /// all readings so far.
    ///
    /// # Errors
    /// Fails if the stream ends, if there is no usable pose for 5 s and five frame periods, or if `taken` returns an error.
    pub async fn readings(
        &mut self,
        count: u32,
        average: u32,
        mut taken: impl FnMut(&[Observation]) -> Result<(), Trouble>,
    ) -> Result<Vec<Observation>, Trouble> {
        let (mut readings, mut mean) = (Vec::new(), Mean::default());
        let (mut calm_since, mut vain_since, mut config) = (None, None, None);
        while readings.len() < count as usize {
            let frame = self.frame().await?;
            let now = frame.time_ns;
            if let Some(why) = objection(&frame) {
                (calm_since, mean) = (None, Mean::default());
                let timeout_s = FRAME_TIMEOUT_S.max(FRAME_TIMEOUT_PERIODS / self.rate_hz);
                if (now - *vain_since.get_or_insert(now)) as f64 > timeout_s * 1e9 {
                    return Err(Trouble::NoPose { timeout_s, why });
                }
            } else if now - *calm_since.get_or_insert(now) >= SETTLE_NS {
                vain_since = None;
                if config.replace(frame.config) != Some(frame.config) {
                    mean = Mean::default();
                }
                if let Some(reading) = mean.push(&look(&frame), average) {
                    readings.push(reading);
                    taken(&readings)?;
                }
            }
        }
        Ok(readings)
    }

    /// Number of poses in a time of `seconds`.
    ///
    /// # Errors
    /// Fails if the stream ends.
    pub async fn poses(&mut self, seconds: f64) -> Result<u64, Trouble> {
        self.frame().await?; // the descriptor precedes the first frame
        Ok((seconds * self.rate_hz) as u64)
    }

    /// Takes a record of `seconds` seconds with the mirror at rest.
    ///
    /// # Errors
    /// Fails like [`DaemonStream::readings`], or if the record has a gap or the configuration of the sensor
    /// changes.
    pub async fn rest(&mut self, seconds: f64) -> Result<Vec<Observation>, Trouble> {
        let poses = self.poses(seconds).await?;
        let average = at_rest(poses);
        let period_s = f64::from(average) / self.rate_hz;
        let follows = |looks: &[Observation]| match looks {
            [.., last, next] => parted(last, next, period_s).map_or(Ok(()), |why| Err(Trouble::Parted(why))),
            _ => Ok(()),
        };
        self.readings(poses as u32 / average, average, follows).await
    }

    async fn frame(&mut self) -> Result<PoseFrame, Trouble> {
        let lost = |what: String| Trouble::Lost(format!("{}: {what}", self.endpoint));
        loop {
            match timeout(SILENCE, self.client.next()).await {
                Ok(Ok(Message::Pose(frame))) => return Ok(frame),
                Ok(Ok(Message::Descriptor(descriptor))) => self.rate_hz = descriptor.rate_hz,
                Ok(Ok(_)) => {}
                Ok(Err(e)) => return Err(lost(e.to_string())),
                Err(_) => return Err(lost(format!("nothing received for {} s", SILENCE.as_secs()))),
            }
        }
    }
}

/// Why a frame is not usable. `None`: it is usable.
fn objection(frame: &PoseFrame) -> Option<UnusablePose> {
    let counts = frame.status.has(Status::POSE_VALID) && frame.lock == LockState::Locked;
    (!counts).then_some(UnusablePose { status: frame.status, lock: frame.lock })
}

fn look(frame: &PoseFrame) -> Observation {
    Observation {
        time_ns: frame.time_ns,
        pose: frame.pose,
        sigmas: frame.deviations,
        averaged: frame.averaged.into(),
        config: frame.config,
        status: frame.status,
    }
}
