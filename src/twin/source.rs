//! The twin in real time, as a source of scans like a board.

use std::collections::VecDeque;
use std::io;
use std::sync::Arc;

use trifacet_core::pipeline::SilenceTimes;
use trifacet_core::signals::Scan;
use trifacet_core::telemetry::Counters;
use trifacet_core::time::Mono;
use trifacet_wire::actuator::{Ack, LeaseAction, OutputCommand};

use super::applied::AppliedCommands;
use super::moves::Moves;
use super::{Fate, Outputs, Twin};
use crate::acquisition::in_flight::InFlight;
use crate::acquisition::{Source, SourceError, SourceEvent};
use crate::clock::pace::{Pace, Waiting};

/// Runs a [`Twin`] on an absolute schedule. Faults of the link appear as with a board: a lost scan as a gap
/// before the next one, silence as [`SourceError::Stalled`]. The source counts what has no event of its own:
/// lost scans, corrupted frames, expired leases.
pub struct TwinSource<C: Waiting> {
    twin: Twin,
    outputs: Outputs,
    pace: Pace<C>,
    counters: Arc<Counters>,
    in_flight: InFlight,
    applied: AppliedCommands,
    moves: Option<Moves>,
    /// Events that have not been returned yet.
    events: VecDeque<SourceEvent>,
    /// Number of scans that are due and not yet taken.
    due: u64,
    /// Number of scans lost since the last one that arrived.
    lost: u32,
    /// Time of the last scan that arrived.
    last_scan: Mono,
    down: bool,
    stalled: bool,
    /// Silence after which the source is down, nanoseconds.
    patience: i64,
}

impl<C: Waiting> TwinSource<C> {
    /// Starts the twin now. A stall is reported after the first time of `silence`. With the system clock, this must be called on the thread and in the tokio runtime
    /// that will read the events.
    ///
    /// # Errors
    /// The system provides no timer.
    pub fn new(twin: Twin, clock: C, counters: Arc<Counters>, silence: SilenceTimes) -> io::Result<Self> {
        let rate_hz = twin.identity().rate_hz;
        let pace = Pace::new(clock, rate_hz)?;
        Ok(Self {
            events: VecDeque::from([SourceEvent::Up(twin.identity().clone())]),
            outputs: twin.outputs().clone(),
            in_flight: InFlight::new(usize::MAX, Arc::clone(&counters)),
            applied: AppliedCommands::default(),
            moves: None,
            counters,
            due: 0,
            lost: 0,
            last_scan: pace.schedule().time(0),
            down: false,
            stalled: false,
            patience: silence.first.as_nanos() as i64,
            pace,
            twin,
        })
    }

    /// The same with a mirror that moves by command.
    #[must_use]
    pub fn with_moves(self, moves: Moves) -> Self {
        Self { moves: Some(moves), ..self }
    }

    /// Takes the next scan, which is due.
    fn sample(&mut self) {
        if let Some(moves) = &mut self.moves {
            moves.before_scan(&mut self.twin);
        }
        let time = self.pace.schedule().time(self.twin.next_index());
        if let Some(then) = self.outputs.expire(time) {
            self.counters.leases_expired.inc();
            if then == LeaseAction::Park {
                self.twin.steer(self.outputs.park(), self.twin.next_s());
            }
        }
        let scan = self.twin.next_scan();
        self.stalled = scan.fate == Fate::Stalled;
        let applied = self.applied.at(time);
        match scan.arrived(time, self.lost).map(|scan| Scan { applied, ..scan }) {
            Some(scan) => {
                self.counters.scans_lost.add(scan.lost.into());
                (self.last_scan, self.lost, self.down) = (time, 0, false);
                self.events.push_back(SourceEvent::Scan(scan));
            }
            None => self.miss(scan.fate, time),
        }
    }

