//! Executes commands to the recorder, and reacts to faults.

use std::sync::Arc;

use tokio::sync::oneshot;
use trifacet_core::time::{Clock, Mono, NS_PER_S};

use super::fault_reason::FaultReason;
use super::{Recorder, SECOND_NS};
use crate::clock::SystemClock;
use crate::exit::{self, Failure};
use crate::recording::handle::RecorderCommand;

/// Longest wait for the end of a file. After that the command fails; the file is still finished.
const CLOSE_TIMEOUT_NS: i64 = 4 * SECOND_NS;

/// A stop command that waits for the end of the file.
pub(super) struct Stopping {
    reply: oneshot::Sender<Result<(), Failure>>,
    deadline: Mono,
    /// Why the file could not be finished.
    pub failed: Option<Arc<FaultReason>>,
}

impl Recorder {
    /// Executes waiting commands. While a command waits for the end of a file, others wait.
    pub(super) fn obey(&mut self) {
        while self.stopping.is_none()
            && let Ok((command, reply)) = self.asked.try_recv()
        {
            let cannot = |why: &FaultReason| Failure::new(exit::IO, why.to_string());
            let done = match command {
                RecorderCommand::Start => self.begin(None).map_err(|why| cannot(&why)),
                RecorderCommand::Stop if self.wanted => {
                    self.until = Some(self.latest);
                    let deadline = SystemClock.now() + CLOSE_TIMEOUT_NS;
                    self.stopping = Some(Stopping { reply, deadline, failed: None });
                    return;
                }
                RecorderCommand::Stop => Ok(()),
                RecorderCommand::Trigger if self.trigger.is_some() => {
                    self.triggered("requested").map_err(|why| cannot(&why))
                }
                RecorderCommand::Trigger => {
                    let why = "this needs recording.mode = \"on-fault\"; to record from now on: record start";
                    Err(Failure::new(exit::DATA, why))
                }
            };
            // A closed channel means that the caller does not wait any more.
            let _ = reply.send(done);
        }
    }

    /// Replies to a stop command once the file is on disk, or with the reason why it is not.
    pub(super) fn answer(&mut self, now: Mono) {
        let Some(stopping) = &self.stopping else { return };
        let goes_on = self.until.is_some_and(|until| until > self.latest);
        let done = match &stopping.failed {
            None if !self.wanted && !self.disk.closing() => Ok(()),
            Some(why) if !self.wanted => Err(Failure::new(exit::IO, why.to_string())),
            _ if goes_on => {
                let why =
                    "a fault has just begun and is recorded for recording.after_s; stop again to end this";
                Err(Failure::new(exit::DATA, why))
            }
            _ if now >= stopping.deadline => {
                Err(Failure::new(exit::IO, "the recording is being finished, but is not on disk yet"))
            }
            _ => return,
        };
        if let Some(stopping) = self.stopping.take() {
            // A closed channel means that the caller does not wait any more.
            let _ = stopping.reply.send(done);
        }
    }

    /// Starts a recording, until the given time if there is one.
    pub(super) fn begin(&mut self, until: Option<Mono>) -> Result<(), FaultReason> {
        if self.output.is_none() {
            self.resume()?;
        }
        (self.wanted, self.until) = (true, until);
        Ok(())
    }

    /// Handles a fault: records until `recording.after_s` after it.
    pub(super) fn triggered(&mut self, why: &str) -> Result<(), Arc<FaultReason>> {
        let until = SystemClock.now() + (self.config.after_s * NS_PER_S as f64) as i64;
        if self.wanted {
            tracing::debug!(why, "already recording");
            self.until = self.until.map(|_| until);
            return self.fault.as_ref().map_or(Ok(()), |fault| Err(Arc::clone(&fault.reason)));
        }
        tracing::info!(why, "recording started, with the data before the trigger");
        let begun = self.begin(Some(until)).map_err(Arc::new);
        if let Err(reason) = &begun {
            // Retried until the end of the recording.
            (self.wanted, self.until) = (true, Some(until));
            self.suffer(Arc::clone(reason));
        }
        begun
    }
}
