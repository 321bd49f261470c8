//! The session with a T7, without its sockets: bytes and times in, events and bytes out.

use std::collections::VecDeque;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;

use trifacet_core::pipeline::SilenceTimes;
use trifacet_core::signals::Scan;
use trifacet_core::telemetry::Counters;
use trifacet_core::time::{Mono, NS_PER_S};
use trifacet_wire::actuator::{Ack, LeaseAction, OutputCommand};

use super::calibration::Calibration;
use super::clock::ScanClock;
use super::faults::Faults;
use super::modbus::{Frame, Frames, WRITE};
use super::registers::{ENABLE, Register, USER_RAM, Value, WATCHDOG};
use super::scans::{Assembler, StreamScan};
use super::settings::{Settings, Watchdog};
use super::setup::{ANSWER_NS, BEAT, BEGIN, MARK, Progress, Setup, Started};
use super::stream::Packets;
use crate::acquisition::in_flight::InFlight;
use crate::acquisition::{SourceError, SourceEvent};

const MS: i64 = NS_PER_S / 1000;
/// Interval of the beat, which keeps the watchdog quiet and shows other sessions that this one is alive.
const BEAT_NS: i64 = NS_PER_S / 4;
/// After a stall of this time the connection is made anew, nanoseconds.
const REST_NS: i64 = NS_PER_S;
/// First pause before the next attempt to connect; it doubles up to the longest.
const FIRST_RETRY: Duration = Duration::from_millis(200);
const LONGEST_RETRY: Duration = Duration::from_secs(5);

#[derive(Debug)]
enum State {
    /// There is no connection.
    Unlinked,
    /// The device is being configured.
    Setup(Box<Setup>),
    /// Scans are arriving.
    Running(Box<Running>),
}

#[derive(Debug)]
struct Running {
    calibration: Calibration,
    assembler: Assembler,
    scans_per_packet: u32,
    clock: ScanClock,
    /// Silence that counts as a stall, nanoseconds.
    patience_ns: i64,
    /// Arrival of the last packet.
    last_arrival: Mono,
    /// While scans have stalled: when the connection is given up.
    give_up: Option<Mono>,
    next_beat: Mono,
    beats: u32,
    /// No scan has arrived yet.
    begins: bool,
}

/// A request that waits for its answer.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Purpose {
    /// A command with this id.
    Command(u32),
    /// The beat; also the parking of the outputs, and the requests at the end.
    Other,
}

/// The session with one device, across all faults and reconnections.
#[derive(Debug)]
pub struct Session {
    settings: Settings,
    state: State,
    frames: Frames,
    packets: Packets,
    /// The connection must be closed.
    broken: bool,
    retry: Duration,
    /// Number of the last request.
    transaction: u16,
    /// Requests without an answer: number, purpose, end of the time limit.
    requests: VecDeque<(u16, Purpose, Mono)>,
    out: Vec<u8>,
    /// The newest command, not yet sent, with its time.
    command: Option<(OutputCommand, Mono)>,
    /// End of the lease of the last command, and the action.
    lease: Option<(Mono, LeaseAction)>,
    in_flight: InFlight,
    /// Index of the next scan.
    index: u64,
    /// Scans missed while there was no stream.
    missed: u64,
    /// Time of the last scan.
    last: Option<Mono>,
    events: VecDeque<SourceEvent>,
    reported: Option<SourceError>,
    counters: Arc<Counters>,
    faults: Faults,
}

impl Session {
    /// A session without a connection.
    pub fn new(settings: Settings, counters: Arc<Counters>) -> Self {
        Self {
            in_flight: InFlight::new(settings.most_in_flight, Arc::clone(&counters)),
            faults: Faults::new(Arc::clone(&counters)),
            settings,
            state: State::Unlinked,
            frames: Frames::default(),
            packets: Packets::default(),
            broken: false,
            retry: FIRST_RETRY,
            transaction: 0,
            requests: VecDeque::new(),
            out: Vec::new(),
            command: None,
            lease: None,
            index: 0,
            missed: 0,
            last: None,
            events: VecDeque::new(),
            reported: None,
            counters,
        }
    }

