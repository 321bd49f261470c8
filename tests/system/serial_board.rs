//! The serial source with `trifacet emulate`: the whole path through a pseudo-terminal in both directions.

use std::path::Path;
use std::sync::Arc;

use trifacet::acquisition::{BoardSource, Source, SourceError, SourceEvent};
use trifacet::clock::SystemClock;
use trifacet::config::{self, Config};
use trifacet::core::signals::Scan;
use trifacet::core::telemetry::Counters;
use trifacet::exit;
use trifacet_wire::actuator::{Ack, LeaseAction, OutputCommand};

use crate::testkit::{Board, PATIENCE, Socket};

/// A host on the same link.
struct Host {
    source: BoardSource<SystemClock>,
    counters: Arc<Counters>,
    last: Option<Scan>,
}

fn config(port: &Path) -> Config {
    let text =
        format!("[acquisition]\nsource = \"serial\"\n[acquisition.serial]\nport = '{}'\n", port.display());
    config::parse(&text, None).unwrap()
}

impl Host {
    fn new(port: &Path) -> Self {
        let counters = Arc::<Counters>::default();
        let source = BoardSource::open(&config(port), SystemClock, Arc::clone(&counters)).unwrap();
        Self { source, counters, last: None }
    }

    async fn next(&mut self) -> SourceEvent {
        let event = tokio::time::timeout(PATIENCE, self.source.next()).await.expect("no event");
        if let SourceEvent::Scan(scan) = event {
            if let Some(last) = self.last {
                assert_eq!(scan.index, last.index + 1 + u64::from(scan.lost), "every scan has its index");
                assert!(scan.time > last.time, "time never goes back");
            }
            self.last = Some(scan);
        }
        event
    }

    /// Reads events until one fulfils this condition.
    async fn until<T>(&mut self, what: impl Fn(&SourceEvent) -> Option<T>) -> T {
        loop {
            if let Some(found) = what(&self.next().await) {
                return found;
            }
        }
    }

    async fn up(&mut self) {
        self.until(|event| matches!(event, SourceEvent::Up(_)).then_some(())).await;
    }

    /// Reads events until scans stop for the expected reason; a busy machine may cause other reasons before.
    async fn down(&mut self, reason: impl Fn(&SourceError) -> bool) {
        self.until(|event| matches!(event, SourceEvent::Down(down) if reason(down)).then_some(())).await;
    }

    async fn scans(&mut self, n: u32) -> Scan {
        for _ in 0..n {
            self.until(|event| matches!(event, SourceEvent::Scan(_)).then_some(())).await;
        }
        self.last.unwrap()
    }

    fn steer(&mut self, id: u32, codes: [i32; 2], on_expiry: LeaseAction) {
        let command = OutputCommand { id, codes, lease_ms: 200, on_expiry };
        self.source.steer(command, trifacet::core::time::Mono::default());
    }

    async fn ack(&mut self) -> Ack {
        self.until(|event| if let SourceEvent::Ack(ack) = event { Some(*ack) } else { None }).await
    }
}

/// Stage position x in micrometres by the readback of a scan.
fn readback_um(scan: &Scan) -> f64 {
    f64::from(scan.codes[9]) * 10.0 / f64::from(1 << 17) * 50.0
}

#[tokio::test]
async fn scans_arrive_without_loss_and_with_their_times() {
    let board = Board::start("");
    let mut host = Host::new(&board.link());
    let identity = host
        .until(|event| if let SourceEvent::Up(identity) = event { Some(identity.clone()) } else { None })
        .await;
    assert!(identity.simulated && identity.roles.len() == 11 && identity.rate_hz == 1000.0);
    let first = host.scans(500).await;
    let last = host.scans(1500).await;
    assert_eq!(last.index, 1999);
    assert!(host.counters.list().iter().all(|(_, n)| *n == 0), "{:?}", host.counters);
    // Board and host have the same clock, so only the jitter of the transfer remains.
    let period = last.time.seconds_since(first.time) / 1500.0;
    assert!((period - 1e-3).abs() < 2e-6, "{period}");
}

#[tokio::test]
async fn the_stage_is_steered_and_parks_after_the_end_of_the_host() {
    let mut board = Board::start("");
    let mut host = Host::new(&board.link());
    host.up().await;
    host.steer(7, [6554, 0], LeaseAction::Park);
    assert_eq!(host.ack().await, Ack { id: 7, accepted: true });
    let scan = host.scans(50).await;
    assert!((readback_um(&scan) - 100.0).abs() < 2.0, "{}", readback_um(&scan));
    host.steer(8, [40_000, 0], LeaseAction::Park);
    assert_eq!(host.ack().await, Ack { id: 8, accepted: false });
    drop(host);
    let parked = board.until(|status| status["lease_expired"] == true);
    assert_eq!(parked["steering"], "parked");
    assert_eq!(parked["output_codes"], serde_json::json!([0, 0]));
    assert_eq!((&parked["commands_taken"], &parked["commands_refused"]), (&1.into(), &1.into()));
}

