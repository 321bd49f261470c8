//! Shutdown of the daemon, the reaction of the board, and exclusive use of the serial port.

use rustix::process::Signal;
use serde_json::{Value, json};

use crate::testkit::{Board, Daemon};

const OFF: &str = "twin.laser_offset_um = [70.0, -70.0]\ntwin.motion = []";

fn output_um(status: &Value) -> [f64; 2] {
    [0, 1].map(|axis| status["output_um"][axis].as_f64().unwrap())
}

/// Whether the outputs bring the beam to the apex.
fn on_the_apex(status: &Value) -> bool {
    let [x, y] = output_um(status);
    (x + 70.0).hypot(y - 70.0) < 3.0
}

#[test]
fn when_the_daemon_is_killed_the_board_holds_or_parks_at_the_end_of_the_lease() {
    let parking = "steering.on_lease = \"park\"\nsteering.park_um = [30.0, -20.0]";
    for (config, steering) in [("", "held"), (parking, "parked")] {
        let mut board = Board::start(OFF);
        let mut daemon = Daemon::on_port(&board.link(), config);
        daemon.client().locked();
        let running = board.status();
        assert_eq!((&running["steering"], &running["lease_expired"]), (&json!("commanded"), &json!(false)));
        daemon.signal(Signal::KILL);
        assert!(!daemon.end().success());
        let ended = board.until(|status| status["lease_expired"] == true);
        assert_eq!(ended["steering"], steering, "{ended}");
        if steering == "held" {
            assert!(on_the_apex(&ended), "{ended}");
        } else {
            let [x, y] = output_um(&ended);
            assert!((x - 30.0).hypot(y + 20.0) < 0.05, "{ended}");
        }
        // The next daemon continues from that position.
        let mut next = Daemon::on_port(&board.link(), config);
        next.client().locked();
        assert!(on_the_apex(&board.status()));
    }
}

/// The system sends this signal when a process has used its CPU time (RLIMIT_CPU).
#[test]
fn at_the_limit_of_cpu_time_the_daemon_ends_in_order_with_an_error() {
    let mut board = Board::start(OFF);
    let mut daemon =
        Daemon::on_port(&board.link(), "steering.on_exit = \"park\"\nsteering.park_um = [-40.0, 10.0]");
    daemon.client().locked();
    daemon.signal(Signal::XCPU);
    assert_eq!(daemon.end().code(), Some(70), "{:#?}", daemon.log);
    assert!(
        daemon.said("the limit of CPU time") && daemon.said("steering acknowledged its last command"),
        "{:#?}",
        daemon.log
    );
    let [x, y] = output_um(&board.until(|status| status["started"] == false));
    assert!((x + 40.0).hypot(y - 10.0) < 3.0, "{x} {y}");
}

#[test]
fn at_shutdown_the_steering_is_held_or_parked_and_acknowledged() {
    let parking = "steering.on_exit = \"park\"\nsteering.park_um = [-40.0, 10.0]";
    for (signal, config, there) in [(Signal::INT, "", [-70.0, 70.0]), (Signal::TERM, parking, [-40.0, 10.0])]
    {
        let mut board = Board::start(OFF);
        let mut daemon = Daemon::on_port(&board.link(), config);
        daemon.client().locked();
        daemon.ends_in_order(signal);
        assert!(daemon.said("steering acknowledged its last command"), "{:#?}", daemon.log);
        let stopped = board.until(|status| status["started"] == false);
        let [x, y] = output_um(&stopped);
        assert!((x - there[0]).hypot(y - there[1]) < 3.0, "{stopped}");
        // No host sends commands any more: at the end of the lease the board holds the outputs.
        let held = board.until(|status| status["lease_expired"] == true);
        assert_eq!((&held["steering"], &held["output_codes"]), (&json!("held"), &stopped["output_codes"]));
    }
}

#[test]
fn without_its_board_a_daemon_shuts_down_and_reports_the_missing_acknowledgement() {
    let mut board = Board::start(OFF);
    let mut daemon = Daemon::on_port(&board.link(), "");
    let mut stream = daemon.client();
    stream.locked();
    board.kill();
    stream.until("down", |f| !f.of_samples());
    daemon.ends_in_order(Signal::TERM);
    assert!(daemon.said("steering did not acknowledge its last command"), "{:#?}", daemon.log);
    // Clients receive the notice of the end, and all frames before it.
    while stream.next().is_some() {}
}

#[test]
fn a_second_daemon_reports_the_owner_of_the_port_and_the_first_continues() {
    let board = Board::start("");
    let mut first = Daemon::on_port(&board.link(), "");
    let mut stream = first.client();
    stream.locked();
    // Root may open a locked terminal: the second daemon is refused also where these tests run as root.
    let mut second = Daemon::on_port(&board.link(), "");
    assert_eq!(second.end().code(), Some(75));
    let holder = format!("in use by process {} (trifacet)", first.pid());
    assert!(second.said(&holder) && second.said(board.link().to_str().unwrap()), "{:#?}", second.log);
    stream.samples(200);
    assert_eq!(stream.lost, 0);
    first.ends_in_order(Signal::TERM);
    let mut third = Daemon::on_port(&board.link(), "");
    third.client().locked();
}
