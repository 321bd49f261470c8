//! Boards over TCP and on Unix sockets: the daemon with `trifacet emulate --listen`, and with the board of
//! `firmware/host` behind a relay.

use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixListener;
use std::path::Path;

use rustix::process::Signal;
use serde_json::Value;
use trifacet::exit;
use trifacet_wire::Status;

use crate::testkit::{
    Board, Daemon, Far, Folder, Frame, Relay, Stream, board_at, lacks, now_ns, run, stamp_ns, trifacet,
    wait_for, waited_ns,
};

/// A board of each kind.
fn boards(home: &Folder) -> [Board; 2] {
    let socket = format!("unix:{}", home.path("board").display());
    ["127.0.0.1:0", &socket].map(|at| Board::listening(at, ""))
}

/// Waits until the source is down for a reason that contains this text.
fn down(daemon: &mut Daemon, text: &str) -> Value {
    daemon.says(text, |line| {
        line["message"] == "source is down"
            && line["reason"].as_str().is_some_and(|reason| reason.contains(text))
    })
}

/// No scan is lost, damaged or without its own time.
fn nothing_is_lost(stream: &mut Stream) {
    let counters = stream.heartbeat().counters;
    for name in
        ["scans_lost", "frames_corrupted", "frames_unknown", "acks_unknown", "clock_faults", "source_downs"]
    {
        assert_eq!(counters[name], 0, "{name}: {counters:?}");
    }
}

#[test]
fn the_loop_locks_on_each_link_without_a_loss_and_the_board_is_stopped_at_the_end() {
    let home = Folder::new();
    for mut board in boards(&home) {
        let patient = "acquisition.silence_ms = 1000\nrealtime.stall_ms = 0\n";
        let mut daemon = Daemon::at_board(board.place(), patient);
        let mut stream = daemon.client();
        stream.locked();
        let frames = stream.samples(1000);
        assert!(frames.iter().all(Frame::valid));
        assert_eq!(frames[999].sample_index, frames[0].sample_index + 999);
        nothing_is_lost(&mut stream);
        board.until(|status| status["started"] == true && status["steering"] == "commanded");
        daemon.ends_in_order(Signal::TERM);
        board.until(|status| status["started"] == false);
    }
}

#[test]
fn a_killed_board_is_reported_and_another_one_takes_its_place() {
    let home = Folder::new();
    for mut board in boards(&home) {
        let mut daemon = Daemon::at_board(board.place(), "");
        let mut stream = daemon.client();
        stream.locked();
        let killed_ns = board.kill();
        stream.until("no samples", |f| f.sent_ns() > killed_ns && !f.of_samples());
        down(&mut daemon, "was disconnected: "); // closed, or reset if it had not read all commands
        down(&mut daemon, "connection refused");
        let _next = board.another_listening("");
        stream.until("locked", |f| f.sent_ns() > killed_ns && f.locked());
    }
}

#[test]
fn an_unplugged_cable_is_reported_and_connected_again() {
    let home = Folder::new();
    for mut board in boards(&home) {
        let mut daemon = Daemon::at_board(board.place(), "");
        let mut stream = daemon.client();
        stream.locked();
        board.order("unplug 0.3");
        down(&mut daemon, "was disconnected");
        let back = stream.through("samples", |f| f.of_samples() && f.has(Status::SAMPLE_GAP));
        assert!(back[back.len() - 1].lost >= 200, "{:?}", back[back.len() - 1]);
        stream.locked();
    }
}

/// A board that hangs keeps the connection open: the silence shows it, as on a serial line.
#[test]
fn a_board_that_hangs_is_reported_within_100_ms_and_the_lease_ends_when_the_daemon_hangs() {
    let home = Folder::new();
    for mut board in boards(&home) {
        let mut daemon = Daemon::at_board(board.place(), "steering.on_lease = \"park\"");
        let mut stream = daemon.client();
        stream.locked();
        daemon.read_log();
        let waits = [daemon.pid(), board.pid()].map(waited_ns);
        let stopped_ns = now_ns();
        board.signal(Signal::STOP);
        let frame = stream.until("silence", |f| f.sent_ns() > stopped_ns && !f.of_samples());
        let line = down(&mut daemon, "no scan for");
        let waited: i64 =
            [daemon.pid(), board.pid()].map(waited_ns).iter().zip(waits).map(|(a, b)| a - b).sum();
        let delay_ns = frame.sent_ns().max(stamp_ns(&line)) - stopped_ns;
        assert!(delay_ns - waited.max(0) <= 100_000_000, "{delay_ns} ns, {waited} of them without a CPU");
        board.signal(Signal::CONT);
        stream.until("locked again", |f| f.sent_ns() > frame.sent_ns() && f.locked());

        daemon.signal(Signal::STOP);
        let parked = board.until(|status| status["lease_expired"] == true);
        assert_eq!(parked["steering"], "parked", "{parked}");
        daemon.signal(Signal::CONT);
        let now = now_ns();
        stream.until("locked again", |f| f.sent_ns() > now && f.locked());
    }
}

