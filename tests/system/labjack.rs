//! The source "labjack" with an emulated T7: the whole path through two TCP ports.

use std::process::Command;

use rustix::process::Signal;
use trifacet_wire::{LockState, Status};

use crate::testkit::{self, Daemon, Folder, Frame, Stream, T7, mean, venv, wait_for};

/// A device, a daemon that uses it, and a client.
fn bench(twin: &str, config: &str) -> (T7, Daemon, Stream) {
    let device = T7::start(twin);
    let mut daemon = Daemon::start(&device.host(config, "watchdog_s = 1"));
    // At power-up the outputs are at 0 V: the stage is at its end.
    let mut stream = daemon.client().steered_within(500.0);
    stream.locked();
    (device, daemon, stream)
}

/// Waits until the heartbeat of the daemon shows this.
fn counted(stream: &mut Stream, what: &str, is: impl Fn(&dyn Fn(&str) -> u64) -> bool) {
    wait_for(what, || {
        let counters = stream.heartbeat().counters;
        if is(&|name| counters[name]) { Ok(()) } else { Err(format!("{counters:?}")) }
    });
}

#[test]
fn the_loop_locks_and_every_scan_is_accounted_for() {
    let (mut device, mut daemon, mut stream) =
        bench("twin.laser_offset_um = [70.0, -70.0]\ntwin.motion = []", "");
    let frames = stream.samples(300);
    assert!(frames.iter().all(|frame| frame.has(Status::SIMULATED)), "the light is not real");
    assert!(frames.iter().any(|frame| frame.lock == LockState::Locked));
    daemon.read_log();
    assert!(daemon.said("LabJack T7 470000000, firmware 1.0302, trifacet emulator"), "{:?}", daemon.log);
    // The constants in its flash are used: with the nominal ones, the pose would be wrong by 0.4 %.
    device.order("pose 100 0 0 0 0 500 0");
    stream.until("the new pose", |frame| frame.valid() && (frame.pose[5] - 5e-4).abs() < 5e-6);
    let valid: Vec<_> = stream.samples(300).into_iter().filter(Frame::valid).collect();
    let yaw = mean(&valid, |frame| frame.pose[5]);
    assert!((yaw - 5e-4).abs() < 0.8e-6, "{yaw}");
    let before = stream.lost;
    device.order("recovery 60");
    counted(&mut stream, "the recovery", |of| of("scans_lost") >= 60 && of("converter_overruns") >= 1);
    device.order("jump 40");
    counted(&mut stream, "the jump", |of| of("scans_lost") >= 100);
    device.order("dropped 0.2 0.5");
    stream.samples(600);
    assert!(stream.lost - before > 150, "{} lost in the frames", stream.lost - before);
    assert!(!daemon.said("the clock of the T7 is wrong"), "its timer wraps, and the losses agree with it");
    daemon.ends_in_order(Signal::TERM);
    let status = device.status();
    assert_eq!(status["started"], false, "the stream has ended: {status}");
}

#[test]
fn every_end_of_the_stream_is_named_and_recovers() {
    let (mut device, mut daemon, mut stream) = bench("", "");
    for (order, reason) in [
        ("overlap", "scan overlap, 2942"),
        ("overflow", "more scans than it can count (2943)"),
        ("complete", "2944"),
        ("corrupted 1 0.05", "its stream is not one: a packet begins with"),
        ("unplug 0.3", "was disconnected"),
        ("restart", "was disconnected"),
    ] {
        daemon.read_log();
        device.order(order);
        daemon.says(reason, |line| {
            line["message"] == "source is down" && line["reason"].as_str().unwrap().contains(reason)
        });
        stream.until("down", |frame| !frame.of_samples() && !frame.valid());
        daemon.message("source is up");
        stream.until("valid again", |frame| frame.of_samples() && frame.valid());
    }
    device.order("stalled 0.5");
    let silent = stream.until("silent", |frame| !frame.of_samples());
    assert!(!silent.valid());
    stream.until("valid again", |frame| frame.of_samples() && frame.valid());
}

