use super::*;

const MS: i64 = 1_000_000;
const PARK: [i32; 2] = [300, -300];

struct Bench {
    board: Emulator,
    now: Mono,
}

impl Bench {
    fn new() -> Self {
        Self { board: Emulator::new(&Config::default(), Mono(0)).unwrap(), now: Mono(0) }
    }

    fn started() -> Self {
        let mut bench = Self::new();
        let result = StartResult::Done;
        let done = Answer::Reply(Reply { start: true, result, rate_mhz: 1_000_000 });
        assert_eq!(bench.ask(Request::Start { rate_mhz: 1_000_000, park: PARK, minor: 0 }), [done]);
        bench
    }

    fn ask(&mut self, request: Request) -> Vec<Answer> {
        let mut frame = Vec::new();
        request.encode(&mut frame);
        self.board.received(&frame, self.now);
        self.answers()
    }

    fn answers(&mut self) -> Vec<Answer> {
        let bytes = self.board.output().to_vec();
        self.board.written(bytes.len());
        let (mut rest, mut deframer, mut answers) = (&bytes[..], Deframer::default(), Vec::new());
        while let Some(frame) = deframer.next(&mut rest) {
            answers.extend(frame.ok().map(|message| Answer::decode(message).unwrap()));
        }
        answers
    }

    /// Advances the time and returns the scans.
    fn run(&mut self, ms: i64) -> Vec<BoardScan> {
        let mut scans = Vec::new();
        for _ in 0..ms {
            self.board.sample(self.now);
            self.now = self.now + MS;
            for answer in self.answers() {
                if let Answer::Scan(scan) = answer {
                    scans.push(scan);
                }
            }
        }
        scans
    }

    fn steer(&mut self, codes: [i32; 2], lease_ms: u16, on_expiry: LeaseAction) -> SteerResult {
        match self.ask(Request::Steer(OutputCommand { id: 5, codes, lease_ms, on_expiry }))[..] {
            [Answer::Ack { id: 5, result }] => result,
            ref other => panic!("{other:?}"),
        }
    }
}

#[test]
fn nothing_is_sent_before_a_request_and_scans_are_numbered_from_the_start() {
    let mut bench = Bench::new();
    assert!(bench.run(50).is_empty());
    bench.ask(Request::Start { rate_mhz: 1_000_000, park: PARK, minor: 0 });
    let scans = bench.run(20);
    assert_eq!(scans.iter().map(|scan| scan.sequence).collect::<Vec<_>>(), (0..20).collect::<Vec<_>>());
    assert_eq!(scans[1].tick - scans[0].tick, u64::from(TICK_HZ) / 1000);
    assert_eq!(scans[0].tick, u64::from(TICK_HZ) / 1000 * 50, "the clock runs from power-up");
    bench.ask(Request::Stop);
    assert!(bench.run(20).is_empty());
}

#[test]
fn values_out_of_range_are_refused_and_change_nothing() {
    let mut bench = Bench::new();
    assert_eq!(bench.steer([0, 0], 200, LeaseAction::Hold), SteerResult::NotStarted);
    for (rate_mhz, park, result) in
        [(999_000, PARK, StartResult::RateOutOfRange), (1_000_000, [0, 32_768], StartResult::ParkOutOfRange)]
    {
        let refused = Answer::Reply(Reply { start: true, result, rate_mhz: 0 });
        assert_eq!(bench.ask(Request::Start { rate_mhz, park, minor: 0 }), [refused]);
    }
    let mut bench = Bench::started();
    assert_eq!(bench.steer([100, 0], 50, LeaseAction::Park), SteerResult::Accepted);
    bench.run(40);
    assert_eq!(bench.steer([0, 40_000], 50, LeaseAction::Park), SteerResult::OutOfRange);
    assert_eq!(bench.steer([0, 0], 0, LeaseAction::Park), SteerResult::OutOfRange);
    bench.run(20);
    assert_eq!(bench.board.state().steering, Steering::Parked, "the previous lease continues");
}