#[test]
fn a_second_host_is_told_who_has_the_board_and_gets_it_afterwards() {
    let home = Folder::new();
    for board in boards(&home) {
        let unix = board.place().starts_with("unix:");
        let patient = "acquisition.silence_ms = 1000\nrealtime.stall_ms = 0\n";
        let mut first = Daemon::at_board(board.place(), patient);
        let mut stream = first.client();
        stream.locked();
        let mut second = Daemon::at_board(board.place(), "");
        let told = down(&mut second, "is in use by").to_string();
        let holder =
            if unix { format!("process {} (trifacet)", first.pid()) } else { "by 127.0.0.1:".into() };
        assert!(told.contains(&holder) && told.contains("one host at a time"), "{told}");

        let tested = run(&mut trifacet(&["board-test", board.place()]));
        assert_eq!(tested.code, i32::from(exit::IN_USE), "{tested:?}");
        assert!(tested.err.contains(&holder), "{}", tested.err);
        let folder = Folder::new();
        let file = folder.write("dark.toml", board_at(board.place()));
        let dark = run(trifacet(&["dark", "--print", "--config"]).arg(&file));
        assert!(dark.code == i32::from(exit::UNAVAILABLE) && dark.err.contains(&holder), "{dark:?}");

        stream.samples(100);
        nothing_is_lost(&mut stream);
        first.ends_in_order(Signal::TERM);
        second.client().locked();
    }
}

/// The times of frames agree with their sample indices: an emulated board has the clock of this machine.
fn times_are_right(frames: &[Frame], limit_ns: i64) {
    let offset = |f: &Frame| f.time_ns - f.sample_index as i64 * 1_000_000;
    let reference = offset(&frames[frames.len() - 1]);
    for frame in frames {
        let error = offset(frame) - reference;
        assert!(error.abs() < limit_ns, "{error} ns: {frame:?}");
    }
}

#[test]
fn a_hiccup_of_the_network_loses_nothing_and_leaves_no_doubt() {
    let board = Board::listening("127.0.0.1:0", "");
    let relay = Relay::to(Far::Tcp(board.place().into()));
    let patient = "acquisition.silence_ms = 1000\nrealtime.stall_ms = 0\n";
    let mut daemon = Daemon::at_board(&relay.address(), patient);
    let mut stream = daemon.client();
    stream.locked();
    stream.samples(2000);
    let before_ns = now_ns();
    relay.hold(200);
    let frames = stream.through("after it", |f| f.time_ns > before_ns + 1_500_000_000);
    assert!(frames.iter().all(|f| f.of_samples() && f.valid() && f.lost == 0));
    assert!(!frames.iter().any(|f| f.has(Status::CLOCK_UNSYNCED)));
    let oldest = frames.iter().map(|f| f.sent_ns() - f.time_ns).max().unwrap();
    assert!(oldest > 90_000_000, "the hiccup reached the daemon: {oldest} ns");
    times_are_right(&frames, 3_000_000);
    nothing_is_lost(&mut stream);
    let status = daemon.status();
    assert_eq!(status["doubts"], Value::Array(Vec::new()), "{status}");
    stream.locked();
}

#[test]
fn bytes_that_are_no_frames_and_missing_boards_are_described() {
    // Another service, which sends a text to whoever connects.
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let text_at = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        let mut open = Vec::new();
        for mut client in listener.incoming().map_while(Result::ok) {
            use std::io::Write;
            let _ = client.write_all(b"220 lab.example ESMTP Postfix (Debian)\r\n");
            open.push(client);
        }
    });
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let home = Folder::new();
    let path = |name: &str| format!("unix:{}", home.path(name).display());
    home.write("file", "no socket");
    drop(UnixListener::bind(home.path("stale")).unwrap());
    for (place, told) in [
        (text_at, "text arrives instead of frames, for example"),
        (free.to_string(), "connection refused: no board listens there"),
        ("no-such-host.invalid:7365".into(), "the host no-such-host.invalid cannot be found"),
        (path("missing"), "the socket does not exist: is the program of the board running?"),
        (path("stale"), "no program listens at this socket any more"),
        (path("file"), "is not a socket"),
    ] {
        let mut daemon = Daemon::at_board(&place, "");
        let line = daemon.says(told, |line| line.to_string().contains(told));
        assert!(line["message"] == "source is down", "{line}");
        let endpoint = format!("tcp://{}", daemon.address());
        let reason = line["reason"].as_str().unwrap().to_owned();
        wait_for("doctor tells the reason", || {
            let out = run(trifacet(&["doctor", &endpoint, "--config"]).arg(daemon.file())).out;
            if out.contains(&reason) { Ok(()) } else { Err(out) }
        });
        let tested = run(&mut trifacet(&["board-test", &place]));
        assert_eq!(tested.code, i32::from(exit::UNAVAILABLE), "{place}: {}", tested.err);
    }
}