    /// Records that both connections are open, from this address of the host.
    pub fn connected(&mut self, host: IpAddr, now: Mono) {
        self.unlink();
        self.broken = false;
        self.state = State::Setup(Box::new(Setup::new(&self.settings, host, now)));
        self.ask(now);
    }

    /// Records that a connection is not open, for this reason.
    pub fn disconnected(&mut self, reason: SourceError) {
        self.unlink();
        self.down(reason);
    }

    fn unlink(&mut self) {
        self.state = State::Unlinked;
        (self.frames, self.packets) = (Frames::default(), Packets::default());
        self.out.clear();
        self.requests.clear();
        self.in_flight.clear();
        self.command = None;
    }

    /// Whether the connections must be closed.
    pub fn is_broken(&self) -> bool {
        self.broken
    }

    /// The pause before the next attempt to connect. It grows until scans arrive.
    pub fn next_retry(&mut self) -> Duration {
        let retry = self.retry;
        self.retry = (2 * retry).min(LONGEST_RETRY);
        retry
    }

    /// The next event.
    pub fn event(&mut self) -> Option<SourceEvent> {
        self.events.pop_front()
    }

    /// Takes a command, which replaces an older one that has not been sent. Without a stream the command is dropped.
    pub fn steer(&mut self, command: OutputCommand, now: Mono) {
        self.in_flight.expire(now);
        if matches!(self.state, State::Running(_)) && self.command.replace((command, now)).is_some() {
            self.counters.commands_replaced.inc();
        }
    }

    /// Sends the last command, and ends stream, watchdog and session. The answers may be awaited:
    /// [`Session::has_stopped`].
    pub fn stop(&mut self, now: Mono) {
        if !matches!(self.state, State::Running(_)) {
            return;
        }
        if let Some((command, _)) = self.command.take() {
            self.send_command(&command, now);
        }
        self.send(ENABLE, &[Value::U32(0)], Purpose::Other, now);
        if matches!(self.settings.watchdog, Watchdog::Parks { .. }) {
            self.send(WATCHDOG, &[Value::U32(0)], Purpose::Other, now);
        }
        self.send(USER_RAM.at(MARK), &[Value::U32(0)], Purpose::Other, now);
    }

    /// Whether the device has answered all requests.
    pub fn has_stopped(&self) -> bool {
        self.requests.is_empty()
    }

    /// The bytes to write next to the registers.
    pub fn output(&mut self, now: Mono) -> &[u8] {
        if self.out.is_empty()
            && self.in_flight.has_room()
            && let Some((command, _)) = self.command.take()
        {
            self.send_command(&command, now);
        }
        &self.out
    }

    /// Records that `bytes` bytes of the output have been written.
    pub fn written(&mut self, bytes: usize) {
        self.out.drain(..bytes);
    }

    fn send_command(&mut self, command: &OutputCommand, now: Mono) {
        let values =
            self.settings.outputs.and_then(|(outputs, _)| Some((outputs, outputs.values(command.codes)?)));
        let Some((outputs, values)) = values else {
            return self.events.push_back(SourceEvent::Ack(Ack { id: command.id, accepted: false }));
        };
        self.in_flight.sent(command, now);
        self.lease = Some((now + i64::from(command.lease_ms) * MS, command.on_expiry));
        self.send(outputs.first, &values, Purpose::Command(command.id), now);
    }

    fn send(&mut self, register: Register, values: &[Value], purpose: Purpose, now: Mono) {
        self.transaction = self.transaction.wrapping_add(1);
        Frame::write(self.transaction, register, values).encode(&mut self.out);
        self.requests.push_back((self.transaction, purpose, now + ANSWER_NS));
    }

    /// Sends the next request of the setup.
    fn ask(&mut self, now: Mono) {
        if let State::Setup(setup) = &mut self.state
            && let Some(frame) = setup.request(&mut self.transaction, now)
        {
            frame.encode(&mut self.out);
        }
    }