#[test]
fn a_lease_that_ends_holds_or_parks_and_shows_in_the_scans() {
    for (on_expiry, steering, codes) in
        [(LeaseAction::Hold, Steering::Held, [100, 200]), (LeaseAction::Park, Steering::Parked, PARK)]
    {
        let mut bench = Bench::started();
        bench.steer([100, 200], 50, on_expiry);
        let scans = bench.run(100);
        assert!(scans.iter().all(|scan| scan.lease_expired == (scan.sequence >= 50)));
        let state = bench.board.state();
        assert_eq!((state.steering, state.output_codes, state.lease_expired), (steering, codes, true));
        bench.steer([1, 2], 50, on_expiry);
        assert!(bench.run(10).iter().all(|scan| !scan.lease_expired));
    }
}

#[test]
fn lost_scans_use_up_sequence_numbers() {
    let mut bench = Bench::started();
    bench.board.inject(FaultKind::Corrupted { fraction: 1.0 }, Some(0.01)).unwrap();
    bench.run(10);
    bench.board.inject(FaultKind::Stalled, Some(0.01)).unwrap();
    bench.run(5);
    assert_eq!(bench.ask(Request::Identify { minor: 0 }), [], "a stalled board ignores requests");
    bench.run(5);
    assert_eq!(bench.run(1)[0].sequence, 20);
    let state = bench.board.state();
    assert_eq!((state.scans_sent, state.scans_unsent), (11, 10));
}

#[test]
fn corrupted_messages_are_answered_and_unsent_scans_are_dropped() {
    let mut bench = Bench::started();
    bench.board.received(&[0, 3, 9, 9, 0], bench.now);
    let corrupted = Answer::Error { reason: ErrorReason::Corrupted, kind: 0 };
    let mut echo = Vec::new();
    corrupted.encode(&mut echo);
    assert_eq!(bench.answers(), [corrupted]);
    bench.board.received(&echo, bench.now);
    assert_eq!(bench.answers(), [], "an echo of its own answer");
    for _ in 0..10_000 {
        bench.board.sample(bench.now);
    }
    assert!(bench.board.output().len() < QUEUE + 250);
    assert!(bench.board.state().scans_unsent > 8_000);
}

#[test]
fn version_1_1_names_the_applied_command_and_the_boot() {
    let mut bench = Bench::new();
    let identity = |bench: &mut Bench, minor| match &bench.ask(Request::Identify { minor })[..] {
        [Answer::Identity(identity)] => identity.clone(),
        other => panic!("{other:?}"),
    };
    let plain = identity(&mut bench, 0);
    assert!(plain.extensible && plain.extension.is_none());
    let boot = identity(&mut bench, 7).extension.unwrap();
    assert_eq!((boot.minor, boot.wide_tick), (1, true));
    bench.ask(Request::Start { rate_mhz: 1_000_000, park: PARK, minor: 1 });
    assert!(bench.run(5).iter().all(|scan| scan.applied.is_none()));
    bench.steer([1, 1], 200, LeaseAction::Hold);
    let scans = bench.run(5);
    assert!(scans.iter().all(|scan| scan.applied == Some(5)), "{scans:?}");
    bench.steer([0, 40_000], 200, LeaseAction::Hold);
    bench.board.restart(bench.now);
    assert_eq!(bench.board.state().output_codes, [0, 0]);
    assert!(bench.run(5).is_empty(), "stopped");
    assert_ne!(identity(&mut bench, 1).extension.unwrap().boot_id, boot.boot_id);
    bench.ask(Request::Start { rate_mhz: 1_000_000, park: PARK, minor: 1 });
    let first = bench.run(1)[0];
    assert_eq!((first.applied, first.tick < u64::from(TICK_HZ) / 50), (None, true), "{first:?}");
}

#[test]
fn version_1_0_refuses_the_fields_of_1_1() {
    let mut bench = Bench::new();
    bench.board = bench.board.with_minor(0);
    let [Answer::Identity(identity)] = &bench.ask(Request::Identify { minor: 0 })[..] else { panic!("none") };
    assert!(!identity.extensible);
    for (request, kind) in [
        (Request::Identify { minor: 1 }, 1),
        (Request::Start { rate_mhz: 1_000_000, park: PARK, minor: 1 }, 2),
    ] {
        assert_eq!(bench.ask(request), [Answer::Error { reason: ErrorReason::Length, kind }]);
    }
}
