//! A reload from a file that has no contents, that is no regular file, or whose file system does not respond.

use std::os::unix::fs::symlink;
use std::process::Command;

use rustix::process::Signal;
use serde_json::Value;
use trifacet::exit;

use super::fixture::{AT_REST, Lab};
use crate::testkit::{Daemon, Folder, http, lacks, run, wait_for};

/// Refuses the reload with this text, and the tool stays in force.
fn refuses(daemon: &mut Lab, text: &str) {
    let before = daemon.status();
    let (code, _, errors) = daemon.ctl(&["reload"]);
    assert_eq!(code, i32::from(exit::CONFIG), "{errors}");
    assert!(errors.contains("configuration unchanged") && errors.contains(text), "{errors}");
    daemon.signal(Signal::HUP);
    let by_signal = |line: &Value| line["uid"].is_null() && line["command"] == "reload";
    let line = daemon.says("the answer to SIGHUP", by_signal);
    assert!(line["level"] == "WARN" && line.to_string().contains(text), "{line}");
    let after = daemon.status();
    assert_eq!((&after["config"], &after["frames"]), (&before["config"], &before["frames"]));
    assert_eq!(after["frames"]["tool"]["translation_mm"][2], -40.0, "{after}");
}

const TOOL: &str = "[frames.tool]\ntranslation_mm = [0.0, 0.0, -40.0]\n";

#[test]
fn a_file_without_text_changes_nothing() {
    let mut daemon = Lab::start(&format!("{TOOL}{AT_REST}"));
    let text = daemon.text();
    let utf16: Vec<u8> = format!("\u{feff}{text}").encode_utf16().flat_map(u16::to_le_bytes).collect();
    for (bytes, told) in [
        (Vec::new(), "daemon.toml: the file is empty"),
        (b" \r\n\n\t".to_vec(), "daemon.toml: the file is empty"),
        (b"\xef\xbb\xbf".to_vec(), "daemon.toml: the file is empty"),
        (vec![0; 4096], "daemon.toml:1:1: a zero byte"),
        (utf16, "daemon.toml:1:1: the text is in UTF-16"),
        (b"[frames]\n# 40 \xb5m\n".to_vec(), "daemon.toml:2:6: the byte 0xb5 is not UTF-8"),
    ] {
        std::fs::write(daemon.file(), bytes).unwrap();
        refuses(&mut daemon, told);
    }
    // A complete file is taken over again.
    std::fs::write(daemon.file(), text.replace("-40.0", "-41.0")).unwrap();
    assert_eq!(daemon.told(&["reload"])["changed"][0], "frames.tool.translation_mm");
    let line = daemon.message("configuration: frames.tool.translation_mm");
    let told = line["message"].as_str().unwrap();
    assert!(told.ends_with("= [0.0,0.0,-41.0], was [0.0,0.0,-40.0]"), "{told}");
}

#[test]
fn what_is_not_a_regular_file_changes_nothing_and_blocks_nothing() {
    let mut daemon = Lab::start(&format!("{TOOL}{AT_REST}"));
    let text = daemon.text();
    std::fs::remove_file(daemon.file()).unwrap();
    assert!(Command::new("mkfifo").arg(daemon.file()).status().unwrap().success());
    refuses(&mut daemon, "it is a pipe, not a regular file, so it cannot be read again");
    std::fs::remove_file(daemon.file()).unwrap();
    std::fs::create_dir(daemon.file()).unwrap();
    refuses(&mut daemon, "it is a folder, not a regular file");
    std::fs::remove_dir(daemon.file()).unwrap();
    symlink("/dev/zero", daemon.file()).unwrap();
    refuses(&mut daemon, "it is a device, not a regular file");
    // A correction table that is a pipe.
    std::fs::remove_file(daemon.file()).unwrap();
    assert!(Command::new("mkfifo").arg(daemon.home.path("a.csv")).status().unwrap().success());
    std::fs::write(daemon.file(), format!("channels.a.correction = \"a.csv\"\n{text}")).unwrap();
    refuses(&mut daemon, "a.csv: it is a pipe, not a regular file");
    daemon.end();
}

#[test]
fn a_daemon_can_start_from_a_pipe_and_refuses_to_reload_it() {
    let script = "exec \"$1\" \"$2\" \"$3\" <(cat \"$4\")";
    let config = format!("{TOOL}{AT_REST}");
    let mut daemon = Daemon::start_through(&Folder::new(), &config, &["bash", "-c", script, "-"]);
    daemon.message("control socket is open");
    let before = daemon.status();
    assert_eq!(before["frames"]["tool"]["translation_mm"][2], -40.0, "{before}");
    daemon.signal(Signal::HUP);
    let line = daemon.message("configuration unchanged").to_string();
    assert!(line.contains("it is a pipe") && line.contains("restart the daemon"), "{line}");
    let (_, _, errors) = daemon.ctl(&["tare", "--save"]);
    assert!(errors.contains("tare unchanged") && errors.contains("it is a pipe"), "{errors}");
    assert_eq!(daemon.status()["config"], before["config"]);
}