    /// Time at which [`Session::timed_out`] must be called if nothing arrives before.
    pub fn deadline(&self) -> Option<Mono> {
        match &self.state {
            State::Unlinked => None,
            State::Setup(setup) => Some(setup.until()),
            State::Running(running) => {
                let silent = running.give_up.unwrap_or(running.last_arrival + running.patience_ns);
                let answer = self.requests.front().map(|(_, _, until)| *until);
                let lease = self.lease.map(|(end, _)| end);
                [Some(silent), Some(running.next_beat), answer, lease].into_iter().flatten().min()
            }
        }
    }

    /// Handles what is due at `now`.
    pub fn timed_out(&mut self, now: Mono) {
        self.faults.tell(now);
        match &mut self.state {
            State::Setup(setup) if setup.until() <= now => match setup.timed_out() {
                Ok(()) => self.ask(now),
                Err(reason) => self.fail(reason),
            },
            State::Unlinked | State::Setup(_) => {}
            State::Running(_) => {
                self.expire_lease(now);
                self.check_silence(now);
                self.check_answers(now);
                self.beat(now);
            }
        }
    }

    fn expire_lease(&mut self, now: Mono) {
        let Some((_, action)) = self.lease.take_if(|(end, _)| *end <= now) else { return };
        self.counters.leases_expired.inc();
        if let (LeaseAction::Park, Some((outputs, park))) = (action, self.settings.outputs) {
            tracing::warn!("no steering command in time: the outputs are parked");
            self.send(outputs.first, &park, Purpose::Other, now);
        }
    }

    fn check_silence(&mut self, now: Mono) {
        let State::Running(running) = &mut self.state else { return };
        if running.give_up.is_some_and(|give_up| give_up <= now) {
            return self.fail("no scans arrive, and the connection does not end".into());
        }
        if running.give_up.is_none() && running.last_arrival + running.patience_ns <= now {
            running.give_up = Some(now + REST_NS);
            let silence_ms = ((now - running.last_arrival) / MS) as u32;
            self.down(SourceError::Stalled { silence_ms });
        }
    }

    fn check_answers(&mut self, now: Mono) {
        if self.requests.front().is_some_and(|(_, _, until)| *until <= now) {
            self.fail(format!("no answer to a request within {} ms", ANSWER_NS / MS));
        }
    }

    fn beat(&mut self, now: Mono) {
        let State::Running(running) = &mut self.state else { return };
        if running.next_beat <= now {
            running.next_beat = now + BEAT_NS;
            running.beats = running.beats.wrapping_add(1);
            let beats = running.beats;
            self.send(USER_RAM.at(BEAT), &[Value::U32(beats)], Purpose::Other, now);
        }
    }

    /// Takes bytes of the registers that arrived at `now`.
    pub fn answered(&mut self, bytes: &[u8], now: Mono) {
        self.frames.push(bytes);
        loop {
            match self.frames.next_frame() {
                Ok(Some(frame)) => self.answer(&frame, now),
                Ok(None) => break,
                Err(broken) => return self.fail(format!("its answers are not Modbus TCP: {broken}")),
            }
            if self.broken {
                return;
            }
        }
    }

    fn answer(&mut self, frame: &Frame, now: Mono) {
        match &mut self.state {
            State::Unlinked => {}
            State::Setup(setup) => match setup.answered(frame, now) {
                Ok(Progress::Continues) => self.ask(now),
                Ok(Progress::Done(started)) => self.started(started, now),
                Err(reason) => self.fail(reason),
            },
            State::Running(_) => self.executed(frame),
        }
    }

    /// A request while the stream runs has been answered.
    fn executed(&mut self, frame: &Frame) {
        let Some((number, purpose, _)) = self.requests.pop_front() else {
            return self.fail("it answers without a request".into());
        };
        if number != frame.transaction {
            return self.fail(format!("it answers request {} instead of {number}", frame.transaction));
        }
        match (frame.answer(WRITE), purpose) {
            (Err(broken), _) => self.fail(broken.to_string()),
            (Ok(answer), Purpose::Command(id)) => {
                if self.in_flight.acknowledged(id) {
                    self.events.push_back(SourceEvent::Ack(Ack { id, accepted: answer.is_ok() }));
                }
            }
            (Ok(Ok(_)), Purpose::Other) => {}
            (Ok(Err(code)), Purpose::Other) => {
                self.counters.board_errors.inc();
                tracing::warn!(code, "the T7 refuses a request");
            }
        }
    }

