//! A daemon that was started by hand in a terminal, and what becomes of it when the terminal is closed.

use rustix::process::{Pid, Signal, kill_process};

use crate::testkit::{Daemon, Folder, Terminal, run, trifacet, wait_for};

const BY_SETSID: [&str; 2] = ["setsid", "--ctty"];

/// A daemon in this terminal, started through these programs.
fn start(terminal: &Terminal, through: &[&str]) -> Daemon {
    Daemon::start_in_terminal(&Folder::new(), "", &[&BY_SETSID, through].concat(), terminal)
}

/// An interactive shell with this script, in which `"$@"` starts the daemon.
fn by_shell(script: &str) -> [&str; 5] {
    ["bash", "--norc", "-ic", script, "bash"]
}

/// Checks that the daemon ends in order.
fn ends_in_order(daemon: &mut Daemon) {
    daemon.end();
    for text in ["the terminal is closed: stopping", "steering acknowledged its last command", "stopped"] {
        assert!(daemon.said(text), "{text}: {:#?}", daemon.log);
    }
}

fn reloads(daemon: &mut Daemon, pid: Pid) {
    daemon.read_log();
    daemon.rewrite("tcp =", "# Another comment.\npublishing.tcp =");
    kill_process(pid, Signal::HUP).unwrap();
    daemon.says("reloaded", |line| line["command"] == "reload");
    daemon.client().locked();
}

fn pid(daemon: &Daemon) -> Pid {
    Pid::from_raw(i32::try_from(daemon.status()["pid"].as_i64().unwrap()).unwrap()).unwrap()
}

#[test]
fn a_closed_terminal_ends_the_daemon_in_order_and_a_reload_does_not() {
    let terminal = Terminal::open();
    let mut daemon = start(&terminal, &[]);
    daemon.client().locked();
    let pid = pid(&daemon);
    reloads(&mut daemon, pid);
    drop(terminal);
    ends_in_order(&mut daemon);
}

#[test]
fn a_shell_that_loses_its_terminal_takes_its_jobs_with_it() {
    for script in ["\"$@\"; true", "\"$@\" & wait"] {
        let terminal = Terminal::open();
        let mut daemon = start(&terminal, &by_shell(script));
        daemon.client().locked();
        drop(terminal);
        ends_in_order(&mut daemon);
    }
}

#[test]
fn a_daemon_whose_log_was_in_the_terminal_ends_too() {
    let terminal = Terminal::open();
    let daemon = start(&terminal, &["sh", "-c", "exec \"$@\" 2>/dev/tty", "sh"]);
    let socket = daemon.socket();
    let answers = || run(trifacet(&["ctl", "--socket"]).arg(&socket).arg("status")).code == 0;
    wait_for("an answer", || if answers() { Ok(()) } else { Err("none".into()) });
    drop(terminal);
    // The orderly end removes the socket.
    wait_for("the end", || if socket.exists() { Err("the socket is there".into()) } else { Ok(()) });
}

#[test]
fn nohup_setsid_and_disown_keep_the_daemon() {
    for (what, through) in [
        ("nohup", &["nohup"][..]),
        ("setsid", &["setsid", "--fork", "--wait"]),
        ("disown", &by_shell("\"$@\" & disown; read")),
        ("SIGHUP ignored", &by_shell("trap '' HUP; exec \"$@\"")),
    ] {
        let terminal = Terminal::open();
        let mut daemon = start(&terminal, through);
        let mut stream = daemon.client();
        stream.locked();
        let pid = pid(&daemon);
        drop(terminal);
        if what == "disown" {
            daemon.message("the terminal was closed without SIGHUP");
        }
        stream.skip_to_now();
        reloads(&mut daemon, pid);
        kill_process(pid, Signal::TERM).unwrap();
        daemon.end();
        assert!(daemon.said("SIGTERM: stopping"), "{what}: {:#?}", daemon.log);
    }
}