#[test]
fn relative_paths_in_a_configuration_from_a_pipe_are_refused() {
    let folder = Folder::new();
    let config = "channels.a.correction = 'a.csv'\n[recording]\nfolder = 'rec'\n[replay]\nfile = 'a.mcap'\n";
    let script = "\"$1\" check --config <(cat \"$2\")";
    let check = |text: &str| {
        let file = folder.write("lab.toml", text);
        let mut bash = Command::new("bash");
        run(bash
            .args(["-c", script, "-", env!("CARGO_BIN_EXE_trifacet")])
            .arg(file)
            .current_dir(folder.path("")))
    };
    let done = check(config);
    assert_eq!(done.code, 78, "{}", done.err);
    for part in [
        ":1:25: channels.a.correction = 'a.csv': allowed is an absolute path, because the configuration comes from a pipe",
        ":3:10: recording.folder = 'rec': allowed is an absolute path",
        ":5:8: replay.file = 'a.mcap': allowed is an absolute path",
    ] {
        assert!(done.err.contains(part), "{}", done.err);
    }
    assert_eq!(done.err.lines().count(), 3, "{}", done.err);
    let done = check(&format!("recording.folder = '{}'", folder.path("rec").display()));
    assert_eq!(done.code, 0, "{}", done.err);
}

/// A daemon whose configuration file has moved to a file system that does not respond, and the text of the file
/// before. `None`: such a file system cannot be made.
///
/// It is a FUSE file system whose server never answers: every access waits, as on a network file system without
/// its server. Every access fails when the server ends, as soon as the file `dead.end` appears.
fn unresponsive() -> Option<(Daemon, String)> {
    let fuse = std::path::Path::new("/dev/fuse").exists();
    if lacks(fuse, "/dev/fuse, for a file system that does not respond") {
        return None;
    }
    let home = Folder::new();
    let dead = home.path("dead");
    std::fs::create_dir(&dead).unwrap();
    let script = "exec 3<>/dev/fuse \
                  && mount -i -t fuse -o fd=3,rootmode=40000,user_id=0,group_id=0 none \"$0\" || exit 1; \
                  (while [ ! -e \"$0.end\" ] && [ -e \"${0%/*}\" ]; do sleep 0.1; done) > /dev/null 2>&1 & \
                  exec \"$@\" 3<&-";
    let through =
        ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", script, dead.to_str().unwrap()];
    let config = format!("monitor.listen = \"127.0.0.1:0\"\n{TOOL}{AT_REST}");
    let mut daemon = Daemon::start_through(&home, &config, &through);
    daemon.message("control socket is open");
    daemon.status_until(|status| status["pose"]["valid"] == true);
    let text = daemon.text();
    std::fs::remove_file(daemon.file()).unwrap();
    symlink(dead.join("daemon.toml"), daemon.file()).unwrap();
    Some((daemon, text))
}

#[test]
fn a_file_system_that_does_not_respond_stalls_nothing() {
    let Some((mut daemon, _)) = unresponsive() else { return };
    let monitor = daemon.monitor();
    daemon.signal(Signal::HUP);
    // While the file is being opened, everything else goes on.
    assert_eq!(http::get(monitor, "/healthz").code, 200);
    assert_eq!(daemon.told(&["gains", "0.1", "100"])["loop"]["kp"], 0.1);
    daemon.client();
    assert!(!daemon.said("configuration unchanged"), "the time limit has passed already");
    let line = daemon.message("configuration unchanged").to_string();
    assert!(line.contains("has not responded for 5 s"), "{line}");
    for command in [&["reload"][..], &["tare", "--save"]] {
        let (code, _, errors) = daemon.ctl(command);
        assert_eq!(code, i32::from(exit::IO), "{errors}");
        assert!(errors.contains("an earlier access to") && errors.contains("has not returned"), "{errors}");
    }
    let threads = std::fs::read_dir(format!("/proc/{}/task", daemon.pid())).unwrap().count();
    assert_eq!(http::get(monitor, "/healthz").code, 200);
    let (_, _, errors) = daemon.ctl(&["reload"]);
    assert!(errors.contains("has not returned"), "{errors}");
    let later = std::fs::read_dir(format!("/proc/{}/task", daemon.pid())).unwrap().count();
    assert!(later <= threads, "{threads} threads, then {later}");
    // The daemon ends although the access has not returned.
    daemon.ends_in_order(Signal::TERM);
    daemon.home.write("dead.end", "");
}

#[test]
fn when_the_file_system_responds_again_so_does_reload() {
    let Some((mut daemon, text)) = unresponsive() else { return };
    daemon.signal(Signal::HUP);
    daemon.message("has not responded for 5 s");
    std::fs::remove_file(daemon.file()).unwrap();
    std::fs::write(daemon.file(), text.replace("-40.0", "-41.0")).unwrap();
    let (_, _, errors) = daemon.ctl(&["reload"]);
    assert!(errors.contains("has not returned"), "the path is another one, but the access goes on: {errors}");
    daemon.home.write("dead.end", "");
    daemon.message("an access to the configuration file has ended after its time limit");
    let answer = wait_for("reloaded", || match daemon.ctl(&["reload"]) {
        (0, answer, _) => Ok(answer),
        (_, _, errors) => Err(errors),
    });
    assert_eq!(answer["changed"][0], "frames.tool.translation_mm");
}
