//! Readings from a running daemon, through its TCP stream.

use std::time::Duration;

use tokio::time::timeout;
use trifacet_wire::{LockState, Status};

use super::observation::{Mean, Observation, at_rest};
use super::static_record::parted;
use super::twin::why_not;
use crate::client::{Client, ClientError, Endpoint, Message, PoseFrame};

/// A daemon says something each second. After this long without a word the link is dead.
const SILENCE: Duration = Duration::from_secs(3);
/// Frames must count for so long, one after the other, before one is taken: the hand has left the stage, and what it did
/// is no longer taken for noise.
const SETTLE_NS: i64 = 600_000_000;
/// Without a frame that counts for so long, something is to be done about it.
const FRAME_TIMEOUT_NS: i64 = 5_000_000_000;

/// Why there is no reading.
#[derive(Debug, thiserror::Error)]
pub enum Trouble {
    /// The daemon is gone, or was never there.
    #[error("{0}")]
    Lost(String),
    /// It is there, and its poses do not count.
    #[error("no pose to count on for 5 s: {0}")]
    NoPose(String),
    /// The readings do not belong together.
    #[error("{0}")]
    Parted(String),
}

/// The stream of a daemon.
#[derive(Debug)]
pub struct DaemonStream {
    client: Client,
    endpoint: Endpoint,
    /// Frames a second, once the daemon has told.
    rate_hz: f64,
}

impl DaemonStream {
    /// Connects to a daemon.
    ///
    /// # Errors
    /// As the client has it.
    pub async fn connect(endpoint: &Endpoint) -> Result<Self, ClientError> {
        let silent = |_| ClientError::Refused(format!("{endpoint} does not answer"));
        let client = timeout(SILENCE, Client::connect(endpoint)).await.map_err(silent)??;
        Ok(Self { client, endpoint: endpoint.clone(), rate_hz: 0.0 })
    }

    /// Lets frames go by until something else has come.
    ///
    /// # Errors
    /// The stream has ended before.
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

    /// The next so many readings, each the mean of so many poses; `taken` sees all that there are after each.
    ///
    /// # Errors
    /// The stream has ended, its poses do not count, or `taken` objects.
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
                if now - *vain_since.get_or_insert(now) > FRAME_TIMEOUT_NS {
                    return Err(Trouble::NoPose(why));
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

    /// Poses in so many seconds.
    ///
    /// # Errors
    /// The stream has ended.
    pub async fn poses(&mut self, seconds: f64) -> Result<u64, Trouble> {
        self.frame().await?; // the descriptor comes before it
        Ok((seconds * self.rate_hz) as u64)
    }

    /// The mirror at rest for so many seconds.
    ///
    /// # Errors
    /// As [`DaemonStream::readings`]; or there is a hole in the record, or the sensor was tared meanwhile.
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
                Err(_) => return Err(lost(format!("no sign of life for {} s", SILENCE.as_secs()))),
            }
        }
    }
}

/// Why a frame does not count, if it does not.
fn objection(frame: &PoseFrame) -> Option<String> {
    let counts = frame.status.has(Status::POSE_VALID) && frame.lock == LockState::Locked;
    (!counts).then(|| why_not(frame.status, frame.lock))
}

fn look(frame: &PoseFrame) -> Observation {
    Observation {
        time_ns: frame.time_ns,
        pose: frame.pose,
        deviations: frame.deviations,
        averaged: frame.averaged.into(),
        config: frame.config,
        status: frame.status,
    }
}