#[test]
fn the_stream_of_another_program_is_left_alone() {
    let (mut device, mut daemon, mut stream) = bench("", "");
    device.order("second-session 3");
    let reason = "a program that is not trifacet streams from it";
    daemon.says(reason, |line| line["reason"].as_str().is_some_and(|told| told.contains(reason)));
    stream.until("valid again", |frame| frame.of_samples() && frame.valid());
}

#[test]
fn after_a_killed_daemon_the_watchdog_parks_and_the_next_daemon_takes_the_stream_over() {
    let parks = "steering.on_lease = \"park\"\nsteering.park_um = [30.0, -40.0]";
    let (mut device, mut daemon, stream) = bench("", parks);
    drop(stream);
    let mut other = Daemon::start(&device.host("", ""));
    let owner = format!("process {} at 127.0.0.1 streams from it", daemon.pid());
    other.says(&owner, |line| line["reason"].as_str().is_some_and(|reason| reason.contains(&owner)));
    other.ends_in_order(Signal::TERM);
    daemon.kill();
    let parked = device.until(|status| status["steering"] == "parked");
    let at = [0, 1].map(|axis| parked["output_um"][axis].as_f64().unwrap());
    assert!((at[0] - 30.0).abs() < 0.3 && (at[1] + 40.0).abs() < 0.3, "{parked}");
    daemon.start_again();
    let mut stream = daemon.client();
    stream.locked();
    // A regular end turns the watchdog off: the outputs hold.
    daemon.ends_in_order(Signal::TERM);
    let ended = device.status();
    std::thread::sleep(std::time::Duration::from_millis(1500));
    assert_eq!(device.status()["output_um"], ended["output_um"]);
}

#[test]
fn a_rate_that_the_device_does_not_take_is_refused_with_its_reason() {
    let device = T7::start("");
    let mut daemon = Daemon::start(&device.host("acquisition.rate_hz = 700", ""));
    daemon.message("source is down");
    assert!(daemon.said("it samples at 1000 Hz instead of acquisition.rate_hz = 700"), "{:?}", daemon.log);
    let folder = Folder::new();
    for (rate_hz, keys, reason) in [
        ("9000", "", "at most 7692.3: a T7 takes 100 000 samples per second, and a scan has 13"),
        ("1000", "settling_us = 90.0", "an interval with which 13 entries fit into a period"),
        ("1000", "range_v = 5.0", "10, 1, 0.1 or 0.01"),
        ("1000", "watchdog_s = 0", "allowed is 1 to 3600"),
    ] {
        let text = device.host(&format!("acquisition.rate_hz = {rate_hz}"), keys);
        let checked = testkit::on(&["check", "--config"], &folder.write("t7.toml", text));
        assert!(checked.code == 78 && checked.err.contains(reason), "{keys}: {}", checked.err);
    }
    let ljtick = device.host("steering.on_lease = \"park\"", "outputs = \"ljtick-dac\"");
    let checked = testkit::on(&["check", "--config"], &folder.write("t7.toml", ljtick));
    assert!(checked.err.contains("the watchdog of a T7 cannot move an LJTick-DAC"), "{}", checked.err);
}

/// An independent client of Modbus TCP reads and writes the registers, and the packets have the layout of the data sheet.
#[test]
fn pymodbus_understands_the_emulated_device() {
    let device = T7::start("twin.motion = []");
    let python = venv::python("labjack-venv", "pymodbus", &["pymodbus==3.11.4"]);
    let [registers, stream] = device.ports.map(|port| port.to_string());
    let mut command = Command::new(python);
    command.arg("tests/system/labjack_client.py").args([registers, stream]);
    let printed = venv::succeeded(&mut command, "pymodbus");
    assert_eq!(String::from_utf8_lossy(&printed.stdout).trim(), "understood");
}
