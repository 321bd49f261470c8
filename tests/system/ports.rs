//! What the daemon says of a serial port at which there is no board: other bytes, a missing permission, a device with
//! another name, a port that is configured twice.

use std::fs::{self, Permissions};
use std::os::unix::fs::{PermissionsExt, chown, symlink};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use serde_json::Value;
use trifacet::exit;

use crate::monitor::page::until;
use crate::testkit::{Board, Daemon, Folder, Terminal, lacks, on, run, trifacet, wait_for};

/// With load on the machine, the kernel may block a read from a pseudo-terminal for seconds.
const MONITOR: &str = "monitor.listen = \"127.0.0.1:0\"\nrealtime.stall_ms = 60000\n";

/// A device that sends the same bytes again and again until it is dropped.
struct Talker {
    line: Arc<Terminal>,
    end: Arc<AtomicBool>,
}

impl Talker {
    fn new(bytes: Vec<u8>) -> Self {
        let talker = Self { line: Arc::new(Terminal::open()), end: Arc::default() };
        let (line, end) = (Arc::clone(&talker.line), Arc::clone(&talker.end));
        std::thread::spawn(move || {
            while !end.load(Ordering::Relaxed) {
                line.send(&bytes);
                std::thread::sleep(Duration::from_millis(20));
            }
        });
        talker
    }
}

impl Drop for Talker {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
    }
}

/// The log entries that report the source as down.
fn downs(daemon: &Daemon) -> Vec<String> {
    let down = |line: &&Value| line["message"] == "source is down";
    daemon.log.iter().filter(down).map(ToString::to_string).collect()
}

/// Runs a command until it prints this: on a busy machine the daemon may not answer it in time.
fn tells(text: &str, command: impl Fn() -> String) {
    wait_for(text, || {
        let out = command();
        if out.contains(text) { Ok(()) } else { Err(out) }
    });
}

#[test]
fn bytes_that_are_no_frames_are_described_once_and_everywhere() {
    let noise = (0..=255_u32).map(|i| (i * i * 31 + i * 7) as u8 | 1).collect();
    for (bytes, told) in [
        (b"Debian GNU/Linux 12 lab ttyS0\r\nlab login: ".to_vec(), "text arrives at 921600 baud"),
        (vec![0; 64], "only bytes 0x00 arrive"),
        (vec![0xff; 64], "only bytes 0xff arrive"),
        (noise, "not frames of a board"),
    ] {
        let talker = Talker::new(bytes);
        let mut daemon = Daemon::on_port(&talker.line.name(), MONITOR);
        // On a busy machine, the first bytes may come late.
        let described = |line: &Value| line["reason"].as_str().is_some_and(|reason| reason.contains(told));
        let line = daemon.says(told, described);
        assert_eq!((&line["level"], &line["message"]), (&"WARN".into(), &"source is down".into()), "{line}");
        let described = downs(&daemon).len();
        // Several requests later, nothing has been added.
        let counted = |status: &Value| status["counters"]["bytes_foreign"].as_u64().unwrap();
        let before = counted(&daemon.status());
        daemon.status_until(|status| counted(status) > before + 5_000);
        daemon.read_log();
        assert_eq!(downs(&daemon).len(), described, "{:?}", daemon.log);
        let status = daemon.status();
        assert!(status["source"]["down"].as_str().unwrap().contains(told), "{status}");
        let reason = format!("SOURCE_DOWN: {}", status["source"]["down"].as_str().unwrap());
        until(daemon.monitor(), &reason, |ready| {
            ready["checks"][0]["name"] == "samples" && ready["checks"][0]["reason"] == reason[..]
        });
        let endpoint = format!("tcp://{}", daemon.address());
        tells(told, || run(trifacet(&["doctor", &endpoint, "--config"]).arg(daemon.file())).out);
        tells(told, || run(trifacet(&["status", &endpoint, "--socket"]).arg(daemon.home.path("socket"))).out);
    }
}

#[test]
fn without_a_control_socket_doctor_asks_the_monitor() {
    let line = Terminal::open();
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let config = format!("monitor.listen = \"{free}\"\ncontrol.socket = \"off\"\n");
    let mut daemon = Daemon::on_port(&line.name(), &config);
    daemon.message("source is down");
    let endpoint = format!("tcp://{}", daemon.address());
    let doctor = || run(trifacet(&["doctor", &endpoint, "--config"]).arg(daemon.file())).out;
    tells("the source is down: no answer to identify", doctor);
}

#[test]
fn a_silent_line_and_one_that_echoes_are_told_apart() {
    let line = Terminal::open();
    let mut daemon = Daemon::on_port(&line.name(), "");
    let down = daemon.message("source is down");
    assert!(down["reason"].as_str().unwrap().contains("nothing arrives"), "{down}");
    // What the daemon sends comes back from now on.
    let echo = std::thread::spawn(move || line.echo());
    let down = daemon.message("source is down");
    assert!(down["reason"].as_str().unwrap().contains("RX and TX"), "{down}");
    drop(daemon); // which ends the echo
    echo.join().unwrap();
}

const NOBODY: u32 = 65534;
const DIALOUT: u32 = 20;

