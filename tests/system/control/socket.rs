//! The control socket: access to it, and its answers to invalid input.

use std::io::{Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::process::Stdio;

use rustix::net::{
    AddressFamily, SocketAddrUnix, SocketFlags, SocketType, bind, connect, listen, socket_with,
};
use rustix::process::Signal;
use trifacet::exit;

use super::fixture::{AT_REST, Lab, say};
use crate::testkit::{Folder, on, run, trifacet, wait_for};

#[test]
fn status_is_one_line_of_json_with_the_current_state() {
    let daemon = Lab::start(AT_REST);
    let status = daemon.status_until(|status| status["loop"]["lock"] == "locked");
    assert_eq!(status["loop"]["mode"], "on");
    assert_eq!(status["pose"]["valid"], true, "{status}");
    let tx = status["pose"]["tx_ty_tz_m"][0].as_f64().unwrap();
    assert!((tx - 100e-6).abs() < 10e-6, "{status}");
    // The beam follows the apex, which is 100 um off.
    let x = status["loop"]["commanded_um"][0].as_f64().unwrap();
    assert!((x - 100.0).abs() < 5.0, "{status}");
    let frame = daemon.frame();
    assert_eq!(status["config"], format!("{:08x}", frame.config));
    assert_eq!(status["session"], format!("{:08x}", frame.session));
    assert!(status["counters"]["scans"].as_u64().unwrap() > 100, "{status}");
    assert_eq!(status["file"], daemon.file().to_str().unwrap());
}

#[test]
fn invalid_commands_are_refused_and_incomplete_ones_are_not_executed() {
    let daemon = Lab::start(AT_REST);
    let mut client = daemon.connect();
    for line in ["steer 1 2\n", "\n", "\u{fc}\0\u{7f}\n", "setpoint 1\n", "gains nan 1\n", "loop sideways\n"]
    {
        let answer = say(&mut client, line);
        assert_eq!((answer["ok"].as_bool(), answer["code"].as_u64()), (Some(false), Some(64)), "{answer}");
        assert!(answer["error"].as_str().unwrap().contains("setpoint X_UM Y_UM"), "{answer}");
    }
    assert_eq!(say(&mut client, "Loop shadow\r\n")["loop"]["mode"], "shadow", "the connection stays");
    // Two lines in one write are two commands.
    assert_eq!(say(&mut client, "status\nstatus\n")["ok"], true);
    assert_eq!(say(&mut client, "")["ok"], true);
    // An incomplete line: a truncated number would be a different number.
    let (_, mut half) = daemon.connect();
    half.write_all(b"setpoint 1 2").unwrap();
    half.shutdown(std::net::Shutdown::Write).unwrap();
    let mut rest = String::new();
    assert_eq!(half.read_to_string(&mut rest).unwrap(), 0);
    assert_eq!(say(&mut client, "status\n")["loop"]["setpoint_um"][0], 0.0);
    // A line that never ends.
    let (_, mut long) = daemon.connect();
    long.write_all(&[b'x'; 256]).unwrap();
    long.read_to_string(&mut rest).unwrap();
    assert!(rest.contains("at most 256 bytes"), "{rest}");
    // Clients do not block each other.
    let idle: Vec<_> = (0..5).map(|_| daemon.connect()).collect();
    daemon.told(&["status"]);
    drop(idle);
}

#[test]
fn clients_beyond_the_limit_are_closed_and_slots_become_free_again() {
    let daemon = Lab::start(AT_REST);
    let mut clients: Vec<_> = (0..16).map(|_| daemon.connect()).collect();
    for client in &mut clients {
        assert_eq!(say(client, "status\n")["ok"], true);
    }
    let (code, _, errors) = daemon.ctl(&["status"]);
    assert_eq!(code, i32::from(exit::UNAVAILABLE), "{errors}");
    clients.clear();
    // The daemon may not yet have noticed that the clients have closed.
    wait_for("a free slot", || match daemon.ctl(&["status"]) {
        (0, ..) => Ok(()),
        (_, _, errors) => Err(errors),
    });
}

#[test]
fn its_permissions_are_those_of_the_configuration() {
    let daemon = Lab::start("");
    let mode = std::fs::metadata(daemon.socket()).unwrap().permissions().mode();
    assert_eq!(mode & 0o7777, 0o640);
}

#[test]
fn a_socket_in_use_is_kept_and_a_stale_one_is_replaced() {
    let mut daemon = Lab::start("");
    let file = daemon.file();
    let second = on(&["run", "--config"], &file);
    assert_eq!(second.code, i32::from(exit::IN_USE), "{}", second.err);
    assert!(second.err.contains("in use by another daemon"), "{}", second.err);
    daemon.told(&["status"]);
    daemon.kill();
    assert!(daemon.socket().exists());
    let (code, _, errors) = daemon.ctl(&["status"]);
    assert_eq!(code, i32::from(exit::UNAVAILABLE), "{errors}");
    assert!(errors.contains("is it running"), "{errors}");
    daemon.start_again();
    daemon.told(&["status"]);
    daemon.end();
}

#[test]
fn a_file_that_is_not_a_socket_is_not_replaced() {
    let folder = Folder::new();
    let notes = folder.write("notes", "precious");
    let text = format!(
        "publishing.tcp = \"off\"\nmonitor.listen = \"off\"\ncontrol.socket = \"{}\"\n",
        notes.display()
    );
    let run = on(&["run", "--config"], &folder.write("lab.toml", text));
    assert_eq!(run.code, i32::from(exit::IO), "{}", run.err);
    assert_eq!(std::fs::read_to_string(&notes).unwrap(), "precious");
}

#[test]
fn ctl_distinguishes_wrong_arguments_from_a_missing_daemon() {
    let missing = run(&mut trifacet(&["ctl", "--socket", "/no/such/socket", "status"]));
    assert_eq!(missing.code, i32::from(exit::UNAVAILABLE));
    assert!(missing.err.contains("/no/such/socket"));
    for args in [
        &["ctl"][..],
        &["ctl", "dance"],
        &["ctl", "loop", "maybe"],
        &["ctl", "setpoint", "1"],
        &["ctl", "setpoint", "one", "two"],
        &["ctl", "tare", "--poses", "0"],
        &["ctl", "tare", "clear", "--poses", "5"],
    ] {
        assert_eq!(run(&mut trifacet(args)).code, i32::from(exit::USAGE), "{args:?}");
    }
}

#[test]
fn a_stopped_daemon_is_reported_and_a_busy_one_is_awaited() {
    let daemon = Lab::start(AT_REST);
    daemon.signal(Signal::STOP);
    let socket = daemon.socket();
    let start = |args: &[&str]| {
        let mut ctl = trifacet(&["ctl", "--socket", socket.to_str().unwrap()]);
        ctl.args(args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    };
    // Each of them waits for some seconds.
    for command in [&["status"][..], &["loop", "off"], &["tare", "--poses", "5000"]].map(start) {
        let told = command.wait_with_output().unwrap();
        let [answer, errors] = [told.stdout, told.stderr].map(|text| String::from_utf8(text).unwrap());
        assert_eq!(told.status.code(), Some(i32::from(exit::UNAVAILABLE)), "{errors}");
        assert_eq!(answer, "", "{errors}");
        for part in ["does not answer", "is stopped", &format!("kill -CONT {}", daemon.pid())] {
            assert!(errors.contains(part), "{errors}");
        }
    }
    daemon.signal(Signal::CONT);
    // Commands wait for their turn behind one that takes longer than a daemon may be silent.
    let tare = start(&["tare", "--poses", "9000"]);
    wait_for("answers", || if daemon.ctl(&["status"]).0 == 0 { Ok(()) } else { Err("none".into()) });
    let told = tare.wait_with_output().unwrap();
    assert!(told.status.success(), "{told:?}");
}

#[test]
fn a_daemon_that_accepts_nobody_is_reported() {
    let folder = Folder::new();
    let socket = folder.path("socket");
    let address = SocketAddrUnix::new(&socket).unwrap();
    let open = |flags| socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None).unwrap();
    let listener = open(SocketFlags::empty());
    bind(&listener, &address).unwrap();
    listen(&listener, 0).unwrap();
    // The queue is full.
    let waiting: Vec<_> = std::iter::repeat_with(|| open(SocketFlags::NONBLOCK))
        .take_while(|client| connect(client, &address).is_ok())
        .collect();
    assert!(waiting.len() < 10);
    let done = run(trifacet(&["ctl", "--socket"]).arg(&socket).arg("status"));
    assert_eq!(done.code, i32::from(exit::UNAVAILABLE), "{}", done.err);
    assert!(done.err.contains("does not answer: it is stopped, stuck or far too busy"), "{}", done.err);
}
