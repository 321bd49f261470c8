//! The board under test: requests, and the answers that are required.

use std::time::Duration;

use trifacet_core::time::Mono;
use trifacet_wire::actuator::{LeaseAction, OutputCommand};
use trifacet_wire::board::message::{Reply, SteerResult};
use trifacet_wire::board::{Answer, BoardIdentity, MINOR, Request, ScanFormat, required_baud};

use super::line::{Line, Options, Received, TestError, within};
use super::verdict::{Broken, fail};

/// Longest wait for an answer. The board must answer within 500 ms; the rest is for a busy host.
pub(super) const ANSWER: Duration = Duration::from_secs(2);
/// Time in which a board that must not answer does not.
const NO_ANSWER: Duration = Duration::from_millis(300);
/// Rate of the scans if the board can have it, scans per 1000 seconds.
const USUAL_MHZ: u32 = 1_000_000;

/// A board under test.
pub struct Bench {
    line: Line,
    options: Options,
    /// The first IDENTITY, of version 1.1 if the board speaks it.
    pub identity: BoardIdentity,
    ids: u32,
    /// A command was accepted: the outputs are sent back at the end.
    moved: bool,
}

impl Bench {
    /// Opens the port and identifies the board.
    ///
    /// # Errors
    /// The port cannot be opened, no board answers, or the amplitude does not suit it.
    pub fn open(options: Options) -> Result<Self, TestError> {
        let mut line = Line::open(&options)?;
        let identity = line.first_identity(&options.place)?;
        let mut bench = Self { line, options, identity, ids: 0, moved: false };
        if bench.identity.extensible
            && let Some(Answer::Identity(identity)) = bench.ask(Request::Identify { minor: MINOR })?
        {
            bench.identity = identity;
        }
        let most = bench.limit() - 1;
        match bench.options.amplitude {
            Some(amplitude) if !(1..=most).contains(&amplitude) => {
                Err(TestError::Amplitude { amplitude, bits: bench.identity.output_bits, most })
            }
            _ => Ok(bench),
        }
    }

    /// Sends bytes.
    ///
    /// # Errors
    /// The port fails.
    pub fn send(&mut self, bytes: &[u8]) -> Result<(), TestError> {
        self.line.send(bytes)
    }

    /// Sends a request.
    ///
    /// # Errors
    /// The port fails.
    pub fn request(&mut self, request: Request) -> Result<(), TestError> {
        self.line.request(request)
    }

    /// The next frame, if one comes in time.
    ///
    /// # Errors
    /// The port fails.
    pub fn next(&mut self, until: Mono) -> Result<Option<Received>, TestError> {
        self.line.next(until)
    }

    /// The largest commanded code, if the stage may be moved.
    pub fn amplitude(&self) -> Option<i32> {
        self.options.amplitude
    }

    /// The first code beyond the range of the outputs.
    pub fn limit(&self) -> i32 {
        1 << self.identity.output_bits.clamp(8, 24).saturating_sub(1)
    }

    /// The rate of the scans under test, scans per 1000 seconds.
    pub fn rate_mhz(&self) -> u32 {
        let [slowest, fastest] = self.identity.rate_mhz;
        let wished = self.options.rate_mhz.unwrap_or_else(|| {
            // Scans of the highest version must find room on the line.
            let at_1_khz =
                required_baud(self.identity.roles.len(), 1e3, ScanFormat::Long { wide_tick: true });
            let of_line = |baud| (1e6 * f64::from(baud) / f64::from(at_1_khz)) as u32;
            self.options.place.baud().map_or(USUAL_MHZ, |baud| USUAL_MHZ.min(of_line(baud)))
        });
        wished.min(fastest).max(slowest).max(1)
    }

    /// The period of the scans under test.
    pub fn period(&self) -> Duration {
        Duration::from_secs_f64(1e3 / f64::from(self.rate_mhz()))
    }

    /// The first frame that is no scan, after these bytes were sent.
    ///
    /// # Errors
    /// The port fails.
    pub fn answer_to(&mut self, bytes: &[u8]) -> Result<Option<Received>, TestError> {
        self.send(bytes)?;
        let until = within(ANSWER);
        while let Some(received) = self.next(until)? {
            if !received.is_scan() {
                return Ok(Some(received));
            }
        }
        Ok(None)
    }

