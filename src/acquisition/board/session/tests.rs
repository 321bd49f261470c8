use std::time::Duration;

use trifacet_wire::actuator::{Ack, LeaseAction};
use trifacet_wire::board::Extension;
use trifacet_wire::board::message::SteerResult;
use trifacet_wire::channel::{Converter, Role, SIGNALS};

use super::*;

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
        extensible: false,
        extension: None,
    }
}

/// A session with the clock of its host; the test plays the board.
struct Bench {
    session: Session,
    counters: Arc<Counters>,
    now: Mono,
}

impl Bench {
    fn new() -> Self {
        let counters = Arc::new(Counters::default());
        let settings = Settings {
            rate_hz: 1000.0,
            baud: Some(921_600),
            latency_ns: 0,
            park: [0.2, -0.2],
            silence: Duration::from_millis(20),
            most_in_flight: 3,
        };
        let session = Session::new(settings, Arc::clone(&counters));
        Self { session, counters, now: START }
    }

    fn running() -> Self {
        let mut bench = Self::new();
        bench.session.connected(bench.now);
        bench.start(&board());
        assert!(matches!(bench.session.event(), Some(SourceEvent::Up(_))));
        bench
    }

    fn start(&mut self, board: &BoardIdentity) {
        assert_eq!(self.requests(), [Request::Identify { minor: 0 }]);
        self.answer(&Answer::Identity(board.clone()));
        self.requests();
        self.answer(&Answer::Reply(Reply { start: true, result: StartResult::Done, rate_mhz: 1_000_000 }));
    }

    fn steer(&mut self, id: u32) {
        let command = OutputCommand { id, codes: [1, 1], lease_ms: 200, on_expiry: LeaseAction::Hold };
        self.session.steer(command, self.now);
    }

    /// The ids of the commands that the session sends now.
    fn steered(&mut self) -> Vec<u32> {
        let id = |request| match request {
            Request::Steer(command) => command.id,
            other => panic!("{other:?}"),
        };
        self.requests().into_iter().map(id).collect()
    }

    /// The requests that the session wrote.
    fn requests(&mut self) -> Vec<Request> {
        let (mut requests, mut deframer) = (Vec::new(), Deframer::default());
        loop {
            let bytes = self.session.output().to_vec();
            if bytes.is_empty() {
                return requests;
            }
            let mut rest = &bytes[..];
            while let Some(frame) = deframer.next(&mut rest) {
                requests.push(Request::decode(frame.unwrap(), MINOR).unwrap());
            }
            self.session.written(bytes.len());
        }
    }

    fn answer(&mut self, answer: &Answer) {
        let mut bytes = Vec::new();
        answer.encode(&mut bytes);
        self.session.received(&bytes, self.now);
    }

    /// The scan number `sequence` of the board arrives, one period after the last event.
    fn scan(&mut self, sequence: u32) -> Option<SourceEvent> {
        self.now = self.now + MS;
        let tick = ((self.now - START) / 1000) as u64;
        self.answer(&Answer::Scan(BoardScan { sequence, tick, channels: 9, ..BoardScan::default() }));
        self.session.event()
    }

    fn index(&mut self, sequence: u32) -> (u64, u32) {
        match self.scan(sequence) {
            Some(SourceEvent::Scan(scan)) => (scan.index, scan.lost),
            other => panic!("no scan but {other:?}"),
        }
    }

    fn wait(&mut self, ns: i64) {
        self.now = self.now + ns;
        self.session.timed_out(self.now);
    }
}

