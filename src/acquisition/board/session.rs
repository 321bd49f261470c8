//! The host's side of the conversation, without the wire: bytes and times in, events and bytes out.

use std::{collections::VecDeque, sync::Arc};

use super::{
    Answer, Arrival, BoardIdentity, Deframer, MessageError, Request, Sequence,
    message::{BoardScan, ErrorReason, Reply, StartResult},
    tally::{Mishap, Tally},
};
use crate::{
    acquisition::{Down, Event, OutputCommand, Scan, timebase::Timebase},
    clock::{Mono, NS_PER_S},
    config::Config,
    monitor::Counters,
};

const MS: i64 = NS_PER_S / 1000;
/// How long a board may take to answer, milliseconds.
const ANSWER_MS: u32 = 500;
/// How long the host keeps still after something went wrong, before it asks again.
const REST_NS: i64 = NS_PER_S;
/// Scans have stalled after this long ...
const STALL_NS: i64 = 20 * MS;
/// ... or after so many periods, whichever is longer.
const STALL_PERIODS: f64 = 5.0;

/// What the host wants of the board.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Scans per second.
    pub rate_hz: f64,
    /// Bits per second on the wire.
    pub baud: u32,
    /// Fixed time from scan to arrival, nanoseconds.
    pub latency_ns: i64,
    /// Parking position in parts of full scale.
    pub park: [f64; 2],
}

impl From<&Config> for Settings {
    fn from(config: &Config) -> Self {
        let serial = &config.acquisition.serial;
        Self {
            rate_hz: config.acquisition.rate_hz,
            baud: serial.baud,
            latency_ns: (serial.latency_us * 1e3).round() as i64,
            park: config.steering.park_um.map(|um| um / config.steering.full_scale_um),
        }
    }
}

/// Where the conversation stands.
#[derive(Debug)]
enum State {
    /// No wire.
    Unlinked,
    /// IDENTIFY was sent.
    Identifying { until: Mono },
    /// START was sent.
    Starting { board: BoardIdentity, until: Mono },
    /// Scans are coming.
    Running(Running),
    /// Something went wrong; scans that come all the same are welcome if they had only stalled.
    Resting { until: Mono, stalled: Option<Running> },
}

#[derive(Debug)]
struct Running {
    channels: usize,
    timebase: Timebase,
    /// Silence that counts as a stall.
    patience_ns: i64,
    /// Arrival of the last new scan.
    heard: Mono,
    lease_expired: bool,
}

/// The conversation with one board, through all its failures.
#[derive(Debug)]
pub struct Session {
    settings: Settings,
    state: State,
    deframer: Deframer,
    sequence: Sequence,
    tally: Tally,
    /// Time of the last scan of all.
    last: Option<Mono>,
    events: VecDeque<Event>,
    /// Why no scans come, as last told.
    told: Option<Down>,
    /// Frames under way to the wire.
    out: Vec<u8>,
    /// The newest command, not yet under way.
    command: Option<OutputCommand>,
    /// Corrupted frames while no answer came.
    garbage: u32,
}

impl Session {
    /// A conversation that has not begun.
    pub fn new(settings: Settings, counters: Arc<Counters>) -> Self {
        Self {
            settings,
            state: State::Unlinked,
            deframer: Deframer::default(),
            sequence: Sequence::default(),
            tally: Tally::new(counters),
            last: None,
            events: VecDeque::new(),
            told: None,
            out: Vec::new(),
            command: None,
            garbage: 0,
        }
    }

    /// The wire is there.
    pub fn connected(&mut self, now: Mono) {
        self.deframer = Deframer::default();
        self.identify(now);
    }

    /// The wire is not there, for this reason.
    pub fn disconnected(&mut self, reason: Down) {
        self.state = State::Unlinked;
        self.out.clear();
        self.down(reason);
    }

    /// The next thing to tell.
    pub fn event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Takes a command; it replaces one that is not yet under way. Without a running board it is
    /// dropped: it would be an old one by the time the board is back.
    pub fn steer(&mut self, command: OutputCommand) {
        if matches!(self.state, State::Running(_)) {
            self.command = Some(command);
        }
    }

    /// Asks the board to scan no more, after the last command.
    pub fn stop(&mut self) {
        if let Some(command) = self.command.take() {
            Request::Steer(command).encode(&mut self.out);
        }
        Request::Stop.encode(&mut self.out);
    }

    /// What is to be written next.
    pub fn output(&mut self) -> &[u8] {
        if self.out.is_empty()
            && let Some(command) = self.command.take()
        {
            Request::Steer(command).encode(&mut self.out);
        }
        &self.out
    }

