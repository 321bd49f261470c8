//! The daemon under systemd: notifications, stalled tasks, `trifacet park` and `trifacet status`.

use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::{Command, Output};
use std::time::Duration;

use rustix::process::Signal;

use crate::testkit::{self, Board, Daemon, PATIENCE, Stream, now_ns};

/// The notification socket, in place of systemd.
struct Systemd {
    socket: UnixDatagram,
    folder: tempfile::TempDir,
}

impl Systemd {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let socket = UnixDatagram::bind(folder.path().join("notify")).unwrap();
        socket.set_read_timeout(Some(PATIENCE)).unwrap();
        Self { socket, folder }
    }

    /// Starts a daemon that notifies this socket.
    fn start(&self, config: &str, watchdog_us: Option<&str>) -> Daemon {
        let notify = self.folder.path().join("notify");
        let mut environment = vec![("NOTIFY_SOCKET", notify.to_str().unwrap())];
        environment.extend(watchdog_us.map(|us| ("WATCHDOG_USEC", us)));
        Daemon::start_with(config, &environment)
    }

    fn next(&self) -> String {
        let mut bytes = [0; 1000];
        let n = self.socket.recv(&mut bytes).expect("no notification");
        String::from_utf8(bytes[..n].to_vec()).unwrap()
    }

    /// The notifications up to the first one that contains this text, including it.
    fn until(&self, text: &str) -> Vec<String> {
        let mut heard = vec![self.next()];
        while !heard.last().unwrap().contains(text) {
            assert!(heard.len() < 1000, "never {text}: {heard:?}");
            heard.push(self.next());
        }
        heard
    }

    /// The notifications that have arrived.
    fn rest(&self) -> Vec<String> {
        self.socket.set_nonblocking(true).unwrap();
        let mut bytes = [0; 1000];
        let next = || self.socket.recv(&mut bytes).ok().map(|n| String::from_utf8_lossy(&bytes[..n]).into());
        let rest = std::iter::from_fn(next).collect();
        self.socket.set_nonblocking(false).unwrap();
        rest
    }
}