#[test]
fn a_board_is_identified_started_and_its_scans_arrive() {
    let mut bench = Bench::new();
    bench.session.connected(bench.now);
    assert_eq!(bench.requests(), [Request::Identify { minor: 0 }]);
    bench.answer(&Answer::Scan(BoardScan { sequence: 77, channels: 9, ..BoardScan::default() }));
    bench.answer(&Answer::Identity(board()));
    let park = [6554, -6554];
    assert_eq!(bench.requests(), [Request::Start { rate_mhz: 1_000_000, park, minor: 0 }]);
    bench.answer(&Answer::Reply(Reply { start: true, result: StartResult::Done, rate_mhz: 999_000 }));
    let Some(SourceEvent::Up(identity)) = bench.session.event() else { panic!("not up") };
    assert_eq!((identity.rate_hz, identity.roles.len(), identity.simulated), (999.0, 9, false));
    assert_eq!(bench.index(0), (0, 0));
    assert_eq!(bench.index(1), (1, 0));
}

#[test]
fn each_kind_of_fault_has_its_counter() {
    let mut bench = Bench::running();
    bench.index(0);
    assert_eq!(bench.index(3), (3, 2));
    assert_eq!(bench.scan(3), None);
    assert_eq!(bench.scan(1), None);
    bench.session.received(&[5, 5, 5, 0], bench.now);
    bench.answer(&Answer::Scan(BoardScan { sequence: 4, channels: 12, ..BoardScan::default() }));
    let mut frame = Vec::new();
    trifacet_wire::board::framing::encode(&[0x99, 1], &mut frame);
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

/// The same board with version 1.1.
fn newer_board(boot_id: u32) -> BoardIdentity {
    let extension = Extension { minor: 1, wide_tick: true, boot_id, units: Vec::new() };
    BoardIdentity { extensible: true, extension: Some(extension), ..board() }
}

const WIDE: ScanFormat = ScanFormat::Long { wide_tick: true };

impl Bench {
    /// A board of version 1.1 is identified and started.
    fn start_newer(&mut self, boot_id: u32) {
        let newer = newer_board(boot_id);
        assert_eq!(self.requests(), [Request::Identify { minor: 0 }]);
        self.answer(&Answer::Identity(BoardIdentity { extension: None, ..newer.clone() }));
        assert_eq!(self.requests(), [Request::Identify { minor: 1 }]);
        self.answer(&Answer::Identity(newer));
        assert!(matches!(self.requests()[..], [Request::Start { minor: 1, .. }]));
        self.answer(&Answer::Reply(Reply { start: true, result: StartResult::Done, rate_mhz: 1_000_000 }));
        assert!(matches!(self.session.event(), Some(SourceEvent::Up(_))));
    }
}

#[test]
fn a_board_of_version_1_1_sends_long_scans_and_others_are_dropped() {
    let mut bench = Bench::new();
    bench.session.connected(bench.now);
    bench.start_newer(1);
    assert_eq!(bench.scan(0), None, "a short scan");
    assert_eq!(bench.counters.frames_unknown.get(), 1);
    let tick = 1 << 40;
    bench.answer(&Answer::Scan(BoardScan { format: WIDE, tick, channels: 9, ..BoardScan::default() }));
    assert!(matches!(bench.session.event(), Some(SourceEvent::Scan(_))));
}

#[test]
fn a_line_without_room_for_long_scans_carries_short_ones() {
    let mut bench = Bench::new();
    bench.session.settings.baud = Some(610_000);
    bench.session.connected(bench.now);
    bench.requests();
    bench.answer(&Answer::Identity(newer_board(1)));
    bench.requests();
    bench.answer(&Answer::Identity(newer_board(1)));
    assert!(matches!(bench.requests()[..], [Request::Start { minor: 0, .. }]));
}

#[test]
fn a_restart_of_the_board_is_noticed_at_once_by_its_boot_id() {
    let mut bench = Bench::new();
    bench.session.connected(bench.now);
    bench.start_newer(1);
    bench.wait(20 * MS);
    assert!(matches!(bench.session.event(), Some(SourceEvent::Down(SourceError::Stalled { .. }))));
    assert_eq!(bench.requests(), [Request::Identify { minor: 1 }]);
    bench.answer(&Answer::Identity(newer_board(1)));
    assert_eq!(bench.requests(), [], "the same boot: it may resume");
    bench.answer(&Answer::Identity(newer_board(2)));
    assert!(matches!(bench.requests()[..], [Request::Start { minor: 1, .. }]), "without a pause");
    assert_eq!(bench.counters.board_restarts.get(), 1);
    // Unplugged and plugged in again: the same boot, then another one.
    let gone = SourceError::Unplugged { port: "/dev/null".into(), reason: "pulled".into() };
    for (boot_id, restarts) in [(2, 1), (3, 2)] {
        bench.session.disconnected(gone.clone());
        bench.session.connected(bench.now);
        while bench.session.event().is_some() {}
        bench.start_newer(boot_id);
        assert_eq!(bench.counters.board_restarts.get(), restarts);
    }
}

#[test]
fn a_stall_is_reported_and_scans_may_resume_by_themselves() {
    let mut bench = Bench::running();
    bench.index(0);
    bench.wait(19 * MS);
    assert_eq!(bench.session.event(), None);
    bench.wait(MS);
    assert_eq!(bench.session.event(), Some(SourceEvent::Down(SourceError::Stalled { silence_ms: 20 })));
    let command = OutputCommand { id: 1, codes: [1, 1], lease_ms: 200, on_expiry: LeaseAction::Hold };
    bench.session.steer(command, bench.now);
    assert_eq!(bench.requests(), [Request::Steer(command)], "a stalled board may still receive");
    bench.answer(&Answer::Ack { id: 1, result: SteerResult::Accepted });
    assert_eq!(bench.session.event(), Some(SourceEvent::Ack(Ack { id: 1, accepted: true })));
    assert_eq!(bench.index(22), (22, 21));
    assert_eq!(bench.index(23), (23, 0));
    bench.wait(20 * MS);
    assert!(matches!(bench.session.event(), Some(SourceEvent::Down(SourceError::Stalled { .. }))));
}

#[test]
fn a_board_is_restarted_after_a_power_failure_and_the_index_continues() {
    let mut bench = Bench::running();
    (0..100).for_each(|k| drop(bench.scan(k)));
    bench.wait(20 * MS);
    assert!(matches!(bench.session.event(), Some(SourceEvent::Down(SourceError::Stalled { .. }))));
    bench.steer(1);
    bench.wait(NS_PER_S);
    assert_eq!(bench.requests(), [Request::Identify { minor: 0 }], "an old command is dropped");
    bench.wait(500 * MS);
    let Some(SourceEvent::Down(reason)) = bench.session.event() else { panic!("no reason") };
    assert!(
        reason.to_string().starts_with("no answer to identify within 500 ms; nothing arrives"),
        "{reason}"
    );
    bench.wait(NS_PER_S);
    bench.wait(500 * MS);
    assert_eq!(bench.session.event(), None, "the same reason is reported once");
    bench.wait(NS_PER_S);
    bench.requests();
    bench.session.connected(bench.now);
    bench.start(&board());
    assert!(matches!(bench.session.event(), Some(SourceEvent::Up(_))));
    assert_eq!(bench.index(0), (99 + 4020 + 1, 4020));
    assert_eq!(bench.counters.scans_lost.get(), 4020);
}

#[test]
fn scans_after_a_reconnect_are_later_than_those_before() {
    let mut bench = Bench::running();
    let Some(SourceEvent::Scan(before)) = bench.scan(0) else { panic!("no scan") };
    let gone = SourceError::Unplugged { port: "/dev/null".into(), reason: "pulled".into() };
    bench.session.disconnected(gone.clone());
    assert_eq!(bench.session.event(), Some(SourceEvent::Down(gone)));
    assert_eq!(bench.session.deadline(), None);
    bench.session.connected(bench.now);
    bench.start(&board());
    bench.session.event();
    let Some(SourceEvent::Scan(after)) = bench.scan(0) else { panic!("no scan") };
    assert!(after.index > before.index && after.time > before.time);
}

#[test]
fn only_the_newest_command_is_sent_and_its_answer_is_reported() {
    let mut bench = Bench::running();
    let command = |id| OutputCommand { id, codes: [-5, 5], lease_ms: 200, on_expiry: LeaseAction::Park };
    (1..=3).for_each(|id| bench.session.steer(command(id), bench.now));
    assert_eq!(bench.requests(), [Request::Steer(command(3))]);
    bench.answer(&Answer::Ack { id: 3, result: SteerResult::OutOfRange });
    assert_eq!(bench.session.event(), Some(SourceEvent::Ack(Ack { id: 3, accepted: false })));
    bench.session.steer(command(4), bench.now);
    bench.session.stop();
    assert_eq!(bench.requests(), [Request::Steer(command(4)), Request::Stop]);
}

#[test]
fn a_board_that_does_not_answer_gets_few_commands_and_then_the_newest() {
    let mut bench = Bench::running();
    let mut sent = Vec::new();
    for id in 1..=90 {
        bench.steer(id);
        sent.extend(bench.steered());
        bench.now = bench.now + MS;
    }
    assert_eq!(sent, [1, 2, 3], "the limit of the bench");
    assert_eq!(bench.counters.commands_replaced.get(), 86);
    bench.answer(&Answer::Ack { id: 77, result: SteerResult::Accepted });
    bench.answer(&Answer::Ack { id: 2, result: SteerResult::Accepted });
    bench.answer(&Answer::Ack { id: 1, result: SteerResult::Accepted });
    assert_eq!(bench.session.event(), Some(SourceEvent::Ack(Ack { id: 2, accepted: true })));
    assert_eq!(bench.session.event(), None);
    assert_eq!(bench.counters.acks_unknown.get(), 2);
    assert_eq!(bench.steered(), [90], "the newest");
    // After half of its lease a command counts as lost.
    for id in 91..=400 {
        bench.steer(id);
        sent.extend(bench.steered());
        bench.now = bench.now + MS;
    }
    assert!((10..20).contains(&sent.len()), "{sent:?}");
}

#[test]
fn an_unusable_board_is_reported_with_the_reason() {
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
            Some(SourceEvent::Down(SourceError::Unfit { reason: message, .. })) => {
                assert!(message.contains(reason), "{message}");
            }
            other => panic!("{reason}: {other:?}"),
        }
        bench.wait(NS_PER_S);
        assert_eq!(bench.requests(), [Request::Identify { minor: 0 }], "a new request after the pause");
    }
}