    /// The answer to a request.
    ///
    /// # Errors
    /// The port fails.
    pub fn ask(&mut self, request: Request) -> Result<Option<Answer>, TestError> {
        let mut frame = Vec::new();
        request.encode(&mut frame);
        Ok(self.answer_to(&frame)?.and_then(|received| received.answer()))
    }

    /// Requires this answer to these bytes.
    ///
    /// # Errors
    /// Another answer, or none, or the port fails.
    pub fn expect(&mut self, what: &str, bytes: &[u8], expected: &Answer) -> Result<(), Broken> {
        let received = self.answer_to(bytes)?;
        if received.as_ref().and_then(Received::answer).as_ref() == Some(expected) {
            return Ok(());
        }
        let seen = received.map_or("no answer".into(), |received| received.text());
        fail(format!("{what}: {seen}"), format!("{expected:?}"))
    }

    /// Requires an ACK with this result to a command.
    ///
    /// # Errors
    /// As [`Bench::expect`].
    pub fn expect_ack(
        &mut self,
        what: &str,
        command: OutputCommand,
        result: SteerResult,
    ) -> Result<(), Broken> {
        let mut frame = Vec::new();
        Request::Steer(command).encode(&mut frame);
        self.expect(what, &frame, &Answer::Ack { id: command.id, result })
    }

    /// Requires that no frame but scans follows these bytes.
    ///
    /// # Errors
    /// There is one, or the port fails.
    pub fn expect_nothing(&mut self, what: &str, bytes: &[u8]) -> Result<(), Broken> {
        self.send(bytes)?;
        let until = within(NO_ANSWER);
        while let Some(received) = self.next(until)? {
            if !received.is_scan() {
                return fail(format!("{what}: {}", received.text()), "no answer");
            }
        }
        Ok(())
    }

    /// Stops the board, and discards everything that it has sent before its reply.
    ///
    /// # Errors
    /// The port fails.
    pub fn settle(&mut self) -> Result<(), TestError> {
        self.request(Request::Stop)?;
        let until = within(ANSWER);
        while let Some(received) = self.next(until)? {
            if matches!(received.answer(), Some(Answer::Reply(Reply { start: false, .. }))) {
                break;
            }
        }
        self.line.clear();
        Ok(())
    }

    /// Starts the board with scans of this minor version and this parking position.
    ///
    /// # Errors
    /// It does not reply, or refuses; or the port fails.
    pub fn start(&mut self, minor: u8, park: [i32; 2]) -> Result<Reply, Broken> {
        let rate_mhz = self.rate_mhz();
        match self.ask(Request::Start { rate_mhz, park, minor })? {
            Some(Answer::Reply(reply)) if reply.start && reply.rate_mhz > 0 => Ok(reply),
            other => fail(format!("START: {other:?}"), "REPLY, done, with the rate of the scans"),
        }
    }

    /// A command with a new id.
    pub fn command(&mut self, codes: [i32; 2], lease_ms: u16, on_expiry: LeaseAction) -> OutputCommand {
        self.ids += 1;
        OutputCommand { id: self.ids, codes, lease_ms, on_expiry }
    }

    /// A command that the board must refuse for its lease, so that nothing moves.
    pub fn refused(&mut self) -> OutputCommand {
        self.command([0; 2], 0, LeaseAction::Hold)
    }

    /// Records that the outputs are moved.
    pub fn moves(&mut self) {
        self.moved = true;
    }

    /// Sends the outputs back to code 0 if they were moved, and stops the board.
    ///
    /// # Errors
    /// The port fails.
    pub fn leave(&mut self) -> Result<(), TestError> {
        if self.moved {
            self.request(Request::Start { rate_mhz: self.rate_mhz(), park: [0; 2], minor: 0 })?;
            let home = self.command([0; 2], u16::MAX, LeaseAction::Hold);
            self.request(Request::Steer(home))?;
        }
        self.settle()
    }
}
