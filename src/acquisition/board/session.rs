//! The session with a board, without the port: bytes and times in, events and bytes out.

use std::collections::VecDeque;
use std::sync::Arc;

use trifacet_core::pipeline::SilenceTimes;
use trifacet_core::signals::Scan;
use trifacet_core::telemetry::Counters;
use trifacet_core::time::{Mono, NS_PER_S};
use trifacet_wire::actuator::OutputCommand;
use trifacet_wire::board::message::{ErrorReason, Reply, StartResult};
use trifacet_wire::board::{
    Answer, BoardIdentity, BoardScan, Deframer, MINOR, MessageError, Request, ScanFormat,
};

use super::boot_watch::BootWatch;
use super::foreign::ForeignBytes;
use super::link_faults::{LinkFault, Tally};
use super::{Arrival, Sequence, Settings, compatibility};
use crate::acquisition::in_flight::InFlight;
use crate::acquisition::timebase::{ScanCounters, Timebase};
use crate::acquisition::{SourceError, SourceEvent};

const MS: i64 = NS_PER_S / 1000;
/// Time limit for an answer of the board, milliseconds.
const ANSWER_MS: u32 = 500;
/// Pause after a fault before the next request, nanoseconds.
const REST_NS: i64 = NS_PER_S;

/// A board that cannot generate the configured rate uses the nearest one. A larger difference is logged.
const RATE_TOLERANCE: f64 = 1e-3;

/// State of the session.
#[derive(Debug)]
enum State {
    /// The port is not open.
    Unlinked,
    /// IDENTIFY has been sent. `minor`: the version that it states.
    Identifying { minor: u8, until: Mono },
    /// START has been sent.
    Starting { board: BoardIdentity, format: ScanFormat, asked: Mono, until: Mono },
    /// Scans are arriving.
    Running(Running),
    /// Pause after a fault. If scans have only stalled, scans that arrive in the meantime are accepted.
    Resting { until: Mono, stalled: Option<Running> },
}

#[derive(Debug)]
struct Running {
    channels: usize,
    format: ScanFormat,
    timebase: Timebase,
    /// Silence that counts as a stall, nanoseconds.
    patience_ns: i64,
    /// Arrival of the last new scan.
    last_arrival: Mono,
    /// Sequence number of the last new scan.
    last_sequence: Option<u32>,
    lease_expired: bool,
}

/// The session with one board, across all faults and reconnections.
#[derive(Debug)]
pub struct Session {
    settings: Settings,
    state: State,
    deframer: Deframer,
    sequence: Sequence,
    tally: Tally,
    /// Time of the last scan.
    last: Option<Mono>,
    events: VecDeque<SourceEvent>,
    /// The last reported reason for missing scans.
    reported: Option<SourceError>,
    /// Bytes that wait to be written.
    out: Vec<u8>,
    /// The newest command, not yet encoded, with its time.
    command: Option<(OutputCommand, Mono)>,
    in_flight: InFlight,
    counters: Arc<Counters>,
    /// What arrives while the board does not answer.
    foreign: ForeignBytes,
    boot: BootWatch,
    /// The other host that has the board, as the board states.
    busy: Option<String>,
}

impl Session {
    /// A session without a connection.
    pub fn new(settings: Settings, counters: Arc<Counters>) -> Self {
        Self {
            in_flight: InFlight::new(settings.most_in_flight, Arc::clone(&counters)),
            foreign: ForeignBytes::new(settings.baud),
            settings,
            state: State::Unlinked,
            deframer: Deframer::default(),
            sequence: Sequence::default(),
            tally: Tally::new(Arc::clone(&counters)),
            counters,
            last: None,
            events: VecDeque::new(),
            reported: None,
            out: Vec::new(),
            command: None,
            boot: BootWatch::default(),
            busy: None,
        }
    }

    /// Records that the port is open.
    pub fn connected(&mut self, now: Mono) {
        self.deframer = Deframer::default();
        self.foreign.opened();
        self.busy = None;
        self.identify(now);
    }

