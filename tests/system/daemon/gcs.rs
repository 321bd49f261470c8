//! A daemon with a stage at a PI controller: the commands it sends, also while the controller misbehaves.
//!
//! The light is that of the twin, which does not follow the stage: the commands of the loop grow up to the
//! limits.

use std::path::Path;
use std::time::Duration;

use rustix::process::Signal;
use serde_json::Value;

use crate::testkit::{Controller, Daemon, Stream, Trouble, now_ns};

/// A slew rate that is slow enough to be observed: 100 um/s.
const SLEW_UM_PER_S: f64 = 100.0;
const LIMIT_UM: f64 = 80.0;

fn config(line: &str, more: &str) -> String {
    format!(
        "steering.kind = \"gcs\"\nsteering.gcs.{line}\nsteering.gcs.timeout_ms = 200\n\
         steering.limit_um = {LIMIT_UM}\nsteering.slew_mm_per_s = 0.1\ntwin.motion = []\n\
         twin.laser_offset_um = [60.0, -60.0]\ntwin.steering.readback_noise_um = \"off\"\n{more}"
    )
}

fn on_tcp(controller: &Controller, more: &str) -> String {
    config(&format!("address = \"{}\"", controller.listen()), more)
}

fn on_port(port: &Path, more: &str) -> String {
    config(&format!("port = \"{}\"", port.display()), more)
}

/// Waits until the stage is down for a reason that contains `why`.
fn down(daemon: &mut Daemon, why: &str) {
    daemon.says(&format!("down: {why}"), |line| {
        line["message"] == "the stage takes no commands"
            && line["reason"].as_str().is_some_and(|r| r.contains(why))
    });
}

fn up(daemon: &mut Daemon) -> Value {
    daemon.message("steering stage is up")
}

/// All motions in metres of the stage; each must be within the limits.
fn moves_um(controller: &Controller) -> Vec<(i64, [f64; 2])> {
    let moves = controller.state().moves.clone();
    for (_, position) in &moves {
        assert!(position.iter().all(|um| um.abs() <= LIMIT_UM), "{position:?}");
    }
    moves
}

#[test]
fn the_controller_is_identified_first_and_then_moved_within_limits_and_slew_rate() {
    let controller = Controller::new();
    let mut daemon = Daemon::start(&on_tcp(&controller, ""));
    let identified = daemon.message("steering stage identified");
    assert!(identified["identity"].as_str().unwrap().contains("E-000.K2, 0815"), "{identified}");
    up(&mut daemon);
    controller.moved(20);
    daemon.ends_in_order(Signal::TERM);
    assert!(daemon.said("steering acknowledged its last command"), "{:#?}", daemon.log);

    let heard = controller.state().heard.clone();
    let questions =
        ["*IDN?", "ERR?", "FRF? 1 2", "PUN? 1 2", "TMN? 1 2", "TMX? 1 2", "VEL? 1 2", "SVO? 1 2", "POS? 1 2"];
    assert_eq!(heard[..questions.len()], questions, "before the first motion");
    let moves = moves_um(&controller);
    let (begin, first) = moves[0];
    assert!(first.iter().all(|um| um.abs() < 20.0), "{first:?}");
    for (time, position) in &moves {
        // A late command has moved less than the slew rate allows, not more; the first one may have been
        // late itself.
        let most = SLEW_UM_PER_S * (*time - begin) as f64 * 1e-9 + 20.0;
        assert!(position.iter().all(|um| um.abs() <= most), "{position:?} after {most}");
    }
    let (end, before) = (moves[moves.len() - 1].1, moves[moves.len() - 2].1);
    let step = (end[0] - before[0]).hypot(end[1] - before[1]);
    assert!(step < 20.0 && end[0].hypot(end[1]) > 0.0, "held: {before:?} {end:?}");
    assert_eq!(controller.state().position, end, "the position is held");
}

#[test]
fn a_stage_in_millimetres_with_another_zero_parks_at_the_configured_position() {
    let controller = Controller::new();
    (controller.state().unit, controller.state().travel) = ("MM", [0.0, 25.0]);
    controller.state().position = [12.5, 12.5];
    let more = "steering.gcs.um_per_unit = 1000.0\nsteering.gcs.zero_um = [12500.0, 12500.0]\n\
                steering.on_exit = \"park\"\nsteering.park_um = [30.0, -20.0]";
    let mut daemon = Daemon::start(&on_tcp(&controller, more));
    let stands = up(&mut daemon);
    assert_eq!(stands["position_um"], "[0.0, 0.0]");
    controller.moved(5);
    daemon.ends_in_order(Signal::TERM);
    for (_, position) in &controller.state().moves {
        assert!(position.iter().all(|mm| (mm - 12.5).abs() <= LIMIT_UM * 1e-3 + 1e-9), "{position:?}");
    }
    let [x, y] = controller.state().position;
    assert!((x - 12.53).abs() < 1e-9 && (y - 12.48).abs() < 1e-9, "{x} {y}");
}