    /// A scan that was due at `time` does not arrive.
    fn miss(&mut self, fate: Fate, time: Mono) {
        self.lost = self.lost.saturating_add(1);
        if fate == Fate::Corrupted {
            self.counters.frames_corrupted.inc();
        }
        let silence = time - self.last_scan;
        if silence >= self.patience && !self.down {
            self.down = true;
            let silence_ms = u32::try_from(silence / 1_000_000).unwrap_or(u32::MAX);
            self.events.push_back(SourceEvent::Down(SourceError::Stalled { silence_ms }));
        }
    }
}

impl<C: Waiting> Source for TwinSource<C> {
    async fn next(&mut self) -> SourceEvent {
        loop {
            if let Some(event) = self.events.pop_front() {
                return event;
            }
            if self.due > 0 {
                // While catching up, the tasks that process the scans must run in between.
                tokio::task::yield_now().await;
            } else {
                match self.pace.due().await {
                    Ok(due) => self.due = due,
                    Err(e) if !self.down => {
                        self.down = true;
                        let (what, reason) = ("the twin".into(), format!("its timer failed: {e}"));
                        return SourceEvent::Down(SourceError::Unfit { what, reason });
                    }
                    // Already reported; without a timer there are no more scans.
                    Err(_) => std::future::pending().await,
                }
            }
            self.due -= 1;
            self.sample();
        }
    }

    fn steer(&mut self, command: OutputCommand, now: Mono) {
        let accepted = self.outputs.take(&command, now);
        if accepted {
            let t_s = now.seconds_since(self.pace.schedule().time(0));
            self.twin.steer(command.codes, t_s);
            self.applied.accept(command.id, now);
        }
        self.in_flight.expire(now);
        self.in_flight.sent(&command, now);
        // A stalled board sends no acknowledgements either.
        if let Some(id) = self.twin.acknowledged(command.id).filter(|_| !self.stalled)
            && self.in_flight.acknowledged(id)
        {
            self.events.push_back(SourceEvent::Ack(Ack { id: command.id, accepted }));
        }
    }

    async fn close(self) {}
}

#[cfg(test)]
mod tests {
    use trifacet_core::time::Clock;

    use super::*;
    use crate::clock::manual::ManualClock;
    use crate::config::{Config, Fault, FaultKind};

    const MS: i64 = 1_000_000;

    struct Bench {
        clock: ManualClock,
        counters: Arc<Counters>,
        source: TwinSource<ManualClock>,
    }

    fn bench(faults: &[Fault]) -> Bench {
        let mut config = Config::default();
        config.twin.motion.clear();
        config.twin.fault = faults.to_vec();
        config.steering.park_um = [250.0, 0.0];
        let (clock, counters) = (ManualClock::new(), Arc::<Counters>::default());
        let twin = Twin::new(&config).unwrap();
        let source =
            TwinSource::new(twin, clock.clone(), Arc::clone(&counters), config.acquisition.silence_times())
                .unwrap();
        Bench { clock, counters, source }
    }

    impl Bench {
        /// All events in this many milliseconds, with their time.
        async fn run(&mut self, ms: u32) -> Vec<SourceEvent> {
            let mut events = Vec::new();
            for _ in 0..ms {
                self.clock.advance(MS);
                events.extend(self.now().await);
            }
            events
        }

        /// All events that are available without waiting.
        async fn now(&mut self) -> Vec<SourceEvent> {
            let mut events = Vec::new();
            loop {
                tokio::select! {
                    biased;
                    event = self.source.next() => events.push(event),
                    () = patience() => return events,
                }
            }
        }

        fn command(&mut self, codes: [i32; 2], on_expiry: LeaseAction) {
            let command = OutputCommand { id: 9, codes, lease_ms: 50, on_expiry };
            let now = self.clock.now();
            self.source.steer(command, now);
        }
    }

    /// More iterations of the runtime than the source needs to catch up; no clock is involved.
    async fn patience() {
        for _ in 0..200 {
            tokio::task::yield_now().await;
        }
    }

    fn scans(events: &[SourceEvent]) -> Vec<Scan> {
        events.iter().filter_map(|e| if let SourceEvent::Scan(s) = e { Some(*s) } else { None }).collect()
    }