#[tokio::test]
async fn damaged_and_dropped_scans_are_counted() {
    let mut board = Board::start("");
    let mut host = Host::new(&board.link());
    host.up().await;
    board.order("corrupted 0.1");
    board.order("dropped 0.1");
    let last = host.scans(1000).await;
    let (lost, corrupted) = (host.counters.scans_lost.get(), host.counters.frames_corrupted.get());
    assert_eq!(last.index + 1, 1000 + lost);
    assert!(corrupted > 20 && lost > corrupted + 20, "{lost} lost, {corrupted} corrupted");
    assert_eq!(host.counters.frames_unknown.get() + host.counters.board_errors.get(), 0);
}

#[tokio::test]
async fn a_stall_is_reported_and_ends_by_itself() {
    let mut board = Board::start("");
    let mut host = Host::new(&board.link());
    host.scans(100).await;
    board.order("stalled 0.3");
    host.down(|down| matches!(down, SourceError::Stalled { .. })).await;
    let lost = host.counters.scans_lost.get();
    host.scans(100).await;
    assert!(host.counters.scans_lost.get() >= lost + 100);
}

#[tokio::test]
async fn an_unplugged_cable_is_reported_at_once_and_reconnected() {
    let mut board = Board::start("");
    let mut host = Host::new(&board.link());
    host.scans(100).await;
    board.order("unplug 0.5");
    host.down(|down| matches!(down, SourceError::Unplugged { .. })).await;
    host.down(|down| matches!(down, SourceError::Open { .. })).await;
    host.up().await;
    let (before, after) = (host.last.unwrap(), host.scans(1).await);
    assert!(after.lost >= 400, "{} lost", after.lost);
    let away = after.time.seconds_since(before.time);
    assert!((away * 1000.0 - f64::from(after.lost) - 1.0).abs() < 0.1 * away * 1000.0, "{away} s");
}

#[tokio::test]
async fn a_board_of_version_1_0_delivers_scans_and_takes_commands() {
    let board = Board::of_version("1.0", "");
    let mut host = Host::new(&board.link());
    host.up().await;
    host.steer(7, [6554, 0], LeaseAction::Park);
    assert_eq!(host.ack().await, Ack { id: 7, accepted: true });
    host.scans(500).await;
    let faults = |(name, n): &(&str, u64)| *n > 0 && *name != "leases_expired";
    assert!(!host.counters.list().iter().any(faults), "{:?}", host.counters);
}

#[tokio::test]
async fn a_board_that_restarts_is_recognised_and_started_again() {
    let mut board = Board::start("");
    let mut host = Host::new(&board.link());
    host.scans(100).await;
    board.order("restart");
    host.down(|down| matches!(down, SourceError::Stalled { .. })).await;
    host.up().await;
    host.scans(100).await;
    assert_eq!(host.counters.board_restarts.get(), 1);
    assert_eq!(host.counters.clock_faults.get(), 0, "its clock begins anew");
    board.order("unplug 0.1");
    host.up().await;
    assert_eq!(host.counters.board_restarts.get(), 1, "the same board without a restart");
}

#[tokio::test]
async fn a_killed_board_can_be_replaced() {
    let mut board = Board::start("");
    let mut host = Host::new(&board.link());
    host.scans(100).await;
    board.kill();
    host.down(|down| matches!(down, SourceError::Unplugged { .. })).await;
    let _next = board.another("");
    host.up().await;
    host.scans(100).await;
}

#[tokio::test]
async fn the_source_waits_for_a_missing_port() {
    let socket = Socket::new();
    let mut host = Host::new(&socket.link());
    match host.next().await {
        SourceEvent::Down(SourceError::Open { port, .. }) => assert_eq!(Path::new(&port), socket.link()),
        other => panic!("{other:?}"),
    }
    let _board = Board::plug_into(socket, "");
    host.up().await;
    host.scans(10).await;
}

#[tokio::test]
async fn a_second_host_learns_the_owner_of_the_port_and_the_first_continues() {
    let board = Board::start("");
    let mut host = Host::new(&board.link());
    host.scans(10).await;
    let refused = BoardSource::open(&config(&board.link()), SystemClock, Arc::default()).unwrap_err();
    assert_eq!(refused.code, exit::IN_USE);
    assert!(refused.message.contains(&format!("process {} (", std::process::id())), "{refused}");
    host.scans(100).await;
    assert_eq!(host.counters.scans_lost.get(), 0);
}

#[tokio::test]
async fn a_stopped_board_sends_no_scans() {
    let mut board = Board::start("");
    let mut host = Host::new(&board.link());
    host.scans(10).await;
    assert_eq!(board.status()["started"], true);
    host.source.close().await;
    board.until(|status| status["started"] == false);
}