    fn started(&mut self, started: Started, now: Mono) {
        let Started { name, simulated, rate_hz, calibration } = started;
        let settings = &self.settings;
        let missed = self.last.map_or(0.0, |last| now.seconds_since(last) * rate_hz).round() as u64;
        self.index += missed;
        self.missed += missed;
        let scans_per_packet = settings.scans_per_packet();
        self.state = State::Running(Box::new(Running {
            calibration,
            assembler: Assembler::new(settings.inputs.len(), scans_per_packet),
            scans_per_packet,
            clock: ScanClock::new(rate_hz, settings.latency_ns, settings.silence, self.last),
            patience_ns: SilenceTimes::new(rate_hz, settings.silence).first.as_nanos() as i64,
            last_arrival: now,
            give_up: None,
            next_beat: now,
            beats: 0,
            begins: true,
        }));
        self.lease = None;
        self.reported = None;
        self.faults.restarted();
        let identity = self.settings.identity(name, rate_hz, &calibration, simulated);
        self.events.push_back(SourceEvent::Up(identity));
        self.streamed(&[], now); // what arrived before the answer
    }

    /// Takes bytes of the stream that arrived at `now`.
    pub fn streamed(&mut self, bytes: &[u8], now: Mono) {
        match &self.state {
            State::Unlinked => return,
            State::Setup(setup) if !setup.enabled => return, // of an earlier stream
            State::Setup(_) => return self.packets.push(bytes),
            State::Running(_) => self.packets.push(bytes),
        }
        let mut scans = Vec::new();
        loop {
            match self.packets.next_packet() {
                Ok(None) => break,
                Ok(Some(packet)) => {
                    let State::Running(running) = &mut self.state else { return };
                    let taken = running.assembler.take(&packet, &mut scans);
                    let whole = running.scans_per_packet;
                    scans.drain(..).for_each(|scan| self.scanned(&scan, now));
                    match taken {
                        Ok(arrived) => self.faults.packet(arrived, whole),
                        Err(end) => return self.fail(end.to_string()),
                    }
                }
                Err(error) => {
                    self.counters.frames_corrupted.inc();
                    return self.fail(format!("its stream is not one: {error}"));
                }
            }
        }
        self.faults.tell(now);
    }

    fn scanned(&mut self, scan: &StreamScan, now: Mono) {
        let State::Running(running) = &mut self.state else { return };
        let (moment, periods) = running.clock.moment(scan, now);
        let lost = u64::from(periods - 1) + std::mem::take(&mut self.missed);
        self.index += u64::from(periods - 1);
        running.last_arrival = now;
        if running.give_up.take().is_some() {
            tracing::info!("scans have resumed");
            self.reported = None;
        }
        let calibration = running.calibration;
        let begins = std::mem::take(&mut running.begins);
        let lost = u32::try_from(lost).unwrap_or(u32::MAX);
        self.faults.lost(lost);
        if let Some(fault) = moment.fault {
            self.faults.clock(fault, scan.tick);
        }
        if begins {
            self.send(USER_RAM.at(BEGIN), &[Value::U32(scan.tick)], Purpose::Other, now);
        }
        self.last = Some(moment.time);
        self.retry = FIRST_RETRY;
        self.events.push_back(SourceEvent::Scan(Scan {
            index: self.index,
            time: moment.time,
            time_sigma_ns: Some(moment.sigma_ns),
            lost,
            codes: scan.samples.map(|sample| calibration.code(sample)),
            output_railed: false,
            applied: None,
        }));
        self.index += 1;
    }

    /// The device cannot be used for this reason; the connections are closed and made anew.
    fn fail(&mut self, reason: String) {
        self.unlink();
        self.broken = true;
        let what = format!("the LabJack T7 at {}", self.settings.address);
        self.down(SourceError::Unfit { what, reason });
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
