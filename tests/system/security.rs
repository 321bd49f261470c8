//! The points of the threat model in SECURITY.md that no other test covers, and the list of the tests itself.

use std::fs::{self, Permissions};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};
use std::path::Path;
use std::time::Duration;

use serde_json::Value;
use trifacet::exit;

use crate::testkit::http::{get, request};
use crate::testkit::{Daemon, Folder, PATIENCE, lacks, run, wait_for};

const TOKEN: &str = "0123456789abcdef0123456789abcdef";

fn monitored(config: &str) -> (Daemon, SocketAddr) {
    let mut daemon = Daemon::start(&format!("monitor.listen = \"127.0.0.1:0\"\n{config}"));
    let at = daemon.monitor();
    (daemon, at)
}

fn root(path: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// The file of a test and the name of its function.
fn place(test: &str) -> (String, String) {
    let (module, name) = test.rsplit_once("::").unwrap();
    let path = root("tests/system").join(module.replace("::", "/"));
    let text =
        fs::read_to_string(path.with_extension("rs")).or_else(|_| fs::read_to_string(path.join("mod.rs")));
    (text.unwrap_or_else(|error| panic!("{test}: {error}")), format!("fn {name}("))
}

#[test]
fn every_point_of_the_threat_model_names_tests_that_exist() {
    let text = fs::read_to_string(root("SECURITY.md")).unwrap();
    let rows: Vec<_> =
        text.lines().filter(|line| line.starts_with("| ") && !line.contains("| test |")).collect();
    assert!(rows.len() >= 15, "{rows:#?}");
    for row in rows {
        let tests = row.rsplit('|').nth(1).unwrap();
        let names: Vec<_> = tests.split('`').skip(1).step_by(2).collect();
        assert!(!names.is_empty(), "no test: {row}");
        for name in names {
            let (text, function) = place(name);
            assert!(text.contains(&function), "{name} does not exist");
        }
    }
}

/// Sends the bytes one by one, one per second, until the other side closes the connection; returns what it sent.
fn drip(at: SocketAddr, start: &str) -> String {
    let mut stream = TcpStream::connect(at).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(1))).unwrap();
    stream.write_all(start.as_bytes()).unwrap();
    let mut answer = Vec::new();
    for _ in 0..PATIENCE.as_secs() {
        let mut bytes = [0; 1024];
        match stream.read(&mut bytes) {
            Ok(0) => return String::from_utf8(answer).unwrap(),
            Ok(n) => answer.extend(&bytes[..n]),
            Err(e) if e.kind() == std::io::ErrorKind::WouldBlock => drop(stream.write_all(b"x")),
            Err(_) => return String::from_utf8(answer).unwrap(),
        }
    }
    panic!("the connection is still open after {PATIENCE:?}: {start}");
}

#[test]
fn slow_requests_lose_their_connection_and_hold_up_nobody() {
    let (daemon, at) = monitored(&format!("monitor.control = true\nmonitor.token = \"{TOKEN}\"\n"));
    let post = |token: &str| {
        format!(
            "POST /control HTTP/1.1\r\nHost: {at}\r\nContent-Type: application/json\r\n\
             Authorization: Bearer {token}\r\nContent-Length: 1000\r\n\r\n{{"
        )
    };
    let [header, stranger, operator] =
        [format!("GET / HTTP/1.1\r\nHost: {at}\r\nX-Slow: "), post("wrong"), post(TOKEN)];
    let slow: Vec<_> = std::iter::repeat_n(header, 30)
        .chain(std::iter::repeat_n(stranger, 30))
        .map(|start| std::thread::spawn(move || drip(at, &start)))
        .collect();
    let slow_operator = std::thread::spawn(move || drip(at, &operator));
    // Everybody else is served in the meantime, and so is the operator.
    wait_for("the time limit of a body", || {
        assert_eq!(get(at, "/healthz").code, 200);
        assert_eq!(daemon.told(&["gains", "0.1", "100"])["loop"]["kp"], 0.1);
        if slow_operator.is_finished() { Ok(()) } else { Err("the body may still arrive".into()) }
    });
    let answer = slow_operator.join().unwrap();
    assert!(answer.starts_with("HTTP/1.1 408") && answer.contains("within 5 s"), "{answer}");
    for slow in slow {
        let answer = slow.join().unwrap();
        let expected = ["", "HTTP/1.1 401", "HTTP/1.1 408"];
        assert!(expected.iter().any(|start| answer.starts_with(start)), "{answer}");
    }
}