    /// So many bytes of the output are written.
    pub fn written(&mut self, bytes: usize) {
        self.out.drain(..bytes);
    }

    /// When [`Session::timed_out`] wants to be called, if nothing comes before.
    pub fn deadline(&self) -> Option<Mono> {
        match &self.state {
            State::Unlinked => None,
            State::Identifying { until } | State::Starting { until, .. } | State::Resting { until, .. } => {
                Some(*until)
            }
            State::Running(running) => Some(running.heard + running.patience_ns),
        }
    }

    /// Does what is due at `now`.
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
                let silence_ms = ((now - running.heard) / MS) as u32;
                self.rest(Down::Stalled { silence_ms }, now);
                self.state = State::Resting { until: now + REST_NS, stalled: Some(running) };
            }
        }
    }

    /// Takes what arrived at `now`.
    pub fn received(&mut self, mut bytes: &[u8], now: Mono) {
        let mut deframer = std::mem::take(&mut self.deframer);
        while let Some(frame) = deframer.next(&mut bytes) {
            match frame.map(Answer::decode) {
                Ok(Ok(answer)) => self.answered(answer, now),
                Ok(Err(error)) => self.not_understood(error, now),
                Err(_) if self.scanning() => self.tally.count(Mishap::Corrupted),
                Err(_) => self.garbage += 1,
            }
        }
        self.deframer = deframer;
        self.tally.tell(now);
    }

    /// Whether scans are expected, so that what is damaged is a loss.
    fn scanning(&self) -> bool {
        matches!(self.state, State::Running(_) | State::Resting { stalled: Some(_), .. })
    }

    fn identify(&mut self, now: Mono) {
        self.out.clear();
        self.out.push(0); // ends whatever half a frame the board may have seen
        Request::Identify.encode(&mut self.out);
        self.garbage = 0;
        self.state = State::Identifying { until: now + i64::from(ANSWER_MS) * MS };
    }

    fn answered(&mut self, answer: Answer, now: Mono) {
        match (answer, &mut self.state) {
            (Answer::Scan(scan), State::Running(_) | State::Resting { stalled: Some(_), .. }) => {
                self.scanned(&scan, now);
            }
            (Answer::Ack { id, result }, State::Running(_)) => {
                self.events.push_back(Event::Ack(result.ack(id)));
            }
            (Answer::Identity(board), State::Identifying { .. }) => self.identified(board, now),
            (Answer::Reply(reply @ Reply { start: true, .. }), State::Starting { .. }) => {
                self.started(reply, now);
            }
            (Answer::Error { reason: ErrorReason::Version, .. }, State::Identifying { .. }) => {
                self.unfit("it does not speak version 1 of the protocol".into(), now);
            }
            (Answer::Error { .. }, _) => self.tally.count(Mishap::BoardError),
            // Scans from before START, and answers that come after the time for them.
            (Answer::Scan(_) | Answer::Ack { .. } | Answer::Identity(_) | Answer::Reply(_), _) => {}
        }
    }

    fn not_understood(&mut self, error: MessageError, now: Mono) {
        if let (MessageError::Version { .. }, State::Identifying { .. }) = (error, &self.state) {
            return self.unfit(error.to_string(), now);
        }
        tracing::debug!("board link: {error}");
        self.tally.count(Mishap::Unknown);
    }

    fn identified(&mut self, board: BoardIdentity, now: Mono) {
        if let Err(reason) = board.check(&self.settings) {
            return self.unfit(format!("{}: {reason}", board.name), now);
        }
        let park = board.output_codes(self.settings.park);
        let rate_mhz = (self.settings.rate_hz * 1e3).round() as u32;
        Request::Start { rate_mhz, park }.encode(&mut self.out);
        self.state = State::Starting { board, until: now + i64::from(ANSWER_MS) * MS };
    }

    fn started(&mut self, reply: Reply, now: Mono) {
        let State::Starting { board, .. } = std::mem::replace(&mut self.state, State::Unlinked) else {
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
        self.state = State::Running(Running {
            channels: board.roles.len(),
            timebase: Timebase::new(board.tick_hz, self.settings.latency_ns, self.last),
            patience_ns: STALL_NS.max((STALL_PERIODS / rate_hz * NS_PER_S as f64) as i64),
            heard: now,
            lease_expired: true, // of the daemon before this one: no news
        });
        tracing::debug!("board started: {}, {} channels at {rate_hz} Hz", board.name, board.roles.len());
        self.told = None;
        self.events.push_back(Event::Up(board.identity(rate_hz)));
    }

    fn scanned(&mut self, scan: &BoardScan, now: Mono) {
        let (State::Running(running) | State::Resting { stalled: Some(running), .. }) = &mut self.state
        else {
            return;
        };
        if usize::from(scan.channels) != running.channels {
            return self.tally.count(Mishap::Unknown);
        }
        let (index, lost) = match self.sequence.arrived(scan.sequence) {
            Arrival::New { index, lost } => (index, lost),
            Arrival::Repeated => return self.tally.count(Mishap::Repeated),
            Arrival::Late => return self.tally.count(Mishap::Late),
        };
        self.tally.lost(lost);
        if scan.overrun {
            self.tally.count(Mishap::Overrun);
        }
        if scan.lease_expired && !running.lease_expired {
            self.tally.count(Mishap::LeaseExpired);
        }
        running.lease_expired = scan.lease_expired;
        running.heard = now;
        let moment = running.timebase.moment(scan.tick, now);
        self.last = Some(moment.time);
        self.events.push_back(Event::Scan(Scan {
            index,
            time: moment.time,
            time_sigma_ns: Some(moment.sigma_ns),
            lost,
            codes: scan.codes,
            output_railed: scan.output_railed,
        }));
        self.resume();
    }

    /// Scans that had stalled are back.
    fn resume(&mut self) {
        if let State::Resting { stalled, .. } = &mut self.state
            && let Some(running) = stalled.take()
        {
            tracing::info!("scans are back");
            self.state = State::Running(running);
            self.told = None;
        }
    }

    fn unanswered(&mut self, step: &'static str, now: Mono) {
        if self.garbage > 0 {
            let (frames, baud) = (self.garbage, self.settings.baud);
            tracing::warn!(
                "{frames} corrupted frames instead of an answer: does the board run at {baud} baud?"
            );
        }
        self.rest(Down::Timeout { step, timeout_ms: ANSWER_MS }, now);
    }

    fn unfit(&mut self, reason: String, now: Mono) {
        self.rest(Down::Unfit(reason), now);
    }

    fn rest(&mut self, reason: Down, now: Mono) {
        self.state = State::Resting { until: now + REST_NS, stalled: None };
        self.down(reason);
    }

    /// Tells why no scans come, once for each reason.
    fn down(&mut self, reason: Down) {
        self.command = None;
        if self.told.as_ref() != Some(&reason) {
            self.told = Some(reason.clone());
            self.events.push_back(Event::Down(reason));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::acquisition::{Ack, Converter, Expiry, Role, board::message::SteerResult, scan::SIGNALS};

    const START: Mono = Mono(50 * NS_PER_S);

    fn board() -> BoardIdentity {
        BoardIdentity {
            tick_hz: 1_000_000,
            converter: Converter { bits: 18, range_v: 10.0 },
            output_bits: 16,
            simulated: false,
            rate_mhz: [1_000, 20_000_000],
            roles: SIGNALS.to_vec(),
            skew_ns: vec![0; 9],
            name: "bench board".into(),
        }
    }

    /// A session and the clock of its host, played from the board's side.
    struct Bench {
        session: Session,
        counters: Arc<Counters>,
        now: Mono,
    }

    impl Bench {
        fn new() -> Self {
            let counters = Arc::new(Counters::default());
            let settings = Settings { rate_hz: 1000.0, baud: 921_600, latency_ns: 0, park: [0.2, -0.2] };
            let session = Session::new(settings, Arc::clone(&counters));
            Self { session, counters, now: START }
        }

        fn running() -> Self {
            let mut bench = Self::new();
            bench.session.connected(bench.now);
            bench.start(&board());
            assert!(matches!(bench.session.event(), Some(Event::Up(_))));
            bench
        }

        fn start(&mut self, board: &BoardIdentity) {
            assert_eq!(self.requests(), [Request::Identify]);
            self.answer(&Answer::Identity(board.clone()));
            self.requests();
            self.answer(&Answer::Reply(Reply {
                start: true,
                result: StartResult::Done,
                rate_mhz: 1_000_000,
            }));
        }

        /// What the session wrote.
        fn requests(&mut self) -> Vec<Request> {
            let (mut requests, mut deframer) = (Vec::new(), Deframer::default());
            loop {
                let bytes = self.session.output().to_vec();
                if bytes.is_empty() {
                    return requests;
                }
                let mut rest = &bytes[..];
                while let Some(frame) = deframer.next(&mut rest) {
                    requests.push(Request::decode(frame.unwrap()).unwrap());
                }
                self.session.written(bytes.len());
            }
        }

        fn answer(&mut self, answer: &Answer) {
            let mut bytes = Vec::new();
            answer.encode(&mut bytes);
            self.session.received(&bytes, self.now);
        }

        /// The board's scan number `sequence` arrives, one period after the last thing.
        fn scan(&mut self, sequence: u32) -> Option<Event> {
            self.now = self.now + MS;
            let tick = ((self.now - START) / 1000) as u32;
            self.answer(&Answer::Scan(BoardScan { sequence, tick, channels: 9, ..BoardScan::default() }));
            self.session.event()
        }

        fn index(&mut self, sequence: u32) -> (u64, u32) {
            match self.scan(sequence) {
                Some(Event::Scan(scan)) => (scan.index, scan.lost),
                other => panic!("no scan but {other:?}"),
            }
        }

        fn wait(&mut self, ns: i64) {
            self.now = self.now + ns;
            self.session.timed_out(self.now);
        }
    }

    #[test]
    fn a_board_is_identified_started_and_heard() {
        let mut bench = Bench::new();
        bench.session.connected(bench.now);
        assert_eq!(bench.requests(), [Request::Identify]);
        bench.answer(&Answer::Scan(BoardScan { sequence: 77, channels: 9, ..BoardScan::default() }));
        bench.answer(&Answer::Identity(board()));
        let park = [6554, -6554];
        assert_eq!(bench.requests(), [Request::Start { rate_mhz: 1_000_000, park }]);
        bench.answer(&Answer::Reply(Reply { start: true, result: StartResult::Done, rate_mhz: 999_000 }));
        let Some(Event::Up(identity)) = bench.session.event() else { panic!("not up") };
        assert_eq!((identity.rate_hz, identity.roles.len(), identity.simulated), (999.0, 9, false));
        assert_eq!(bench.index(0), (0, 0));
        assert_eq!(bench.index(1), (1, 0));
    }

    #[test]
    fn every_mishap_is_counted_in_its_place() {
        let mut bench = Bench::running();
        bench.index(0);
        assert_eq!(bench.index(3), (3, 2));
        assert_eq!(bench.scan(3), None);
        assert_eq!(bench.scan(1), None);
        bench.session.received(&[5, 5, 5, 0], bench.now);
        bench.answer(&Answer::Scan(BoardScan { sequence: 4, channels: 12, ..BoardScan::default() }));
        let mut frame = Vec::new();
        super::super::frame::encode(&[0x99, 1], &mut frame);
        bench.session.received(&frame, bench.now);
        bench.answer(&Answer::Error { reason: ErrorReason::Corrupted, kind: 0 });
        let counters = &bench.counters;
        assert_eq!(counters.scans_lost.get(), 2);
        assert_eq!(counters.scans_repeated.get(), 1);
        assert_eq!(counters.scans_late.get(), 1);
        assert_eq!(counters.frames_corrupted.get(), 1);
        assert_eq!(counters.frames_unknown.get(), 2);
        assert_eq!(counters.board_errors.get(), 1);
        assert_eq!(bench.index(4), (4, 0));
    }

    #[test]
    fn a_stall_is_told_and_scans_may_come_back_by_themselves() {
        let mut bench = Bench::running();
        bench.index(0);
        bench.wait(19 * MS);
        assert_eq!(bench.session.event(), None);
        bench.wait(MS);
        assert_eq!(bench.session.event(), Some(Event::Down(Down::Stalled { silence_ms: 20 })));
        bench.session.steer(OutputCommand { id: 1, codes: [1, 1], lease_ms: 200, on_expiry: Expiry::Hold });
        assert_eq!(bench.requests(), []);
        assert_eq!(bench.index(22), (22, 21));
        assert_eq!(bench.index(23), (23, 0));
        bench.wait(20 * MS);
        assert!(matches!(bench.session.event(), Some(Event::Down(Down::Stalled { .. }))));
    }

    #[test]
    fn a_board_that_lost_its_power_is_started_again_and_the_index_goes_on() {
        let mut bench = Bench::running();
        (0..100).for_each(|k| drop(bench.scan(k)));
        bench.wait(20 * MS);
        assert!(matches!(bench.session.event(), Some(Event::Down(Down::Stalled { .. }))));
        bench.wait(NS_PER_S);
        bench.wait(500 * MS);
        let timeout = Down::Timeout { step: "identify", timeout_ms: 500 };
        assert_eq!(bench.session.event(), Some(Event::Down(timeout)));
        bench.wait(NS_PER_S);
        bench.wait(500 * MS);
        assert_eq!(bench.session.event(), None, "the same reason is told once");
        bench.wait(NS_PER_S);
        bench.requests();
        bench.session.connected(bench.now);
        bench.start(&board());
        assert!(matches!(bench.session.event(), Some(Event::Up(_))));
        assert_eq!(bench.index(0), (99 + 4020 + 1, 4020));
        assert_eq!(bench.counters.scans_lost.get(), 4020);
    }

    #[test]
    fn a_scan_after_a_reconnect_is_younger_than_those_before() {
        let mut bench = Bench::running();
        let Some(Event::Scan(before)) = bench.scan(0) else { panic!("no scan") };
        let gone = Down::Unplugged { port: "/dev/null".into(), reason: "pulled".into() };
        bench.session.disconnected(gone.clone());
        assert_eq!(bench.session.event(), Some(Event::Down(gone)));
        assert_eq!(bench.session.deadline(), None);
        bench.session.connected(bench.now);
        bench.start(&board());
        bench.session.event();
        let Some(Event::Scan(after)) = bench.scan(0) else { panic!("no scan") };
        assert!(after.index > before.index && after.time > before.time);
    }

    #[test]
    fn only_the_newest_command_is_sent_and_its_answer_is_told() {
        let mut bench = Bench::running();
        let command = |id| OutputCommand { id, codes: [-5, 5], lease_ms: 200, on_expiry: Expiry::Park };
        (1..=3).for_each(|id| bench.session.steer(command(id)));
        assert_eq!(bench.requests(), [Request::Steer(command(3))]);
        bench.answer(&Answer::Ack { id: 3, result: SteerResult::OutOfRange });
        assert_eq!(bench.session.event(), Some(Event::Ack(Ack { id: 3, accepted: false })));
        bench.session.steer(command(4));
        bench.session.stop();
        assert_eq!(bench.requests(), [Request::Steer(command(4)), Request::Stop]);
    }

    #[test]
    fn a_board_that_cannot_be_used_is_told_why() {
        let twice = |roles: &mut Vec<Role>| roles[3] = Role::U(0);
        let mut boards = [board(), board(), board(), board(), board(), board()];
        twice(&mut boards[0].roles);
        boards[1].roles.truncate(8);
        boards[2].rate_mhz = [1_000, 500_000];
        boards[3].converter.bits = 32;
        boards[4].tick_hz = 1000;
        boards[5].roles.resize(17, Role::Auxiliary);
        for board in &mut boards {
            board.skew_ns.resize(board.roles.len(), 0);
        }
        let reasons = ["u of PSD A", "8 channels", "1 to 500 Hz", "32 bits", "1000 Hz", "17 channels"];
        for (board, reason) in boards.iter().zip(reasons) {
            let mut bench = Bench::new();
            bench.session.connected(bench.now);
            bench.start(board);
            match bench.session.event() {
                Some(Event::Down(Down::Unfit(told))) => assert!(told.contains(reason), "{told}"),
                other => panic!("{reason}: {other:?}"),
            }
            bench.wait(NS_PER_S);
            assert_eq!(bench.requests(), [Request::Identify], "asks again after a while");
        }
    }

    #[test]
    fn a_board_of_another_version_is_told_as_such() {
        let mut bench = Bench::new();
        bench.session.connected(bench.now);
        let mut frame = Vec::new();
        super::super::frame::encode(&[0x81, 2, 9, 9, 9], &mut frame);
        bench.session.received(&frame, bench.now);
        let Some(Event::Down(Down::Unfit(reason))) = bench.session.event() else { panic!("no reason") };
        assert!(reason.contains("version 2"), "{reason}");
        bench.session.connected(bench.now);
        bench.answer(&Answer::Error { reason: ErrorReason::Version, kind: 1 });
        let Some(Event::Down(Down::Unfit(reason))) = bench.session.event() else { panic!("no reason") };
        assert!(reason.contains("version 1"), "{reason}");
    }

    #[test]
    fn a_wire_too_slow_for_the_rate_is_refused() {
        let mut bench = Bench::new();
        bench.session.settings.baud = 115_200;
        bench.session.connected(bench.now);
        bench.start(&board());
        let Some(Event::Down(Down::Unfit(reason))) = bench.session.event() else { panic!("no reason") };
        assert!(reason.contains("115200") && reason.contains("600000"), "{reason}");
    }
}
