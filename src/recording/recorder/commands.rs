//! What people and faults want of the recorder.

use tokio::sync::oneshot;
use trifacet_core::time::{Clock, Mono, NS_PER_S};

use super::{Recorder, SECOND_NS};
use crate::clock::SystemClock;
use crate::exit::{self, Failure};
use crate::recording::handle::RecorderCommand;

/// How long the end of a file may take: then it is said that it has not come yet.
const CLOSE_TIMEOUT_NS: i64 = 4 * SECOND_NS;

/// Somebody waits for the end of the file.
pub(super) struct Stopping {
    reply: oneshot::Sender<Result<(), Failure>>,
    deadline: Mono,
    /// What went wrong with it.
    pub failed: Option<String>,
}

impl Recorder {
    /// Does what is asked; while somebody waits for the end of a file, nothing else.
    pub(super) fn obey(&mut self) {
        while self.stopping.is_none()
            && let Ok((command, reply)) = self.asked.try_recv()
        {
            let cannot = |why| Failure::new(exit::IO, why);
            let done = match command {
                RecorderCommand::Start => self.begin(None).map_err(cannot),
                RecorderCommand::Stop if self.wanted => {
                    self.until = Some(self.latest);
                    let deadline = SystemClock.now() + CLOSE_TIMEOUT_NS;
                    self.stopping = Some(Stopping { reply, deadline, failed: None });
                    return;
                }
                RecorderCommand::Stop => Ok(()),
                RecorderCommand::Trigger if self.trigger.is_some() => {
                    self.triggered("asked for").map_err(cannot)
                }
                RecorderCommand::Trigger => {
                    let why = "only with recording.mode = \"on-fault\"; to record from now on: record start";
                    Err(Failure::new(exit::DATA, why))
                }
            };
            // Who does not wait any more does not need it.
            let _ = reply.send(done);
        }
    }

    /// Tells who waits for the end of the file that it is on the disk, or why not.
    pub(super) fn answer(&mut self, now: Mono) {
        let Some(stopping) = &self.stopping else { return };
        let goes_on = self.until.is_some_and(|until| until > self.latest);
        let done = match &stopping.failed {
            None if !self.wanted && !self.disk.closing() => Ok(()),
            Some(why) if !self.wanted => Err(Failure::new(exit::IO, why)),
            _ if goes_on => {
                let why =
                    "a fault has just begun: it is recorded, for recording.after_s; stop again to end that";
                Err(Failure::new(exit::DATA, why))
            }
            _ if now >= stopping.deadline => {
                Err(Failure::new(exit::IO, "the recording is being ended, but is not yet on the disk"))
            }
            _ => return,
        };
        if let Some(stopping) = self.stopping.take() {
            // Who does not wait any more does not need it.
            let _ = stopping.reply.send(done);
        }
    }

    /// Wants a recording, until then.
    pub(super) fn begin(&mut self, until: Option<Mono>) -> Result<(), String> {
        if self.output.is_none() {
            self.resume()?;
        }
        (self.wanted, self.until) = (true, until);
        Ok(())
    }

    /// Something went wrong: so long after it there is a recording.
    pub(super) fn triggered(&mut self, why: &str) -> Result<(), String> {
        let until = SystemClock.now() + (self.config.after_s * NS_PER_S as f64) as i64;
        if self.wanted {
            tracing::debug!(why, "this is recorded already");
            self.until = self.until.map(|_| until);
            return self.fault.as_ref().map_or(Ok(()), |fault| Err(fault.reason.clone()));
        }
        tracing::info!(why, "a recording begins, with what was before");
        let begun = self.begin(Some(until));
        if let Err(reason) = &begun {
            // Until then it is tried again.
            (self.wanted, self.until) = (true, Some(until));
            self.suffer(reason.clone());
        }
        begun
    }
}