#[test]
fn after_each_reconnection_the_stage_continues_from_its_position() {
    let controller = Controller::new();
    controller.state().position = [-70.0, 50.0];
    let mut daemon = Daemon::start(&on_tcp(&controller, ""));
    controller.moved(3);
    for elsewhere in [[40.0, 20.0], [-30.0, -75.0]] {
        controller.state().trouble = Trouble::HangingUp;
        down(&mut daemon, "the other side has closed the connection");
        let before = controller.state().moves.len();
        controller.state().position = elsewhere; // by hand
        controller.state().trouble = Trouble::None;
        controller.moved(before + 1);
        let first = moves_um(&controller)[before].1;
        let jump = (first[0] - elsewhere[0]).hypot(first[1] - elsewhere[1]);
        assert!(jump < 10.0, "from {elsewhere:?} to {first:?}");
    }
    let first = moves_um(&controller)[0].1;
    assert!((first[0] + 70.0).hypot(first[1] - 50.0) < 10.0, "{first:?}");
    daemon.ends_in_order(Signal::TERM);
}

#[test]
fn a_slow_controller_receives_only_the_newest_command() {
    let controller = Controller::new();
    controller.state().trouble = Trouble::Slow(Duration::from_millis(40));
    let mut daemon = Daemon::start(&on_tcp(&controller, ""));
    let mut stream = daemon.client();
    controller.moved(3);
    let (before, first) = (controller.state().moves.len(), now_ns());
    stream.skip_to_now();
    stream.samples(1000);
    let passed_s = (now_ns() - first) as f64 * 1e-9;
    let told = (controller.state().moves.len() - before) as f64;
    assert!(told > 2.0 && told <= passed_s / 0.04 + 2.0, "{told} motions in {passed_s} s");
    let counters = stream.heartbeat().counters;
    assert!(counters["commands_sent"] < counters["scans"] / 5, "{counters:?}");
    // The last command is not delayed by commands that were never sent.
    daemon.signal(Signal::TERM);
    daemon.message("steering acknowledged its last command");
    let after = controller.state().moves.len() as f64 - told - before as f64;
    assert!(after <= passed_s / 0.04, "{after}");
    daemon.end();
    moves_um(&controller);
}

#[test]
fn each_misbehaviour_of_the_controller_is_reported_and_the_stage_recovers() {
    let controller = Controller::new();
    let mut daemon = Daemon::start(&on_tcp(&controller, ""));
    up(&mut daemon);
    for (trouble, why) in [
        (Trouble::Silent("POS?"), "no answer to POS? 1 2 within 200 ms"),
        (Trouble::Silent("ERR?"), "no answer to "),
        (Trouble::Slow(Duration::from_millis(300)), "within 200 ms"),
        (Trouble::WrongAxis, "expected 1= and 2=, each with"),
        (Trouble::NotANumber, "1=nan 2=nan"),
        (Trouble::Refusing(5), "error 5: the axis is not referenced, or its servo is off"),
        (Trouble::Garbage, "the byte 0x00 is not text"),
        (Trouble::Twice, "after the end of the answer"),
        (Trouble::HangingUp, "the other side has closed the connection"),
    ] {
        let moves = controller.state().moves.len();
        controller.moved(moves + 1);
        controller.state().trouble = trouble;
        down(&mut daemon, why);
        controller.state().trouble = Trouble::None;
        up(&mut daemon);
    }
    let moves = controller.state().moves.len();
    controller.moved(moves + 5);
    daemon.ends_in_order(Signal::TERM);
    moves_um(&controller);
}

#[test]
fn a_refused_position_is_reported_and_the_connection_stays_open() {
    let controller = Controller::new();
    let mut daemon = Daemon::start(&on_tcp(&controller, ""));
    let mut stream = daemon.client();
    controller.moved(3);
    controller.state().trouble = Trouble::Refusing(7);
    let refused = daemon.message("the steering stage refuses");
    assert!(refused["message"].as_str().unwrap().contains("beyond the limits of the axis"), "{refused}");
    stream.skip_to_now();
    assert!(stream.heartbeat().counters["commands_refused"] > 0);
    controller.state().trouble = Trouble::None;
    let moves = controller.state().moves.len();
    controller.moved(moves + 3);
    daemon.ends_in_order(Signal::TERM);
    let complaints = daemon.log.iter().filter(|line| line["message"] == "the stage takes no commands");
    assert_eq!(complaints.count(), 1, "before the first answer only: {:#?}", daemon.log);
}