#[test]
fn a_board_of_another_version_is_reported() {
    let mut bench = Bench::new();
    bench.session.connected(bench.now);
    let mut frame = Vec::new();
    trifacet_wire::board::framing::encode(&[0x81, 2, 9, 9, 9], &mut frame);
    bench.session.received(&frame, bench.now);
    let Some(SourceEvent::Down(SourceError::Unfit { reason, .. })) = bench.session.event() else {
        panic!("no reason")
    };
    assert!(reason.contains("version 2"), "{reason}");
    bench.session.connected(bench.now);
    bench.answer(&Answer::Error { reason: ErrorReason::Version, kind: 1 });
    let Some(SourceEvent::Down(SourceError::Unfit { reason, .. })) = bench.session.event() else {
        panic!("no reason")
    };
    assert!(reason.contains("version 1"), "{reason}");
}

#[test]
fn a_wire_too_slow_for_the_rate_is_refused() {
    let mut bench = Bench::new();
    bench.session.settings.baud = Some(115_200);
    bench.session.connected(bench.now);
    bench.start(&board());
    let Some(SourceEvent::Down(SourceError::Unfit { reason, .. })) = bench.session.event() else {
        panic!("no reason")
    };
    assert!(reason.contains("115200") && reason.contains("600000"), "{reason}");
}
