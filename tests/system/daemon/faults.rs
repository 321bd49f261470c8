//! Faults of the light, the board and the line in a running daemon.
//!
//! A fault must appear in the frames within 100 ms, and missing samples also in the log. The time is measured
//! from before the order to the board up to the time stamps of the daemon; both follow the system clock. It
//! includes the transfer of the order to the board, and excludes the time in which daemon and board wait
//! for a CPU.

use trifacet_wire::{LockState, Status};

use crate::testkit::{Board, Daemon, Frame, Stream, now_ns, stamp_ns, waited_ns};

const LIMIT_NS: i64 = 100_000_000;
const LOW: Status = Status(Status::PSD_A_LOW.0 | Status::PSD_B_LOW.0 | Status::PSD_C_LOW.0);

/// A board, a daemon and a client, with the loop locked.
struct Bench {
    board: Board,
    daemon: Daemon,
    stream: Stream,
}

impl Bench {
    fn new() -> Self {
        Self::with("")
    }

    fn with(config: &str) -> Self {
        let board = Board::start("");
        let mut daemon = Daemon::on_port(&board.link(), config);
        let mut stream = daemon.client();
        stream.locked();
        Self { board, daemon, stream }
    }

    /// Orders a fault and returns the first frame that shows it, which must be sent in time.
    fn fault(&mut self, order: &str, shows: impl Fn(&Frame) -> bool) -> Frame {
        let waits = self.waits();
        let ordered_ns = self.board.order(order);
        let frame = self.stream.until(order, |f| f.sent_ns() > ordered_ns && shows(f));
        self.in_time(order, frame.sent_ns() - ordered_ns, waits);
        frame
    }

    /// The same for a fault that stops the samples, which the log must report within the same time.
    fn silenced(&mut self, what: &str, begin: impl FnOnce(&mut Board) -> i64) -> Frame {
        self.daemon.read_log();
        let waits = self.waits();
        let begin_ns = begin(&mut self.board);
        let frame = self.stream.until(what, |f| f.sent_ns() > begin_ns && !f.of_samples());
        let line = self.daemon.message("source is down");
        self.in_time(what, frame.sent_ns().max(stamp_ns(&line)) - begin_ns, waits);
        frame
    }

    /// The total time in which daemon and board have waited for a CPU so far.
    fn waits(&self) -> [i64; 2] {
        [self.daemon.pid(), self.board.pid()].map(waited_ns)
    }

    fn in_time(&self, what: &str, delay_ns: i64, waits: [i64; 2]) {
        let waited_ns: i64 = self.waits().iter().zip(waits).map(|(now, then)| (now - then).max(0)).sum();
        assert!(
            delay_ns - waited_ns <= LIMIT_NS,
            "{what} shows after {delay_ns} ns, {waited_ns} of them without a CPU"
        );
    }

    /// Waits for the next lock, without intervention.
    fn recovers(&mut self) -> Vec<Frame> {
        let frames = self.stream.through("locked", |f| f.valid() && f.locked());
        self.stream.skip_to_now();
        frames
    }

    fn counter(&mut self, name: &str) -> u64 {
        self.stream.heartbeat().counters[name]
    }
}

/// Waits until counters and frames agree on the losses. Returns the number of lost scans.
fn all_losses_are_counted(stream: &mut Stream) -> u64 {
    let mut told = Vec::new();
    for _ in 0..10 {
        let counters = stream.heartbeat().counters;
        let counted = counters["scans_lost"] + counters["estimation_overflows"];
        if counted == stream.lost {
            return counters["scans_lost"];
        }
        told.push((counted, stream.lost));
    }
    panic!("losses by counters and by frames: {told:?}");
}

fn fatal(frame: &Frame, bits: Status) -> bool {
    const ALL: u32 = 0x0600_607E; // the light, and the solver
    frame.status.0 & ALL == bits.0
}