#[test]
fn an_unusable_stage_is_not_moved_until_it_is_usable() {
    let controller = Controller::new();
    let set = |change: fn(&mut crate::testkit::State)| change(&mut controller.state());
    set(|state| (state.servo, state.referenced, state.travel) = (false, false, [-20.0, 90.0]));
    let mut daemon = Daemon::start(&on_tcp(&controller, ""));
    down(&mut daemon, "axis 1 is not referenced: reference it");
    set(|state| (state.referenced, state.unit) = (true, "MM"));
    down(&mut daemon, "axis 1 counts in MM: steering.gcs.um_per_unit = 1 should be 1000");
    set(|state| state.unit = "urad");
    down(&mut daemon, "axis 1 turns (it counts in urad): the loop steers a laser that is translated");
    set(|state| state.unit = "um");
    down(&mut daemon, "axis 1 travels from -20 to 90 um");
    set(|state| state.travel = [-90.0, 90.0]);
    down(&mut daemon, "the servo of axis 1 is off: switch it on, or let trifacet do it");
    assert!(controller.state().moves.is_empty(), "{:?}", controller.state().heard);
    set(|state| (state.servo, state.position) = (true, [0.0, 5000.0]));
    down(&mut daemon, "axis 2 reports the position 5000 um, outside its travel from -90 to 90 um");
    assert!(controller.state().moves.is_empty(), "{:?}", controller.state().heard);
    set(|state| state.position = [0.0; 2]);
    up(&mut daemon);
    controller.moved(2);
    // Limits that a reload widens beyond the travel are refused as at the start.
    let address = daemon.log.iter().find_map(|line| line["line"].as_str()).unwrap().to_owned();
    let wider = config(&format!("address = \"{address}\""), "").replace("limit_um = 80", "limit_um = 100");
    daemon.reload(&wider);
    down(&mut daemon, "plus and minus steering.limit_um, 100, must lie within");
    daemon.reload(&config(&format!("address = \"{address}\""), ""));
    up(&mut daemon);
    daemon.ends_in_order(Signal::TERM);
    moves_um(&controller);
}

#[test]
fn the_servo_is_switched_on_if_allowed_and_unknown_queries_are_skipped() {
    let controller = Controller::new();
    (controller.state().servo, controller.state().unknown) = (false, &["FRF?", "PUN?", "VEL?"]);
    let mut daemon = Daemon::start(&on_tcp(&controller, "steering.gcs.servo_on = true"));
    daemon.message("switching the servo on");
    up(&mut daemon);
    controller.moved(2);
    assert!(controller.state().servo);
    daemon.ends_in_order(Signal::TERM);
    let complaints = daemon.log.iter().filter(|line| line["message"] == "the stage takes no commands");
    assert_eq!(complaints.count(), 1, "before the first answer only: {:#?}", daemon.log);
}

#[test]
fn without_samples_the_stage_does_not_move() {
    let controller = Controller::new();
    let fault = "twin.fault = [{ at_s = 0.5, for_s = 2.0, kind = \"stalled\" }]";
    let mut daemon = Daemon::start(&on_tcp(&controller, fault));
    let mut stream = daemon.client();
    controller.moved(2);
    // Frames without samples are sent 100 times a second.
    let silence = |stream: &mut Stream| {
        stream.skip_to_now();
        let silent = stream.take(30).iter().all(|frame| !frame.of_samples());
        assert!(silent, "for 300 ms");
        controller.state().position
    };
    stream.until("silent", |frame| !frame.of_samples());
    let stands = silence(&mut stream); // commands in transit have arrived
    assert_eq!(silence(&mut stream), stands);
    let moves = controller.state().moves.len();
    controller.moved(moves + 2);
    daemon.ends_in_order(Signal::TERM);
}

#[test]
fn the_daemon_waits_for_a_missing_controller() {
    let nowhere = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let mut daemon = Daemon::start(&config(&format!("address = \"{nowhere}\""), ""));
    let mut stream = daemon.client();
    down(&mut daemon, &format!("cannot connect to {nowhere}: Connection refused"));
    assert!(stream.samples(50).iter().all(|frame| !frame.locked()), "poses continue without a lock");
    let mut on_null = Daemon::start(&on_port(Path::new("/dev/null"), ""));
    down(&mut on_null, "/dev/null: is not a serial port");
}

#[test]
fn on_a_serial_port_an_unplugged_cable_is_reported_and_reconnected() {
    let controller = Controller::new();
    let port = controller.plug_in();
    let mut daemon = Daemon::start(&on_port(&port, ""));
    up(&mut daemon);
    controller.moved(10);
    controller.state().trouble = Trouble::Silent("");
    down(&mut daemon, "no answer to ");
    controller.state().trouble = Trouble::None;
    up(&mut daemon);
    let moves = controller.state().moves.len();
    controller.moved(moves + 3);
    controller.state().trouble = Trouble::HangingUp;
    down(&mut daemon, &port.display().to_string());
    daemon.signal(Signal::TERM);
    assert_eq!(daemon.end().code(), Some(0));
    assert!(daemon.said("the stage takes no commands: the last command was not sent"), "{:#?}", daemon.log);
    moves_um(&controller);
}
