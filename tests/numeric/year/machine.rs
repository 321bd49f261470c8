//! Board, link and the pure parts of the daemon, scan after scan, without clocks.
//!
//! The board is the twin with counters and a clock of its own. Its bytes go through the session of the serial source,
//! which makes scans with their times of them; then mapping, centering and estimation take each scan in the order of
//! the daemon's tasks.

use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use trifacet::acquisition::SourceEvent;
use trifacet::acquisition::board::{Session, Settings};
use trifacet::config::{CalibrationContext, CalibrationState, Config, FaultKind};
use trifacet::core::centering::{Centering, TimedPose};
use trifacet::core::estimation::{Estimation, PoseReport};
use trifacet::core::pipeline::Mapping;
use trifacet::core::signals::Scan;
use trifacet::core::steering::{Command, codes};
use trifacet::core::telemetry::Counters;
use trifacet::core::time::Mono;
use trifacet::twin::{Fate, OUTPUT_BITS, Outputs, Twin, TwinScan};
use trifacet_optics::Pose;
use trifacet_wire::actuator::OutputCommand;
use trifacet_wire::board::message::{Reply, StartResult, SteerResult};
use trifacet_wire::board::{Answer, BoardIdentity, BoardScan, Deframer, Request};

pub(super) const RATE_HZ: f64 = 1000.0;
pub(super) const PERIOD_NS: f64 = 1e9 / RATE_HZ;
const TICK_HZ: u32 = 1_000_000;
pub(super) const TICKS: u64 = TICK_HZ as u64 / RATE_HZ as u64;

/// What is true of a report.
pub(super) struct Truth {
    /// Time of the scan, nanoseconds of the host's monotonic clock.
    pub(super) time_ns: f64,
    pub(super) pose: Pose,
}

/// What the counters must show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Tally {
    pub(super) corrupted: u64,
    /// Scans that were taken while the board ran and never arrived.
    pub(super) lost: u64,
    pub(super) arrived: u64,
}

pub(super) struct Machine {
    pub(super) config: Config,
    twin: Twin,
    outputs: Outputs,
    session: Session,
    pub(super) counters: Arc<Counters>,
    mapping: Mapping,
    pub(super) centering: Centering,
    estimation: Estimation,
    pose: Option<TimedPose>,
    random: Pcg64,
    /// Time of the next scan, nanoseconds of the host's monotonic clock.
    pub(super) time_ns: f64,
    /// By how much the period of the board is longer than it declares.
    pub(super) drift: f64,
    /// Number of the next scan since START, if the board has been started.
    pub(super) sequence: Option<u64>,
    /// Clock of the board at the number 0, ticks.
    pub(super) tick: u64,
    /// Added to the index of every scan.
    index: u64,
    /// The index that the next scan gets.
    pub(super) next_index: Option<u64>,
    pub(super) tally: Tally,
    last_index: u64,
}

impl Machine {
    pub(super) fn new(config: Config) -> Self {
        let context = CalibrationContext::read(config.clone()).unwrap();
        let counters = Arc::<Counters>::default();
        let twin = Twin::new(&config).unwrap();
        let pipeline = config.pipeline(&context).unwrap();
        let (mapping, centering, estimation) = pipeline.into_parts();
        Self {
            session: Session::new(Settings::from(&config), Arc::clone(&counters)),
            outputs: twin.outputs().clone(),
            random: Pcg64::seed_from_u64(config.twin.seed),
            twin,
            counters,
            mapping,
            centering,
            estimation,
            pose: None,
            config,
            time_ns: 1e9,
            drift: 0.0,
            sequence: None,
            tick: 0,
            index: 0,
            next_index: None,
            tally: Tally::default(),
            last_index: 0,
        }
    }

    /// The present time.
    pub(super) fn now(&self) -> Mono {
        Mono(self.time_ns as i64)
    }

    /// The cable is plugged in, and the board answers.
    pub(super) fn plug_in(&mut self) {
        self.session.connected(self.now());
        while self.sequence.is_none() {
            self.board_answers(self.now());
        }
        self.events(self.now());
    }

    /// The cable is out for so many nanoseconds. The daemon notices it at once; the board loses its power.
    pub(super) fn unplug(&mut self, for_ns: f64) -> PoseReport {
        self.sequence = None;
        let gone =
            trifacet::acquisition::SourceError::Unplugged { port: "cable".into(), reason: "out".into() };
        self.session.disconnected(gone);
        let report = self.events(self.now()).pop().expect("a report of the silence");
        // What a long silence repeats a hundred times a second.
        for _ in 0..10 {
            self.time_ns += for_ns / 10.0;
            self.centering.silence(for_ns / 10.0 * 1e-9);
            self.estimation.silence(self.now(), &self.centering.state());
        }
        report
    }

    pub(super) fn inject(&mut self, kind: FaultKind, for_s: f64) {
        self.twin.inject(kind, Some(for_s)).unwrap();
    }

    /// New settings while it runs, as a reload hands them to the parts.
    pub(super) fn reload(&mut self, change: impl FnOnce(&mut Config)) {
        change(&mut self.config);
        self.estimation.retune(self.config.estimation_settings(&CalibrationState::default(), 1).unwrap());
        self.mapping.set_channels(self.config.read_channels().unwrap());
        let command = self.centering.retune(self.config.loop_params()).command;
        self.steer(command, self.now());
    }