    /// Position of the stage in micrometres from the readback of a scan.
    fn readback_um(scan: &Scan) -> f64 {
        f64::from(scan.codes[9]) * 10.0 / f64::from(1 << 17) * 50.0
    }

    #[tokio::test]
    async fn the_source_delivers_every_scan_with_its_scheduled_time() {
        let mut bench = bench(&[]);
        let start = bench.clock.now();
        assert!(
            matches!(&bench.now().await[..], [SourceEvent::Up(id), SourceEvent::Scan(_)] if id.simulated)
        );
        bench.clock.advance(30 * MS + 1);
        let scans = scans(&bench.now().await);
        assert_eq!(scans.len(), 30);
        for (k, scan) in (1..).zip(&scans) {
            assert_eq!((scan.index, scan.time), (k, start + k as i64 * MS));
            assert_eq!((scan.time_sigma_ns, scan.lost), (Some(0.0), 0));
        }
    }

    #[tokio::test]
    async fn a_stall_is_reported_once_and_ends_with_a_gap() {
        let mut bench = bench(&[Fault { at_s: 0.1, for_s: Some(0.1), kind: FaultKind::Stalled }]);
        let events = bench.run(250).await;
        let silence = SourceEvent::Down(SourceError::Stalled { silence_ms: 20 });
        assert_eq!(events.iter().filter(|e| matches!(e, SourceEvent::Down(_))).count(), 1);
        let at = events.iter().position(|e| *e == silence).unwrap();
        // Up and scans 0 to 99 come first; then scan 200 with the gap.
        assert_eq!(at, 101);
        let SourceEvent::Scan(first) = events[at + 1] else { panic!("{:?}", events[at + 1]) };
        assert_eq!((first.index, first.lost), (200, 100));
        assert_eq!(bench.counters.scans_lost.get(), 100);
    }

    #[tokio::test]
    async fn lost_and_corrupted_scans_are_gaps_and_counted() {
        let fault = |kind| Fault { at_s: 0.0, for_s: None, kind };
        let mut bench = bench(&[
            fault(FaultKind::Dropped { fraction: 0.2 }),
            fault(FaultKind::Corrupted { fraction: 0.1 }),
        ]);
        let scans = scans(&bench.run(1000).await);
        let mut expected = 0;
        for scan in &scans {
            assert_eq!(scan.index, expected + u64::from(scan.lost));
            expected = scan.index + 1;
        }
        let (lost, corrupted) = (bench.counters.scans_lost.get(), bench.counters.frames_corrupted.get());
        assert_eq!(lost + scans.len() as u64, expected);
        assert!((220..340).contains(&lost) && (40..120).contains(&corrupted), "{lost} {corrupted}");
    }

    #[tokio::test]
    async fn commands_move_the_stage_and_are_answered() {
        let mut bench = bench(&[]);
        bench.now().await;
        bench.command([6554, 0], LeaseAction::Hold);
        bench.command([40_000, 0], LeaseAction::Hold);
        let events = bench.now().await;
        assert_eq!(events, [true, false].map(|accepted| SourceEvent::Ack(Ack { id: 9, accepted })));
        let last = *scans(&bench.run(200).await).last().unwrap();
        assert!((readback_um(&last) - 100.0).abs() < 1.0, "held at the end of the lease");
        assert_eq!(bench.counters.leases_expired.get(), 1);
    }

    #[tokio::test]
    async fn at_the_end_of_the_lease_the_stage_parks_by_itself() {
        let mut bench = bench(&[]);
        bench.now().await;
        bench.command([6554, 0], LeaseAction::Park);
        let scans = scans(&bench.run(80).await);
        assert!((readback_um(&scans[48]) - 100.0).abs() < 1.0);
        assert!((readback_um(&scans[70]) - 250.0).abs() < 1.0);
    }

    #[tokio::test]
    async fn a_stalled_board_does_not_answer() {
        let mut bench = bench(&[Fault { at_s: 0.0, for_s: Some(0.01), kind: FaultKind::Stalled }]);
        bench.now().await;
        bench.command([1, 1], LeaseAction::Hold);
        assert!(bench.now().await.is_empty());
    }
}