#[test]
fn a_missing_permission_names_user_group_mode_and_remedy() {
    let root = rustix::process::geteuid().is_root();
    if lacks(root, "root, to become another user")
        || lacks(Path::new("/usr/bin/setpriv").exists(), "setpriv, to become another user")
    {
        return;
    }
    let line = Terminal::open();
    let name = line.name();
    chown(&name, Some(0), Some(DIALOUT)).unwrap();
    let user = format!("--reuid={NOBODY}");
    let start = |groups: &str| {
        let home = Folder::new();
        fs::set_permissions(home.path("."), Permissions::from_mode(0o777)).unwrap();
        let through = ["setpriv", &user, "--regid=65534", groups];
        let port = name.display();
        let config = format!("acquisition.source = \"serial\"\nacquisition.serial.port = \"{port}\"\n");
        let mut daemon = Daemon::start_through(&home, &config, &through);
        daemon.message("source is down")["reason"].as_str().unwrap().to_owned()
    };
    fs::set_permissions(&name, Permissions::from_mode(0o660)).unwrap();
    let reason = start("--clear-groups");
    for part in [
        "permission denied: this process runs as user nobody (groups nogroup)",
        "belongs to user root and group dialout with mode 0660",
        "usermod -aG dialout nobody",
        "docs/operation.md",
    ] {
        assert!(reason.contains(part), "{part}: {reason}");
    }
    let reason = start("--groups=20");
    assert!(reason.contains("nothing arrives"), "{reason}");
    fs::set_permissions(&name, Permissions::from_mode(0o600)).unwrap();
    let reason = start("--groups=20");
    assert!(reason.contains("(groups dialout, nogroup)"), "{reason}");
    assert!(reason.contains("mode 0600; a udev rule"), "{reason}");
}

/// Replaces `/dev` of a program by a folder, in which only the terminals are real.
const OWN_DEV: &str = "for f in null zero urandom; do : > \"$0/$f\" && mount --bind /dev/$f \"$0/$f\" || exit 1; done; \
                       mkdir \"$0/pts\" && mount --rbind /dev/pts \"$0/pts\" && mount --rbind \"$0\" /dev \
                       && exec \"$@\"";

#[test]
fn a_device_that_came_back_under_another_name_is_pointed_at() {
    let right = ["unshare", "--user", "--map-root-user", "--mount", "true"];
    let may = std::process::Command::new(right[0]).args(&right[1..]).status().is_ok_and(|end| end.success());
    if lacks(may, "unshare and the right to make namespaces, for another /dev") {
        return;
    }
    let home = Folder::new();
    let dev = home.path("dev");
    fs::create_dir_all(dev.join("serial/by-id")).unwrap();
    let [own, other] =
        ["usb-Bench_Board_0042-if00", "usb-Other_7-if00"].map(|name| dev.join("serial/by-id").join(name));
    let mut board = Board::start("");
    symlink(fs::read_link(board.link()).unwrap(), dev.join("ttyACM0")).unwrap();
    symlink("/dev/ttyACM0", &own).unwrap();
    let through =
        ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", OWN_DEV, dev.to_str().unwrap()];
    let config = "acquisition.source = \"serial\"\nacquisition.serial.port = \"/dev/ttyACM0\"\n";
    let mut daemon = Daemon::start_through(&home, config, &through);
    daemon.message("receiving scans");
    // Unplugged, while another device is there.
    for link in [dev.join("ttyACM0"), own.clone()] {
        fs::remove_file(link).unwrap();
    }
    let stranger = Terminal::open();
    symlink(stranger.name(), &other).unwrap();
    board.order("unplug 0.2");
    let named = format!(
        "serial devices that exist: {} (/dev/serial/by-id/usb-Other_7-if00)",
        stranger.name().display()
    );
    let down = |text: String| {
        move |line: &Value| line["message"] == "source is down" && line.to_string().contains(&text)
    };
    daemon.says("the list of devices", down(named));
    // Plugged in again: the system has given it the next name.
    let second =
        wait_for("connected again", || fs::canonicalize(board.link()).map_err(|error| error.to_string()));
    symlink(&second, dev.join("ttyACM1")).unwrap();
    symlink("/dev/ttyACM1", &own).unwrap();
    let told = format!(
        "the device that was at /dev/ttyACM0 is now {}: set the port to /dev/serial/by-id/usb-Bench_Board_0042-if00",
        second.display()
    );
    daemon.says("the new name", down(told));
    // Without a word from the operator, nothing else is opened.
    symlink(&second, dev.join("ttyACM0")).unwrap();
    daemon.message("receiving scans");
}

#[test]
fn a_port_that_is_configured_twice_is_refused() {
    let home = Folder::new();
    let line = Terminal::open();
    let link = home.path("stage");
    symlink(line.name(), &link).unwrap();
    let config = |board: &Path, stage: &Path| {
        format!(
            "acquisition.source = \"serial\"\nacquisition.serial.port = '{}'\nsteering.kind = \"gcs\"\n\
             steering.gcs.port = '{}'\n",
            board.display(),
            stage.display()
        )
    };
    let refused = |text: &str, keys: [&str; 2]| {
        let file = home.write("twice.toml", text);
        for command in [&["check", "--config"][..], &["run", "--config"]] {
            let done = on(command, &file);
            assert_eq!(done.code, i32::from(exit::CONFIG), "{}", done.err);
            assert!(keys.iter().all(|key| done.err.contains(key)), "{}", done.err);
        }
    };
    let keys = ["steering.gcs.port", "acquisition.serial.port"];
    refused(&config(&line.name(), &link), keys);
    refused(&config("/dev/no-such-device".as_ref(), "/dev/no-such-device".as_ref()), keys);
    let servers = "publishing.tcp = '0.0.0.0:7361'\nmonitor.listen = '127.0.0.1:7361'\n";
    refused(servers, ["monitor.listen", "publishing.tcp"]);
    // A port that is not used does not count, and neither does port 0.
    for text in [
        config(&line.name(), &link)
            .replace("\"serial\"", "\"twin\"\ntwin.steering.readback_noise_um = \"off\""),
        "publishing.tcp = '127.0.0.1:0'\nmonitor.listen = '127.0.0.1:0'\n".to_owned(),
    ] {
        let done = on(&["check", "--config"], &home.write("once.toml", text));
        assert_eq!(done.code, 0, "{}", done.err);
    }
}