    /// The next scan and the report of it, if it arrives.
    pub(super) fn step(&mut self) -> (Truth, Option<PoseReport>) {
        self.time_ns += PERIOD_NS * (1.0 + self.drift);
        let scan = self.twin.next_scan();
        let truth =
            Truth { time_ns: self.time_ns, pose: self.config.frames.build().pose(&scan.truth.pose).unwrap() };
        // Most scans arrive at once, some 0.3 ms later.
        let delay_ns = 5e4 * -self.random.random::<f64>().max(1e-12).ln();
        let arrival = Mono((self.time_ns + delay_ns) as i64);
        if let Some(sequence) = self.sequence {
            self.sequence = Some(sequence + 1);
            self.send(sequence, &scan, arrival);
        }
        self.session.timed_out(arrival);
        self.board_answers(arrival);
        (truth, self.events(arrival).pop())
    }

    fn send(&mut self, sequence: u64, scan: &TwinScan, arrival: Mono) {
        let mut bytes = Vec::new();
        Answer::Scan(BoardScan {
            sequence: sequence as u32,
            tick: u64::from((self.tick + sequence * TICKS) as u32),
            output_railed: scan.output_railed,
            channels: self.twin.identity().roles.len() as u8,
            codes: scan.codes,
            ..BoardScan::default()
        })
        .encode(&mut bytes);
        match scan.fate {
            Fate::Sent => self.tally.arrived += 1,
            Fate::Corrupted => {
                let middle = bytes.len() / 2;
                bytes[middle] = if bytes[middle] == 0x55 { 0xaa } else { bytes[middle] ^ 0x55 };
                self.tally.corrupted += 1;
                self.tally.lost += 1;
            }
            Fate::Dropped | Fate::Stalled => {
                self.tally.lost += 1;
                return;
            }
        }
        self.session.received(&bytes, arrival);
    }

    /// The board reads what the daemon has written, and answers.
    fn board_answers(&mut self, now: Mono) {
        let (mut deframer, mut answers) = (Deframer::default(), Vec::new());
        loop {
            let bytes = self.session.output().to_vec();
            if bytes.is_empty() {
                break;
            }
            self.session.written(bytes.len());
            let mut rest = &bytes[..];
            while let Some(Ok(message)) = deframer.next(&mut rest) {
                answers.push(self.answer(&Request::decode(message, 0).unwrap(), now));
            }
        }
        for answer in answers {
            let mut bytes = Vec::new();
            answer.encode(&mut bytes);
            self.session.received(&bytes, now);
        }
    }

    fn answer(&mut self, request: &Request, now: Mono) -> Answer {
        let identity = self.twin.identity();
        let rate_mhz = (RATE_HZ * 1e3) as u32;
        match request {
            Request::Identify { .. } => Answer::Identity(BoardIdentity {
                tick_hz: TICK_HZ,
                converter: identity.converter,
                output_bits: OUTPUT_BITS,
                simulated: true,
                rate_mhz: [rate_mhz; 2],
                roles: identity.roles.clone(),
                skew_ns: identity.skew_ns.clone(),
                name: "board of the year".into(),
                extensible: false, // version 1.0, whose ticks of 32 bits wrap
                extension: None,
            }),
            Request::Start { .. } => {
                self.sequence = Some(0);
                Answer::Reply(Reply { start: true, result: StartResult::Done, rate_mhz })
            }
            Request::Stop => Answer::Reply(Reply { start: false, result: StartResult::Done, rate_mhz: 0 }),
            Request::Steer(command) => {
                let taken = self.outputs.take(command, now);
                if taken {
                    self.twin.steer(command.codes, self.twin.next_s());
                }
                let result = if taken { SteerResult::Accepted } else { SteerResult::OutOfRange };
                Answer::Ack { id: command.id, result }
            }
        }
    }

    /// Takes the events of the session as the tasks do; returns the reports.
    fn events(&mut self, now: Mono) -> Vec<PoseReport> {
        let mut reports = Vec::new();
        while let Some(event) = self.session.event() {
            match event {
                SourceEvent::Up(identity) => {
                    let identity = Arc::new(identity);
                    self.estimation.source(Arc::clone(&identity));
                    self.mapping.source(identity).unwrap();
                    self.centering.stage_up();
                }
                SourceEvent::Ack(ack) => self.centering.stage_answers(ack),
                SourceEvent::Scan(scan) => reports.extend(self.scan(scan, now)),
                SourceEvent::Down(_) => {
                    self.centering.silence(0.02);
                    let report = self.estimation.silence(now, &self.centering.state());
                    self.pose = None;
                    reports.push(self.estimation.in_user_frame(&report));
                }
            }
        }
        reports
    }

    fn scan(&mut self, scan: Scan, now: Mono) -> Option<PoseReport> {
        if let Some(next) = self.next_index.take() {
            self.index = next - scan.index;
        }
        let scan = Scan { index: scan.index + self.index, ..scan };
        assert!(scan.index > self.last_index || self.last_index == 0, "the index grows");
        self.last_index = scan.index;
        let sample = self.mapping.sample(&scan)?;
        let outcome = self.centering.sample(&sample, self.pose.as_ref(), now);
        self.steer(outcome.command, now);
        let report = self.estimation.sample(&sample, &self.centering.state())?;
        self.pose = report.pose.map(|pose| TimedPose { pose, time: report.time });
        Some(self.estimation.in_user_frame(&report))
    }

    fn steer(&mut self, command: Option<Command>, now: Mono) {
        let Some(Command { id, position, lease_ms, on_expiry }) = command else { return };
        let codes = codes(position, self.config.steering.full_scale_um * 1e-6, OUTPUT_BITS);
        self.session.steer(OutputCommand { id, codes, lease_ms, on_expiry }, now);
    }
}