#[test]
fn huge_requests_are_refused() {
    let (_daemon, at) = monitored(&format!("monitor.control = true\nmonitor.token = \"{TOKEN}\"\n"));
    let host = format!("Host: {at}\r\n");
    let long = "x".repeat(100_000);
    for (line, headers) in [
        (format!("GET /{long} HTTP/1.1"), host.clone()),
        (format!("GET /{} HTTP/1.1", long.repeat(10)), host.clone()),
        ("GET / HTTP/1.1".to_owned(), format!("{host}X-Long: {}\r\n", long.repeat(10))),
        ("GET / HTTP/1.1".to_owned(), host.clone() + &"X-Many: 1\r\n".repeat(1000)),
    ] {
        let code = refused(at, &format!("{line}\r\n{headers}\r\n"));
        assert!(["400", "404", "414", "431", ""].contains(&&code[..]), "{code}");
    }
    for (length, code) in [("5000", "413"), ("99999999999", "413"), ("-1", "400")] {
        let request = format!(
            "POST /control HTTP/1.1\r\n{host}Content-Type: application/json\r\nAuthorization: Bearer {TOKEN}\r\n\
             Content-Length: {length}\r\n\r\n"
        );
        assert_eq!(refused(at, &(request + &"x".repeat(5000))), code, "Content-Length: {length}");
    }
    assert_eq!(get(at, "/healthz").code, 200);
}

/// The status code of the answer; empty if the connection is closed without one.
fn refused(at: SocketAddr, request: &str) -> String {
    let mut stream = TcpStream::connect(at).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let _ = stream.write_all(request.as_bytes()); // it may be refused before its end
    let mut answer = [0; 12];
    let n = stream.read(&mut answer).unwrap_or(0);
    String::from_utf8_lossy(&answer[..n]).split(' ').nth(1).unwrap_or_default().to_owned()
}

#[test]
fn no_path_leads_out_of_the_daemon() {
    let (daemon, at) = monitored("");
    for path in [
        "/../../etc/passwd",
        "/..%2f..%2fetc%2fpasswd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "//etc/passwd",
        "/page.css/../../etc/passwd",
        "/recordings/",
        "/./page.js%00.css",
    ] {
        let page = request(at, &format!("GET {path} HTTP/1.1"), &format!("Host: {at}\r\n"));
        assert!([400, 404].contains(&page.code) && !page.body.contains("root:"), "{path}: {page:?}");
    }
    // The daemon names its recordings itself: no command takes a name.
    for command in [["record", "start", "../../evil"], ["record", "start", "/etc/passwd"]] {
        assert_eq!(daemon.ctl(&command).0, i32::from(exit::USAGE));
    }
}

#[test]
fn links_in_the_recordings_folder_are_neither_followed_nor_deleted() {
    let home = Folder::new();
    let folder = home.path("recordings");
    fs::create_dir(&folder).unwrap();
    let precious = home.write("precious", vec![7; 8_000_000]);
    let empty = home.write("empty", "");
    let link = |target: &Path, name: &str| {
        let link = folder.join(name);
        symlink(target, &link).unwrap();
        link
    };
    let links = [
        link(&precious, "trifacet-20200101T000000.000Z.mcap"),
        link(&precious, "trifacet-20200102T000000.000Z.mcap.part"),
        link(&empty, "trifacet-20200103T000000.000Z.mcap.part"),
        link("/dev/zero".as_ref(), "trifacet-20200104T000000.000Z.mcap"),
        link("/nowhere/at-all".as_ref(), "trifacet-20200105T000000.000Z.mcap.part"),
    ];
    let config = "acquisition.rate_hz = 5000\nrecording.mode = \"always\"\nrecording.rotate_mb = 1\n\
                  recording.budget_gb = 0.003\nrecording.folder = \"recordings\"\n";
    let mut daemon = Daemon::start_in(&home, config);
    daemon.message("control socket is open");
    daemon.status_until(|status| status["counters"]["recording_deletions"].as_u64() >= Some(2));
    daemon.ends_in_order(rustix::process::Signal::TERM);
    for link in &links {
        assert!(fs::symlink_metadata(link).is_ok_and(|found| found.is_symlink()), "{}", link.display());
    }
    assert_eq!(fs::read(&precious).unwrap(), vec![7; 8_000_000]);
    assert!(empty.exists() && fs::read(&empty).unwrap().is_empty());
}