    /// Records that the port is not open, for this reason.
    pub fn disconnected(&mut self, reason: SourceError) {
        self.state = State::Unlinked;
        self.out.clear();
        let reason = match (reason, self.busy.take()) {
            (SourceError::Unplugged { port, .. }, Some(host)) => SourceError::InUse { port, host },
            (reason, _) => reason,
        };
        self.down(reason);
    }

    /// The next event.
    pub fn event(&mut self) -> Option<SourceEvent> {
        self.events.pop_front()
    }

    /// Takes a command, which replaces an older one that has not been sent. The command waits while too many
    /// commands have no acknowledgement: a slow board then gets the newest command, not old ones. Without a running board the
    /// command is dropped, because it would be outdated when the board is back. A stalled board may still
    /// receive, so that the last command of a loop that ends is sent to it.
    pub fn steer(&mut self, command: OutputCommand, now: Mono) {
        self.in_flight.expire(now);
        if self.scanning() && self.command.replace((command, now)).is_some() {
            self.counters.commands_replaced.inc();
        }
    }

    /// Requests the board to stop scanning, after the last command.
    pub fn stop(&mut self) {
        if let Some((command, _)) = self.command.take() {
            Request::Steer(command).encode(&mut self.out);
        }
        Request::Stop.encode(&mut self.out);
    }

    /// The bytes to write next.
    pub fn output(&mut self) -> &[u8] {
        if self.out.is_empty()
            && self.in_flight.has_room()
            && let Some((command, now)) = self.command.take()
        {
            self.in_flight.sent(&command, now);
            Request::Steer(command).encode(&mut self.out);
        }
        &self.out
    }

    /// Records that `bytes` bytes of the output have been written.
    pub fn written(&mut self, bytes: usize) {
        self.out.drain(..bytes);
    }

    /// Time at which [`Session::timed_out`] must be called if nothing arrives before.
    pub fn deadline(&self) -> Option<Mono> {
        match &self.state {
            State::Unlinked => None,
            State::Identifying { until, .. }
            | State::Starting { until, .. }
            | State::Resting { until, .. } => Some(*until),
            State::Running(running) => Some(running.last_arrival + running.patience_ns),
        }
    }

    /// Handles the deadline, if `now` has reached it.
    pub fn timed_out(&mut self, now: Mono) {
        self.tally.tell(now);
        if self.deadline().is_none_or(|deadline| now < deadline) {
            return;
        }
        match std::mem::replace(&mut self.state, State::Unlinked) {
            State::Unlinked => {}
            State::Identifying { .. } => self.unanswered("identify", now),
            State::Starting { .. } => self.unanswered("start", now),
            State::Resting { .. } => self.identify(now),
            State::Running(running) => {
                let silence_ms = ((now - running.last_arrival) / MS) as u32;
                self.rest(SourceError::Stalled { silence_ms }, now);
                if self.boot.is_known() {
                    // The boot id in the answer tells at once whether the board has restarted.
                    Request::Identify { minor: MINOR }.encode(&mut self.out);
                }
                self.state = State::Resting { until: now + REST_NS, stalled: Some(running) };
            }
        }
    }

    /// Takes bytes that arrived at `now`.
    pub fn received(&mut self, mut bytes: &[u8], now: Mono) {
        if !self.scanning() {
            self.foreign.bytes(bytes);
        }
        let mut deframer = std::mem::take(&mut self.deframer);
        while let Some(frame) = deframer.next(&mut bytes) {
            match frame {
                Ok(message) => self.message(message, now),
                Err(_) if self.scanning() => self.tally.count(LinkFault::Corrupted),
                Err(_) => {}
            }
        }
        self.deframer = deframer;
        self.tally.tell(now);
    }

    fn message(&mut self, message: &[u8], now: Mono) {
        match Answer::decode(message) {
            Ok(answer) => {
                self.foreign.frame();
                self.answered(answer, now);
            }
            Err(error) => {
                if (0..=MINOR).any(|minor| Request::decode(message, minor).is_ok()) {
                    self.foreign.echo();
                }
                self.not_understood(error, now);
            }
        }
    }

