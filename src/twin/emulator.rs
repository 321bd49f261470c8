//! A board with the twin behind it: the board side of `docs/board-protocol.md`, without its link.

use std::hash::{BuildHasher, RandomState};

use trifacet_core::time::Mono;
use trifacet_wire::actuator::{LeaseAction, OutputCommand};
use trifacet_wire::board::message::{ErrorReason, Reply, StartResult, SteerResult};
use trifacet_wire::board::{
    Answer, BoardIdentity, BoardScan, Deframer, Extension, MINOR, Request, ScanFormat,
};

use super::applied::AppliedCommands;
use super::board_state::{BoardState, Steering};
use super::{Fate, MirrorMove, OUTPUT_BITS, Outputs, Twin, TwinError, TwinScan};
use crate::config::{Config, FaultKind};

/// Clock of the board, ticks per second.
const TICK_HZ: u32 = 10_000_000;

/// Largest number of bytes that wait to be written. Further frames are not sent, as on a board with a full
/// buffer.
const QUEUE: usize = 65_536;

/// Bytes of it that scans leave for answers.
const RESERVE: usize = 1024;

/// A boot id.
fn random_id() -> u32 {
    RandomState::new().hash_one(()) as u32
}

/// An emulated board. It samples from power-up on, at the configured rate.
#[derive(Debug)]
pub struct Emulator {
    twin: Twin,
    outputs: Outputs,
    deframer: Deframer,
    /// Minor version of the protocol.
    minor: u8,
    boot_id: u32,
    /// Time of the last scan by the clock of the board, seconds since the start of the twin.
    clock_s: f64,
    /// Time of the last power-up by the clock of the board, seconds since the start of the twin.
    powered_s: f64,
    /// The message that carries the scans.
    format: ScanFormat,
    applied: AppliedCommands,
    /// Sequence number of the next scan, while started.
    sequence: Option<u32>,
    stalled: bool,
    /// Bytes that wait to be written.
    out: Vec<u8>,
    /// While the board sends in bursts: number of these bytes that belong to the last burst.
    released: Option<usize>,
    start: Mono,
    state: BoardState,
}

impl Emulator {
    /// A board that is powered up at `start`.
    ///
    /// # Errors
    /// As [`Twin::new`].
    pub fn new(config: &Config, start: Mono) -> Result<Self, TwinError> {
        let twin = Twin::new(config)?;
        let outputs = twin.outputs().clone();
        let (deframer, out) = (Deframer::default(), Vec::new());
        Ok(Self {
            twin,
            outputs,
            deframer,
            minor: MINOR,
            boot_id: random_id(),
            clock_s: 0.0,
            powered_s: 0.0,
            format: ScanFormat::Short,
            applied: AppliedCommands::default(),
            sequence: None,
            stalled: false,
            out,
            released: None,
            start,
            state: BoardState::default(),
        })
    }

    /// The same board with version 1.`minor` of the protocol.
    #[must_use]
    pub fn with_minor(self, minor: u8) -> Self {
        Self { minor, ..self }
    }

    /// Restarts the board at `now`, as after a short failure of its supply.
    pub fn restart(&mut self, now: Mono) {
        self.outputs.clear_lease();
        self.outputs.set_park([0; 2]);
        self.move_outputs([0; 2], now, Steering::Idle);
        self.set_started(None);
        self.deframer = Deframer::default();
        (self.boot_id, self.powered_s) = (random_id(), self.clock_s);
        (self.format, self.applied) = (ScanFormat::Short, AppliedCommands::default());
    }

    /// The state of the board.
    pub fn state(&self) -> BoardState {
        self.state
    }

    /// Injects a fault for `for_s` seconds or, with `None`, without end.
    ///
    /// # Errors
    /// A value of the fault is out of range.
    pub fn inject(&mut self, kind: FaultKind, for_s: Option<f64>) -> Result<(), TwinError> {
        self.twin.inject(kind, for_s)
    }