fn trifacet(arguments: &[&str]) -> Output {
    testkit::trifacet(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> &str {
    std::str::from_utf8(bytes).unwrap()
}

#[test]
fn ready_follows_the_first_frame_and_reload_and_stop_are_notified() {
    let systemd = Systemd::new();
    // The first frame is sent after three seconds.
    let mut daemon = systemd.start("estimation.average = 3000", None);
    let mut stream = daemon.client();
    assert_eq!(systemd.next(), "READY=1");
    let ready_ns = now_ns();
    let first = stream.next().unwrap();
    assert_eq!(first.sequence, 0);
    assert!(ready_ns >= first.sent_ns(), "ready before the first frame");
    assert!(systemd.next().starts_with("STATUS="));

    daemon.signal(Signal::HUP);
    let reload = systemd.until("READY=1");
    let begin = reload.iter().find(|message| message.starts_with("RELOADING=1\nMONOTONIC_USEC=")).unwrap();
    assert!(begin.rsplit('=').next().unwrap().parse::<u64>().is_ok(), "{begin}");
    daemon.ends_in_order(Signal::TERM);
    let end = systemd.rest();
    assert!(end.last().unwrap().starts_with("STOPPING=1"), "{end:?}");
    assert!(!end.iter().any(|message| message.contains("WATCHDOG")), "no watchdog is configured: {end:?}");
}

#[test]
fn with_the_laser_off_the_daemon_is_ready_and_the_status_states_it() {
    let systemd = Systemd::new();
    let fault = "twin.fault = [{ at_s = 0, for_s = 2, kind = 'beam-blocked' }]";
    let _daemon = systemd.start(fault, None);
    assert_eq!(systemd.next(), "READY=1");
    let dark = systemd.until("STATUS=bad: No valid pose: too little light on PSD A, B, C");
    assert!(dark.iter().all(|message| message.starts_with("STATUS=")), "{dark:?}");
    let bright = systemd.until("STATUS=limited: Pose valid, beam locked; limited: ");
    assert!(bright.len() < 20, "not a message for every frame: {bright:?}");
}

#[test]
fn an_unplugged_cable_does_not_end_the_daemon() {
    let systemd = Systemd::new();
    let config =
        "acquisition.source = 'serial'\nacquisition.serial.port = '/nowhere/board'\nrealtime.stall_ms = 2000";
    let mut daemon = systemd.start(config, Some("800000"));
    systemd.until("READY=1");
    systemd.until("STATUS=bad: No valid pose: no samples");
    // Ten notifications take twice the time after which a stall would be reported.
    (0..10).for_each(|_| drop(systemd.until("WATCHDOG=1")));
    daemon.ends_in_order(Signal::TERM);
    assert!(!daemon.said("stalls"), "{:#?}", daemon.log);
}

#[test]
fn a_stalled_task_stops_the_watchdog_notifications_and_the_log_names_it() {
    for task in ["acquisition", "centering", "estimation"] {
        let systemd = Systemd::new();
        let mut daemon = systemd.start("realtime.stall_ms = 0", Some("1000000"));
        (0..4).for_each(|_| drop(systemd.until("WATCHDOG=1")));
        daemon.told(&["drill", "stall", task]);
        daemon.says("which task", |line| {
            line["message"] == "a task of the fast side stalls" && line["task"] == task
        });
        systemd.until(&format!(": task {task} stalls"));
        systemd.rest();
        // Longer than the watchdog time.
        std::thread::sleep(Duration::from_millis(1200));
        let rest = systemd.rest();
        assert!(!rest.iter().any(|message| message.contains("WATCHDOG")), "{task}: {rest:?}");
    }
}

#[test]
fn a_task_that_stalls_blocks_or_ends_shuts_the_daemon_down_and_is_named() {
    for task in ["acquisition", "centering", "estimation"] {
        for what in ["stall", "block", "end"] {
            let systemd = Systemd::new();
            let mut daemon = systemd.start("realtime.stall_ms = 500", None);
            systemd.until("READY=1");
            daemon.told(&["drill", what, task]);
            assert_eq!(daemon.end().code(), Some(70), "{what} {task}");
            let told = match what {
                "end" => format!("task {task} ended by itself"),
                _ => format!("task {task} stalls: no heartbeat for 500 ms"),
            };
            let error = |line: &&serde_json::Value| {
                line["level"] == "ERROR" && line["message"].as_str().is_some_and(|m| m.contains(&told))
            };
            assert!(daemon.log.iter().any(|line| error(&line)), "{what}: {told}: {:#?}", daemon.log);
        }
    }
}

#[test]
fn drills_are_refused_on_real_hardware() {
    let systemd = Systemd::new();
    let mut board = Board::start("");
    let port =
        format!("acquisition.source = 'serial'\nacquisition.serial.port = '{}'", board.link().display());
    let mut daemon = systemd.start(&port, None);
    systemd.until("READY=1");
    let (code, _, errors) = daemon.ctl(&["drill", "stall", "centering"]);
    assert_eq!(code, 65, "{errors}");
    assert!(errors.contains("for the twin"), "{errors}");
    let (code, _, errors) = daemon.ctl(&["twin-pose", "0", "0", "0", "0", "0", "0"]);
    assert_eq!(code, 65, "{errors}");
    assert!(errors.contains("only with the twin as source"), "{errors}");
    board.status();
    daemon.ends_in_order(Signal::TERM);
}

/// A configuration file for a board.
fn with_board(board: &Board, folder: &Path, more: &str) -> String {
    let file = folder.join("park.toml");
    let port = board.link();
    let text = format!(
        "steering.park_um = [120, -80]\nacquisition.source = 'serial'\nacquisition.serial.port = '{}'\n{more}",
        port.display()
    );
    std::fs::write(&file, text).unwrap();
    file.to_str().unwrap().to_owned()
}

#[test]
fn park_works_without_a_daemon_and_respects_the_configuration() {
    let folder = tempfile::tempdir().unwrap();
    let mut board = Board::start("");
    let at =
        |board: &mut Board| [0, 1].map(|axis| board.status()["output_um"][axis].as_f64().unwrap().round());
    let before = at(&mut board);
    let hold = with_board(&board, folder.path(), "");
    let output = trifacet(&["park", "--as-configured", "--config", &hold]);
    assert!(output.status.success() && text(&output.stderr).contains("on_exit is \"hold\""), "{output:?}");
    assert_eq!(at(&mut board), before);

    let park = with_board(&board, folder.path(), "steering.on_exit = 'park'");
    let output = trifacet(&["park", "--as-configured", "--config", &park]);
    assert!(
        output.status.success() && text(&output.stderr).contains("parked at [120.0, -80.0] um"),
        "{output:?}"
    );
    assert_eq!(at(&mut board), [120.0, -80.0]);

    let mut daemon = Daemon::on_port(&board.link(), "");
    daemon.message("receiving scans");
    let output = trifacet(&["park", "--config", &park]);
    assert_eq!(output.status.code(), Some(75), "{output:?}");
    assert!(text(&output.stderr).contains("in use by process"), "{output:?}");
    daemon.ends_in_order(Signal::TERM);

    board.kill();
    let output = trifacet(&["park", "--config", &park]);
    assert!([69, 74].contains(&output.status.code().unwrap()), "{output:?}");
    let output = trifacet(&["park"]);
    assert!(output.status.success() && text(&output.stderr).contains("twin"), "{output:?}");
}

#[test]
fn status_prints_once_or_follows() {
    let systemd = Systemd::new();
    let mut daemon = systemd.start("", None);
    let address = format!("tcp://{}", daemon.address());
    systemd.until("STATUS=limited: Pose valid, beam locked");
    let socket = daemon.socket();
    let once = trifacet(&["status", &address, "--socket", socket.to_str().unwrap()]);
    let page = text(&once.stdout);
    assert!(once.status.success(), "{once:?}");
    let (pid, row) = (format!("pid {}", daemon.pid()), |name: &str, part: &str| {
        page.lines().any(|line| line.starts_with(name) && line.contains(part))
    });
    for (name, part) in [
        ("trifacet", &address[..]),
        ("process", &pid),
        ("grade", "limited: Pose valid, beam "),
        ("remedy", ""),
        ("pose", "valid"),
        ("lock", "locked   loop on"),
        ("offset", " um"),
        ("balance", "% "),
        ("steering", "read back"),
        ("losses", ""),
        ("status", "SIMULATED"),
    ] {
        assert!(row(name, part), "{name} {part}: {page}");
    }
    assert!(!page.contains('\x1b'), "colours without a terminal: {page:?}");

    // In a pipe: one line for each update, until the reader closes.
    let follow = format!(
        "{} status {address} --follow --interval 0.1 --socket /none | head -n 4",
        env!("CARGO_BIN_EXE_trifacet")
    );
    let lines = Command::new("sh").args(["-c", &follow]).output().unwrap();
    let lines: Vec<_> = text(&lines.stdout).lines().collect();
    assert_eq!(lines.len(), 4, "{lines:?}");
    assert!(lines[0].starts_with("# lock"));
    assert!(lines[1..].iter().all(|line| line.contains("valid")), "{lines:?}");

    daemon.ends_in_order(Signal::TERM);
    let gone = trifacet(&["status", &address]);
    assert_eq!(gone.status.code(), Some(69), "{gone:?}");
    assert!(text(&gone.stderr).contains("nothing listens"), "{gone:?}");
}

#[test]
fn status_reports_a_blocked_beam() {
    let mut daemon = Daemon::start("twin.fault = [{ at_s = 0, kind = 'beam-blocked' }]");
    let address = daemon.address();
    Stream::tcp(address).next();
    let output = trifacet(&["status", &format!("tcp://{address}"), "--socket", "/none"]);
    let page = text(&output.stdout);
    assert!(page.contains("grade     bad: No valid pose: too little light on PSD A, B, C\n"), "{page}");
    assert!(page.contains("remedy    check the beam path, the laser and the cable\n"), "{page}");
    assert!(page.contains("pose      NOT VALID: PSD_A_LOW PSD_B_LOW PSD_C_LOW\n"), "{page}");
    assert!(page.contains("balance   A        -   B        -   C        -"), "{page}");
}