#[test]
fn missing_light_is_reported_for_each_psd_and_recovers() {
    // Without the search, the stage does not change the light during the fault.
    let mut bench = Bench::with("centering.search = false");
    let cases = [
        ("beam-blocked 0.25", LOW),
        ("psd-dark 0 0.25", Status::PSD_A_LOW),
        ("psd-dark 1 0.25", Status::PSD_B_LOW),
        ("psd-dark 2 0.25", Status::PSD_C_LOW),
        ("clipped 0 0.25", Status::PSD_A_CLIPPED),
        ("clipped 4 0.25", Status::PSD_B_CLIPPED),
        ("clipped 8 0.25", Status::PSD_C_CLIPPED),
        ("frozen 1 0.25", Status::CHANNEL_FROZEN),
        ("frozen 5 0.25", Status::CHANNEL_FROZEN),
    ];
    for (order, bits) in cases {
        let first = bench.fault(order, |f| fatal(f, bits));
        assert!(!first.valid());
        let through = bench.stream.through("light", |f| f.of_samples() && f.valid());
        let (light, dark) = through.split_last().unwrap();
        assert!(dark.iter().filter(|f| f.of_samples()).all(|f| fatal(f, bits)), "{order}");
        let lasted = light.sample_index - first.sample_index;
        // A frozen channel is found as soon as its noise would have changed the code.
        assert!((235..=251).contains(&lasted), "{order}: {lasted} ms");
        let blind = |f: &&Frame| matches!(f.lock, LockState::Held | LockState::Lost);
        assert!(dark.iter().filter(blind).count() > 10, "{order}");
        bench.recovers();
    }
    bench.stream.heartbeat(); // may have been sent before
    let (counted, seen) = (bench.counter("frames_invalid"), bench.stream.invalid);
    assert!(seen > 7 * 245 && counted >= seen && counted - seen < 300, "{counted} {seen}");
}

#[test]
fn dropped_and_damaged_scans_are_gaps_and_are_counted() {
    let mut bench = Bench::new();
    for order in ["dropped 0.3 0.4", "corrupted 0.3 0.4"] {
        let first = bench.fault(order, |f| f.has(Status::SAMPLE_GAP));
        assert!(first.lost > 0);
        let frames = bench.stream.samples(400);
        let lost: u64 = frames.iter().map(|f| u64::from(f.lost)).sum();
        assert!((60..300).contains(&lost), "{order}: {lost} of some 400");
        bench.recovers();
    }
    let lost = all_losses_are_counted(&mut bench.stream);
    let corrupted = bench.counter("frames_corrupted");
    assert!(corrupted > 30 && corrupted < lost, "{corrupted} of {lost}");
    assert_eq!(bench.counter("frames_unknown"), 0);
    bench.daemon.read_log();
    assert!(bench.daemon.said("board link: ") && bench.daemon.said("corrupted"), "{:#?}", bench.daemon.log);
}

/// Checks the frames that the daemon sends without samples. `seconds` is the duration.
fn is_silence(frames: &[Frame]) {
    assert!(frames.len() > 5);
    let (first, last) = (frames[0], frames[frames.len() - 1]);
    assert!(frames.iter().all(|f| !f.of_samples() && !f.valid() && !f.locked()));
    assert!(frames.iter().all(|f| f.sample_index == first.sample_index), "no sample, no index");
    let seconds = (last.time_ns - first.time_ns) as f64 * 1e-9;
    // At most 100 frames a second, and one more for each new status.
    assert!(frames.len() as f64 <= 100.0 * seconds + 5.0, "{} in {seconds} s", frames.len());
    // Their time is the time of sending.
    let quickest = frames.iter().map(|f| f.arrived_ns - f.time_ns).min().unwrap();
    assert!((-1_000_000..20_000_000).contains(&quickest), "{quickest} ns");
    assert!(frames.iter().all(|f| f.send_delay_ns < 1_000_000_000));
    assert!(matches!(last.lock, LockState::Held | LockState::Lost));
}

/// Checks the frames until samples arrive again; the first sample contains the number of lost ones.
fn silence_of(bench: &mut Bench, first: Frame, about_s: f64) {
    let through = bench.stream.through("samples", Frame::of_samples);
    let (back, mut silence) = (through[through.len() - 1], through[..through.len() - 1].to_vec());
    silence.insert(0, first);
    is_silence(&silence);
    assert!(back.has(Status::SAMPLE_GAP), "{back:?}");
    let away_s = f64::from(back.lost) * 1e-3;
    let silent_s = (back.time_ns - silence[0].time_ns) as f64 * 1e-9;
    assert!(away_s > about_s && (away_s - silent_s).abs() < 0.2, "{away_s} {silent_s}");
}

