//! The two steering outputs of the board or the twin: commands become output codes, on the connection of the
//! samples.
//!
//! The board handles the lease: it holds or parks on its own when commands stop. The readback is part of the
//! samples.

use std::sync::Arc;

use tokio::sync::watch;
use trifacet_core::signals::Identity;
use trifacet_core::steering::{Command, codes};
use trifacet_wire::actuator::{Ack, OutputCommand};

use super::{Driver, StageEvent};

/// State of the outputs, as reported by the source.
#[derive(Clone, Debug, Default)]
pub struct Answers {
    /// The source at its last `Up` event.
    pub source: Option<Arc<Identity>>,
    /// The last acknowledgement.
    pub ack: Option<Ack>,
}

/// The outputs on the side of the source.
#[derive(Debug)]
pub struct OutputLink {
    /// Commands of the driver.
    pub commands: watch::Receiver<Option<OutputCommand>>,
    /// State of the outputs, for the driver.
    pub answers: watch::Sender<Answers>,
}

/// A driver for outputs whose full-scale code is at `full_scale` metres, and the other end of its channels.
pub fn pair(full_scale: f64) -> (Outputs, OutputLink) {
    let (commands_in, commands) = watch::channel(None);
    let (answers_in, answers) = watch::channel(Answers::default());
    let driver = Outputs { full_scale, commands: commands_in, answers, source: None, ack: None };
    (driver, OutputLink { commands, answers: answers_in })
}

/// The driver of the outputs of the source.
#[derive(Debug)]
pub struct Outputs {
    /// Position at the full-scale code, metres.
    full_scale: f64,
    commands: watch::Sender<Option<OutputCommand>>,
    answers: watch::Receiver<Answers>,
    /// The source and the acknowledgement that have been reported.
    source: Option<Arc<Identity>>,
    ack: Option<Ack>,
}

impl Outputs {
    /// The next unreported event; a new source comes first.
    fn news(&mut self) -> Option<StageEvent> {
        let answers = self.answers.borrow_and_update();
        if let Some(source) = &answers.source
            && !self.source.as_ref().is_some_and(|known| Arc::ptr_eq(known, source))
        {
            self.source = Some(Arc::clone(source));
            return Some(StageEvent::Up);
        }
        if answers.ack != self.ack {
            self.ack = answers.ack;
            return self.ack.map(StageEvent::Ack);
        }
        None
    }
}

impl Driver for Outputs {
    /// Without a source there are no outputs, and the command is dropped.
    fn steer(&mut self, command: Command) {
        let Some(source) = &self.source else { return };
        self.commands.send_replace(Some(OutputCommand {
            id: command.id,
            codes: codes(command.position, self.full_scale, source.output_bits),
            lease_ms: command.lease_ms,
            on_expiry: command.on_expiry,
        }));
    }

    async fn next(&mut self) -> StageEvent {
        loop {
            if let Some(event) = self.news() {
                return event;
            }
            if self.answers.changed().await.is_err() {
                std::future::pending::<()>().await; // acquisition has ended; the daemon detects that
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use trifacet_wire::actuator::LeaseAction;

    use trifacet_core::steering::StagePosition;

    use super::*;
    use crate::config::Config;
    use crate::twin::Twin;

    #[tokio::test]
    async fn commands_become_codes_within_range_and_only_changes_are_reported() {
        let (mut outputs, OutputLink { commands: sent, answers }) = pair(500e-6);
        let command = |position| Command { id: 7, position, lease_ms: 200, on_expiry: LeaseAction::Park };
        outputs.steer(command(StagePosition([1e-6, 0.0])));
        assert_eq!(*sent.borrow(), None, "no source yet");

        let identity = Arc::new(Twin::new(&Config::default()).unwrap().identity().clone());
        answers.send_modify(|a| a.source = Some(identity));
        assert_eq!(outputs.next().await, StageEvent::Up);
        for (position, codes) in [([250e-6, -125e-6], [16384, -8192]), ([500e-6, -1.0], [32767, -32768])] {
            outputs.steer(command(StagePosition(position)));
            assert_eq!(sent.borrow().unwrap().codes, codes);
        }
        let ack = Ack { id: 7, accepted: true };
        answers.send_modify(|a| a.ack = Some(ack));
        assert_eq!(outputs.next().await, StageEvent::Ack(ack));
        answers.send_modify(|_| {});
        assert_eq!(outputs.news(), None);
    }
}