    /// Whether scans are expected, so that damaged data counts as a loss.
    fn scanning(&self) -> bool {
        matches!(self.state, State::Running(_) | State::Resting { stalled: Some(_), .. })
    }

    fn identify(&mut self, now: Mono) {
        self.command = None;
        self.out.clear();
        self.out.push(0); // terminates an incomplete frame in the board's buffer
        self.foreign.asked();
        self.ask_identity(0, now); // a board of version 1.0 understands no other
    }

    fn ask_identity(&mut self, minor: u8, now: Mono) {
        Request::Identify { minor }.encode(&mut self.out);
        self.state = State::Identifying { minor, until: now + i64::from(ANSWER_MS) * MS };
    }

    fn answered(&mut self, answer: Answer, now: Mono) {
        match (answer, &self.state) {
            (Answer::Scan(scan), State::Running(_) | State::Resting { stalled: Some(_), .. }) => {
                self.scanned(&scan, now);
            }
            (Answer::Ack { id, result }, State::Running(_) | State::Resting { stalled: Some(_), .. }) => {
                if self.in_flight.acknowledged(id) {
                    self.events.push_back(SourceEvent::Ack(result.ack(id)));
                }
            }
            (Answer::Identity(board), State::Identifying { minor: 0, .. }) if board.extensible => {
                self.ask_identity(MINOR, now);
            }
            (Answer::Identity(board), State::Identifying { .. }) => self.identified(board, now),
            (Answer::Identity(board), State::Resting { stalled: Some(_), .. })
                if self.boot.is_other(&board) =>
            {
                self.identified(board, now);
            }
            (Answer::Reply(reply @ Reply { start: true, .. }), State::Starting { .. }) => {
                self.started(reply, now);
            }
            (Answer::Error { reason: ErrorReason::Version, .. }, State::Identifying { .. }) => {
                self.unfit("it does not support version 1 of the protocol".into(), now);
            }
            (Answer::Busy { host }, _) => self.busy = Some(host.escape_debug().to_string()),
            (Answer::Error { .. }, _) => self.tally.count(LinkFault::BoardError),
            // Scans from before START, and answers after their time limit.
            (Answer::Scan(_) | Answer::Ack { .. } | Answer::Identity(_) | Answer::Reply(_), _) => {}
        }
    }

    fn not_understood(&mut self, error: MessageError, now: Mono) {
        if let (MessageError::Version { .. }, State::Identifying { .. }) = (error, &self.state) {
            return self.unfit(error.to_string(), now);
        }
        tracing::debug!("board link: {error}");
        self.tally.count(LinkFault::Unknown);
    }

    fn identified(&mut self, board: BoardIdentity, now: Mono) {
        if let Err(reason) = compatibility::check(&board, &self.settings) {
            return self.unfit(format!("{}: {reason}", board.name), now);
        }
        self.counters.board_restarts.add(self.boot.note(&board).into());
        let format = compatibility::scan_format(&board, &self.settings);
        let minor = u8::from(format != ScanFormat::Short);
        let park = compatibility::output_codes(&board, self.settings.park);
        let rate_mhz = (self.settings.rate_hz * 1e3).round() as u32;
        Request::Start { rate_mhz, park, minor }.encode(&mut self.out);
        let until = now + i64::from(ANSWER_MS) * MS;
        self.state = State::Starting { board, format, asked: now, until };
    }

