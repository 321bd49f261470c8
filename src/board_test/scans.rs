//! A series of scans.

use std::time::Duration;

use trifacet_core::time::{Clock, Mono};
use trifacet_wire::actuator::OutputCommand;
use trifacet_wire::board::message::SteerResult;
use trifacet_wire::board::{Answer, BoardScan, Request};

use super::bench::{ANSWER, Bench};
use super::line::{Received, within};
use super::verdict::{Broken, fail};
use crate::clock::SystemClock;

/// Time beyond the expected one after which a series is incomplete.
const PATIENCE: Duration = Duration::from_secs(3);

/// A scan, and what came with it.
#[derive(Clone, Debug)]
pub struct Taken {
    /// The scan.
    pub scan: BoardScan,
    /// Its message, without checksum.
    pub message: Vec<u8>,
    /// When it was read.
    pub at: Mono,
}

/// What a board sent in a series.
#[derive(Clone, Debug, Default)]
pub struct Series {
    /// The scans.
    pub scans: Vec<Taken>,
    /// The acknowledgements, and the number of scans before each.
    pub acks: Vec<(u32, SteerResult, usize)>,
    /// Damaged frames.
    pub damaged: usize,
}

impl Bench {
    /// Reads this number of scans.
    ///
    /// # Errors
    /// Too few come; anything else than scans and acknowledgements comes; the port fails.
    pub fn series(&mut self, scans: usize) -> Result<Series, Broken> {
        self.series_with(scans, |_| None)
    }

    /// Reads this number of scans, and sends what `command` returns after each. Then reads on until the commands are
    /// acknowledged; without an acknowledgement, not for long.
    ///
    /// # Errors
    /// As [`Bench::series`].
    pub fn series_with(
        &mut self,
        scans: usize,
        mut command: impl FnMut(usize) -> Option<OutputCommand>,
    ) -> Result<Series, Broken> {
        let (mut series, mut sent) = (Series::default(), 0);
        let until = within(self.period() * scans as u32 * 2 + PATIENCE);
        while series.scans.len() < scans {
            let Some(received) = self.next(until)? else {
                let expected = format!("{scans} scans at {} mHz", self.rate_mhz());
                return fail(format!("only {} scans in more than their time", series.scans.len()), expected);
            };
            if series.take(&received)?
                && let Some(command) = command(series.scans.len())
            {
                self.request(Request::Steer(command))?;
                sent += 1;
            }
        }
        let until = within(ANSWER);
        while series.acks.len() < sent
            && SystemClock.now() < until
            && let Some(received) = self.next(until)?
        {
            series.take(&received)?;
        }
        Ok(series)
    }
}

impl Series {
    /// Takes a frame. Returns whether it is a scan.
    fn take(&mut self, received: &Received) -> Result<bool, Broken> {
        match (received.answer(), &received.message) {
            (Some(Answer::Scan(scan)), Ok(message)) => {
                self.scans.push(Taken { scan, message: message.clone(), at: received.at });
                return Ok(true);
            }
            (Some(Answer::Ack { id, result }), _) => self.acks.push((id, result, self.scans.len())),
            (None, Err(_)) => self.damaged += 1,
            _ => return fail(received.text(), "scans and acknowledgements only"),
        }
        Ok(false)
    }
}