    /// Moves the mirror, and holds it there.
    pub fn travel(&mut self, to: &MirrorMove) {
        self.twin.travel(to.to(), to.over_s);
    }

    /// The bytes to write next.
    pub fn output(&self) -> &[u8] {
        &self.out[..self.released.unwrap_or(self.out.len())]
    }

    /// Records that `bytes` bytes of the output have been written.
    pub fn written(&mut self, bytes: usize) {
        self.out.drain(..bytes);
        self.released = self.released.map(|released| released - bytes);
    }

    /// No host is connected: discards the output.
    pub fn unheard(&mut self) {
        self.out.clear();
        self.released = self.released.map(|_| 0);
    }

    /// Takes bytes that arrived at `now`. A stalled board ignores them.
    pub fn received(&mut self, mut bytes: &[u8], now: Mono) {
        if self.stalled {
            return;
        }
        let mut deframer = std::mem::take(&mut self.deframer);
        while let Some(frame) = deframer.next(&mut bytes) {
            let answer = match frame {
                // From a board: the line echoes. An answer would be echoed too, without end.
                Ok([0x80..=0xff, ..]) => None,
                Ok(message) => match Request::decode(message, self.minor) {
                    Ok(request) => self.requested(request, now),
                    Err(error) => Some(error.to_answer()),
                },
                Err(_) => Some(Answer::Error { reason: ErrorReason::Corrupted, kind: 0 }),
            };
            if let Some(answer) = answer {
                self.send(&answer);
            }
        }
        self.deframer = deframer;
    }

    /// Takes the next scan, which is due at `now`, and sends it if the board is started.
    pub fn sample(&mut self, now: Mono) {
        self.expire(now);
        let scan = self.twin.next_scan();
        self.release(&scan);
        self.clock_s = scan.clock_s;
        let applied = self.applied.at(now);
        self.state.time_s = scan.t_s;
        self.state.mirror = scan.truth.pose.to_array();
        self.stalled = scan.fate == Fate::Stalled;
        let Some(sequence) = self.sequence else { return };
        self.sequence = Some(sequence.wrapping_add(1));
        if matches!(scan.fate, Fate::Dropped | Fate::Stalled) || !self.send_scan(sequence, &scan, applied) {
            self.state.scans_unsent += 1;
        } else {
            self.state.scans_sent += 1;
        }
    }

    /// While the board sends in bursts, holds the output back until the next burst is due.
    fn release(&mut self, scan: &TwinScan) {
        let burst = |t_s: f64| (t_s / scan.burst_s).floor();
        self.released = if scan.burst_s <= 0.0 {
            None
        } else if burst(scan.t_s) > burst(self.state.time_s) {
            Some(self.out.len())
        } else {
            Some(self.released.unwrap_or(0))
        };
    }

    /// The answer to a request; `None` if a fault suppresses it.
    fn requested(&mut self, request: Request, now: Mono) -> Option<Answer> {
        Some(match request {
            Request::Identify { minor } => Answer::Identity(self.identity(minor)),
            Request::Start { rate_mhz, park, minor } => self.start(rate_mhz, park, minor),
            Request::Stop => {
                self.set_started(None);
                Answer::Reply(Reply { start: false, result: StartResult::Done, rate_mhz: 0 })
            }
            Request::Steer(command) => {
                let result = self.steer(&command, now);
                Answer::Ack { id: self.twin.acknowledged(command.id)?, result }
            }
        })
    }

    fn start(&mut self, rate_mhz: u32, park: [i32; 2], minor: u8) -> Answer {
        let own_mhz = self.rate_mhz();
        let result = if rate_mhz != own_mhz {
            StartResult::RateOutOfRange
        } else if Outputs::in_range(park) {
            self.outputs.set_park(park);
            self.set_started(Some(0));
            self.format = if minor > 0 { ScanFormat::Long { wide_tick: true } } else { ScanFormat::Short };
            StartResult::Done
        } else {
            StartResult::ParkOutOfRange
        };
        let rate_mhz = if self.sequence.is_some() { own_mhz } else { 0 };
        Answer::Reply(Reply { start: true, result, rate_mhz })
    }