/// The frames stay valid, with the time from the sequence numbers, but a control must not use them.
#[test]
fn a_wrong_clock_of_the_board_is_flagged_and_named_and_the_time_stays_right() {
    let mut bench = Bench::new();
    for order in ["clock-rate 10 1.5", "clock-rate 0 1.5", "clock-rate 0.5 1.5"] {
        let first = bench.fault(order, |f| f.has(Status::CLOCK_UNSYNCED));
        assert!(first.valid());
        // The board counts 1500 scans during the fault. Scans may be lost on a busy machine.
        let during =
            bench.stream.through("most of the fault", |f| f.sample_index > first.sample_index + 1000);
        for frame in during.iter().filter(|f| f.of_samples() && f.sample_index > first.sample_index + 20) {
            assert!(frame.has(Status::CLOCK_UNSYNCED), "{order}: {frame:?} after {first:?}");
            let age_ns = frame.sent_ns() - frame.time_ns;
            assert!((-20_000_000..600_000_000).contains(&age_ns), "{order}: {age_ns} ns old");
        }
        bench.stream.until("a time that is confirmed", |f| f.valid() && !f.has(Status::CLOCK_UNSYNCED));
        bench.stream.skip_to_now();
    }
    assert!(bench.counter("clock_faults") > 3);
    let named = bench.daemon.message("the clock of the board is wrong");
    assert!(named.to_string().contains("the tick"), "{named}");
}

#[test]
fn a_stalled_board_is_reported_down_and_recovers_by_itself() {
    let mut bench = Bench::new();
    for (order, seconds) in [("stalled 0.3", 0.25), ("stalled 1.8", 1.7)] {
        let first = bench.silenced(order, |board| board.order(order));
        silence_of(&mut bench, first, seconds);
        bench.recovers();
    }
    assert!(bench.counter("source_downs") >= 2);
    all_losses_are_counted(&mut bench.stream);
}

#[test]
fn an_unplugged_cable_is_reported_at_once_and_reconnected() {
    let mut bench = Bench::new();
    let first = bench.silenced("unplug", |board| board.order("unplug 0.5"));
    silence_of(&mut bench, first, 0.45);
    bench.recovers();
    assert!(bench.counter("source_downs") >= 1);
}

#[test]
fn a_board_that_dies_can_be_replaced_without_a_restart() {
    let mut bench = Bench::new();
    let session = bench.stream.next().unwrap().session;
    let killed_ns = now_ns();
    let first = bench.silenced("kill", Board::kill);
    // Without a board, the state does not change by itself.
    let waiting = bench.stream.take(30);
    assert!(waiting.iter().all(|f| !f.of_samples()));
    bench.board = bench.board.another("");
    silence_of(&mut bench, first, (now_ns() - killed_ns) as f64 * 1e-9 - 0.5);
    bench.recovers();
    assert_eq!(bench.stream.next().unwrap().session, session, "the daemon is the same");
}

#[test]
fn with_averages_a_gap_leaves_no_pose() {
    let mut board = Board::start("");
    let mut daemon = Daemon::on_port(&board.link(), "estimation.average = 20");
    let mut stream = daemon.client();
    stream.locked();
    board.order("dropped 0.3 0.5");
    let gaps = stream.through("a gap", |f| f.has(Status::SAMPLE_GAP));
    assert!(gaps.iter().all(|f| f.valid() != f.has(Status::SAMPLE_GAP)));
    stream.until("whole again", |f| f.valid() && f.lost == 0);
}

#[test]
fn faults_of_the_internal_twin_are_reported_the_same_way() {
    let faults = "twin.fault = [{ at_s = 1.0, for_s = 0.4, kind = \"stalled\" }, \
        { at_s = 2.0, for_s = 0.4, kind = \"dropped\", fraction = 0.3 }, \
        { at_s = 3.0, for_s = 0.4, kind = \"corrupted\", fraction = 0.3 }]";
    let mut daemon = Daemon::start(faults);
    let mut stream = daemon.client();
    stream.locked();
    let before = stream.through("stalled", |f| !f.of_samples());
    let silence = stream.through("samples", Frame::of_samples);
    let (back, silence) = silence.split_last().unwrap();
    assert_eq!((before[before.len() - 2].sample_index, back.sample_index, back.lost), (999, 1400, 400));
    is_silence(silence);
    stream.until("samples after all faults", |f| f.sample_index > 3500 && f.locked());
    all_losses_are_counted(&mut stream);
    let counters = stream.heartbeat().counters;
    assert_eq!(counters["source_downs"], 1);
    assert!(counters["frames_corrupted"] > 60, "{counters:?}");
}