#[test]
fn a_socket_without_permission_names_who_asks_and_who_may() {
    if lacks(rustix::process::geteuid().is_root(), "root, to become another user")
        || lacks(Path::new("/usr/bin/setpriv").exists(), "setpriv, to become another user")
    {
        return;
    }
    let home = Folder::new();
    std::fs::set_permissions(home.path(""), std::fs::Permissions::from_mode(0o755)).unwrap();
    let board = Board::listening(&format!("unix:{}", home.path("board").display()), "");
    std::fs::set_permissions(home.path("board"), std::fs::Permissions::from_mode(0o660)).unwrap();
    let config = home.write("daemon.toml", board_at(board.place()));
    let nobody = ["--reuid", "65534", "--regid", "65534", "--clear-groups", env!("CARGO_BIN_EXE_trifacet")];
    let copy = home.path("trifacet");
    std::fs::copy(nobody[5], &copy).unwrap();
    let mut dark = std::process::Command::new("setpriv");
    dark.args(&nobody[..5]).arg(&copy).args(["dark", "--print", "--config"]).arg(&config);
    let told = run(&mut dark);
    assert_eq!(told.code, i32::from(exit::UNAVAILABLE), "{told:?}");
    assert!(
        told.err.contains("runs as user 65534, the socket belongs to user 0 and group 0 with mode 0660"),
        "{told:?}"
    );
}

#[test]
fn dark_and_board_test_work_over_a_network() {
    let home = Folder::new();
    for mut board in boards(&home) {
        let folder = Folder::new();
        let file = folder.write("dark.toml", board_at(board.place()));
        board.order("beam-blocked");
        let dark = run(trifacet(&["dark", "--print", "--samples", "100", "--config"]).arg(&file));
        assert!(dark.code == 0 && dark.out.contains("dark_v"), "{dark:?}");
        let tested = run(&mut trifacet(&["board-test", board.place()]));
        assert_eq!(tested.code, 0, "{tested:?}");
        assert!(tested.out.contains(" on ") && tested.out.contains("0 failed"), "{}", tested.out);
    }
}

#[test]
fn the_emulator_listens_for_other_machines_only_if_told_so() {
    let home = Folder::new();
    let socket = format!("unix:{}", home.path("board").display());
    for (args, code, told) in [
        (&["--listen", "0.0.0.0:0"][..], exit::USAGE, "add --allow NETWORK"),
        (&["--listen", "[::]:0"], exit::USAGE, "add --allow NETWORK"),
        (&["--listen", &socket, "--allow", "10.0.0.0/8"], exit::USAGE, "--allow is for hosts over TCP"),
        (&["--allow", "10.0.0.0/8"], exit::USAGE, "--listen"),
        (&["--listen", "somewhere"], exit::USAGE, "unix:PATH"),
        (&["--listen", "127.0.0.1:0", "--link", "/tmp/board"], exit::USAGE, "cannot be used with"),
        (&["--listen", "unix:/nowhere/board"], exit::IO, "cannot listen on unix:/nowhere/board"),
    ] {
        let done = run(trifacet(&["emulate"]).args(args));
        assert_eq!(done.code, i32::from(code), "{args:?}: {}", done.err);
        assert!(done.err.contains(told), "{args:?}: {}", done.err);
    }
    // Listening everywhere, it still accepts only the hosts that are named.
    let board = Board::with_options(&["--listen", "127.0.0.1:0", "--allow", "10.0.0.0/8"], "");
    let mut daemon = Daemon::at_board(board.place(), "");
    down(&mut daemon, "was disconnected");
    drop(daemon);
    // Another process at the same place.
    for board in boards(&home) {
        let done = run(&mut trifacet(&["emulate", "--listen", board.place()]));
        assert_eq!(done.code, i32::from(exit::IN_USE), "{}", done.err);
    }
}