#[test]
fn recordings_are_private_whatever_the_umask() {
    let home = Folder::new();
    let config = "recording.mode = \"always\"\nrecording.folder = \"recordings\"\n";
    let through = ["sh", "-c", "umask 0; exec \"$@\"", "sh"];
    let mut daemon = Daemon::start_through(&home, config, &through);
    daemon.message("control socket is open");
    daemon.status_until(|status| status["counters"]["recording_bytes"].as_u64() > Some(1000));
    daemon.ends_in_order(rustix::process::Signal::TERM);
    let folder = home.path("recordings");
    assert_eq!(fs::metadata(&folder).unwrap().mode() & 0o7777, 0o750);
    let mut files = 0;
    for entry in fs::read_dir(&folder).unwrap() {
        assert_eq!(entry.unwrap().metadata().unwrap().mode() & 0o7777, 0o640);
        files += 1;
    }
    assert!(files > 0);
}

#[test]
fn another_user_cannot_use_the_control_socket() {
    if lacks(rustix::process::geteuid().is_root(), "root, to become another user") {
        return;
    }
    let daemon = |mode: &str| {
        let home = Folder::new();
        fs::set_permissions(home.path("."), Permissions::from_mode(0o755)).unwrap();
        let socket = home.path("socket");
        let mut daemon = Daemon::start_in(
            &home,
            &format!("control.socket = \"{}\"\ncontrol.mode = \"{mode}\"\n", socket.display()),
        );
        daemon.message("control socket is open");
        (daemon, socket)
    };
    let program = env!("CARGO_BIN_EXE_trifacet");
    for (mode, code) in [("0660", exit::IO), ("0666", 0)] {
        let (_daemon, socket) = daemon(mode);
        let mut command = std::process::Command::new("setpriv");
        command.args(["--reuid=65534", "--regid=65534", "--clear-groups", program, "ctl", "--socket"]);
        let done = run(command.arg(&socket).arg("status"));
        assert_eq!(done.code, i32::from(code), "{mode}: {}", done.err);
        assert!(code == 0 || done.err.contains("Permission denied"), "{}", done.err);
    }
}

#[test]
fn the_unit_keeps_every_restriction() {
    let unit = fs::read_to_string(root("systemd/trifacet.service")).unwrap();
    let values = |key: &str| -> Vec<&str> {
        unit.lines().filter_map(|line| line.strip_prefix(key)?.strip_prefix('=')).collect()
    };
    for key in [
        "NoNewPrivileges",
        "ProtectHome",
        "PrivateTmp",
        "PrivateMounts",
        "ProtectClock",
        "ProtectControlGroups",
        "ProtectHostname",
        "ProtectKernelLogs",
        "ProtectKernelModules",
        "ProtectKernelTunables",
        "RestrictNamespaces",
        "RestrictSUIDSGID",
        "RemoveIPC",
        "LockPersonality",
        "MemoryDenyWriteExecute",
    ] {
        assert_eq!(values(key), ["yes"], "{key}");
    }
    assert_eq!(values("ProtectSystem"), ["strict"]);
    assert_eq!(values("CapabilityBoundingSet"), [""]);
    assert_eq!(values("AmbientCapabilities"), [""]);
    assert_eq!(values("UMask"), ["0027"]);
    assert_eq!(values("StateDirectoryMode"), ["0750"]);
    assert_eq!(values("DevicePolicy"), ["closed"]);
    assert!(values("DeviceAllow").iter().all(|device| device.starts_with("char-tty")), "serial ports only");
    assert_eq!(values("RestrictAddressFamilies"), ["AF_INET AF_INET6 AF_UNIX AF_NETLINK"]);
    assert_eq!(values("SystemCallFilter"), ["@system-service", "~@privileged"]);
    assert!(values("User") == ["trifacet"] && values("ReadWritePaths").is_empty());
}

#[test]
fn a_reader_of_the_stream_cannot_steer() {
    let mut daemon = Daemon::start("");
    let mut stream = TcpStream::connect(daemon.address()).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    for line in ["park", "loop off", "move 100 100", "tare", "gains 1 1", "record start", "reload"] {
        writeln!(stream, "{line}").unwrap();
    }
    let mut reader = std::io::BufReader::new(stream);
    for _ in 0..7 {
        let mut line = String::new();
        std::io::BufRead::read_line(&mut reader, &mut line).unwrap();
        assert!(line.starts_with("error"), "{line}");
    }
    let status = daemon.status();
    assert_eq!(status["loop"]["mode"], "on", "{status}");
    let none: Vec<&Value> = daemon.log.iter().filter(|line| !line["command"].is_null()).collect();
    assert!(none.is_empty(), "{none:?}");
}