    fn set_started(&mut self, sequence: Option<u32>) {
        self.sequence = sequence;
        self.state.started = sequence.is_some();
    }

    fn steer(&mut self, command: &OutputCommand, now: Mono) -> SteerResult {
        self.expire(now);
        let result = match self.sequence {
            None => SteerResult::NotStarted,
            Some(_) if command.lease_ms > 0 && self.outputs.take(command, now) => SteerResult::Accepted,
            Some(_) => SteerResult::OutOfRange,
        };
        if result == SteerResult::Accepted {
            self.move_outputs(command.codes, now, Steering::Commanded);
            self.state.commands_taken += 1;
            self.applied.accept(command.id, now);
        } else {
            self.state.commands_refused += 1;
        }
        result
    }

    /// The action of the outputs when a lease expires.
    fn expire(&mut self, now: Mono) {
        match self.outputs.expire(now) {
            Some(LeaseAction::Park) => self.move_outputs(self.outputs.park(), now, Steering::Parked),
            Some(LeaseAction::Hold) => self.state.steering = Steering::Held,
            None => {}
        }
        self.state.lease_expired = matches!(self.state.steering, Steering::Held | Steering::Parked);
    }

    fn move_outputs(&mut self, codes: [i32; 2], now: Mono, steering: Steering) {
        self.twin.steer(codes, now.seconds_since(self.start));
        self.state.output_codes = codes;
        self.state.output_um = self.outputs.metres(codes).map(|metres| metres * 1e6);
        self.state.steering = steering;
        self.state.lease_expired = steering == Steering::Parked;
    }

    /// The identity for a host that understands version 1.`host`.
    fn identity(&self, host: u8) -> BoardIdentity {
        let identity = self.twin.identity();
        BoardIdentity {
            tick_hz: TICK_HZ,
            converter: identity.converter,
            output_bits: OUTPUT_BITS,
            simulated: true,
            rate_mhz: [self.rate_mhz(); 2],
            roles: identity.roles.clone(),
            skew_ns: identity.skew_ns.clone(),
            name: identity.name.clone(),
            extensible: self.minor > 0,
            extension: (self.minor.min(host) > 0).then(|| Extension {
                minor: self.minor,
                wide_tick: true,
                boot_id: self.boot_id,
                units: Vec::new(),
            }),
        }
    }

    fn rate_mhz(&self) -> u32 {
        (self.twin.identity().rate_hz * 1e3).round() as u32
    }

    /// Queues a scan for the port, if there is room.
    fn send_scan(&mut self, sequence: u32, scan: &TwinScan, applied: Option<u32>) -> bool {
        let begin = self.out.len();
        let sent = self.send(&Answer::Scan(BoardScan {
            format: self.format,
            sequence,
            tick: self.tick(scan.clock_s),
            applied,
            output_railed: scan.output_railed,
            lease_expired: self.state.lease_expired,
            overrun: false,
            channels: self.twin.identity().roles.len() as u8,
            codes: scan.codes,
        }));
        if sent && scan.fate == Fate::Corrupted {
            let middle = usize::midpoint(begin, self.out.len());
            // The damaged frame must remain one frame; a zero byte would split it.
            let byte = &mut self.out[middle];
            *byte = if *byte == 0x55 { 0xAA } else { *byte ^ 0x55 };
        }
        sent
    }

    /// Ticks since power-up, within the width of the tick.
    fn tick(&self, clock_s: f64) -> u64 {
        let ticks = ((clock_s - self.powered_s) * f64::from(TICK_HZ)).round() as u64;
        ticks & (u64::MAX >> (64 - self.format.tick_bits()))
    }

    fn send(&mut self, answer: &Answer) -> bool {
        let limit = if matches!(answer, Answer::Scan(_)) { QUEUE - RESERVE } else { QUEUE };
        let room = self.out.len() < limit;
        if room {
            answer.encode(&mut self.out);
        }
        room
    }
}

#[cfg(test)]
mod tests;