    fn started(&mut self, reply: Reply, now: Mono) {
        let State::Starting { board, format, asked, .. } =
            std::mem::replace(&mut self.state, State::Unlinked)
        else {
            return;
        };
        if reply.result != StartResult::Done || reply.rate_mhz == 0 {
            let rate_hz = self.settings.rate_hz;
            return self.unfit(format!("{}: it refuses to start at {rate_hz} Hz", board.name), now);
        }
        let rate_hz = f64::from(reply.rate_mhz) * 1e-3;
        let missed = self.last.map_or(0.0, |last| now.seconds_since(last) * rate_hz);
        self.sequence.restart(missed.round() as u64);
        self.command = None;
        self.in_flight.clear();
        self.state = State::Running(Running {
            channels: board.roles.len(),
            format,
            timebase: Timebase::new(board.tick_hz, rate_hz, self.settings.latency_ns, self.last)
                .with_tick_bits(format.tick_bits())
                .with_bursts(self.settings.silence)
                .started(asked),
            patience_ns: SilenceTimes::new(rate_hz, self.settings.silence).first.as_nanos() as i64,
            last_arrival: now,
            last_sequence: None,
            lease_expired: true, // a lease of the previous daemon is not counted
        });
        self.tally.restarted();
        if (rate_hz / self.settings.rate_hz - 1.0).abs() > RATE_TOLERANCE {
            let configured_hz = self.settings.rate_hz;
            tracing::warn!(
                configured_hz,
                rate_hz,
                "the board samples at another rate than acquisition.rate_hz"
            );
        }
        tracing::debug!("board started: {}, {} channels at {rate_hz} Hz", board.name, board.roles.len());
        self.reported = None;
        self.events.push_back(SourceEvent::Up(compatibility::identity(&board, rate_hz)));
    }

    fn scanned(&mut self, scan: &BoardScan, now: Mono) {
        let (State::Running(running) | State::Resting { stalled: Some(running), .. }) = &mut self.state
        else {
            return;
        };
        if usize::from(scan.channels) != running.channels || scan.format != running.format {
            return self.tally.count(LinkFault::Unknown);
        }
        let (index, lost) = match self.sequence.arrived(scan.sequence) {
            Arrival::New { index, lost } => (index, lost),
            Arrival::Repeated => return self.tally.count(LinkFault::Repeated),
            Arrival::Late => return self.tally.count(LinkFault::Late),
        };
        self.tally.lost(lost);
        if scan.overrun {
            self.tally.count(LinkFault::Overrun);
        }
        if scan.lease_expired && !running.lease_expired {
            self.tally.count(LinkFault::LeaseExpired);
        }
        running.lease_expired = scan.lease_expired;
        running.last_arrival = now;
        let last = running.last_sequence.replace(scan.sequence);
        let periods = last.map_or(1, |last| scan.sequence.wrapping_sub(last));
        let moment = running.timebase.moment(ScanCounters { tick: scan.tick, periods }, now);
        self.last = Some(moment.time);
        if let Some(fault) = moment.fault {
            self.tally.clock_fault(fault, scan);
        }
        self.events.push_back(SourceEvent::Scan(Scan {
            index,
            time: moment.time,
            time_sigma_ns: Some(moment.sigma_ns),
            lost,
            codes: scan.codes,
            output_railed: scan.output_railed,
            applied: scan.applied,
        }));
        self.resume();
    }

    /// Records that scans have resumed after a stall.
    fn resume(&mut self) {
        if let State::Resting { stalled, .. } = &mut self.state
            && let Some(running) = stalled.take()
        {
            tracing::info!("scans have resumed");
            self.state = State::Running(running);
            self.reported = None;
        }
    }

    fn unanswered(&mut self, step: &'static str, now: Mono) {
        let line = self.foreign.describe();
        self.counters.bytes_foreign.add(self.foreign.count());
        self.rest(SourceError::Timeout { step, timeout_ms: ANSWER_MS, line }, now);
    }

    fn unfit(&mut self, reason: String, now: Mono) {
        self.rest(SourceError::Unfit { what: "the board".into(), reason }, now);
    }

    fn rest(&mut self, reason: SourceError, now: Mono) {
        self.state = State::Resting { until: now + REST_NS, stalled: None };
        self.down(reason);
    }

    /// Reports the reason for missing scans, once for each reason.
    fn down(&mut self, reason: SourceError) {
        self.command = None;
        if self.reported.as_ref() != Some(&reason) {
            self.reported = Some(reason.clone());
            self.events.push_back(SourceEvent::Down(reason));
        }
    }
}

#[cfg(test)]
mod tests;
