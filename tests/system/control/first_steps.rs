//! The first steps of the README work as printed, one after the other, for a person without special rights.

use std::os::unix::fs::PermissionsExt as _;
use std::process::{Command, Stdio};

use serde_json::Value;

use crate::testkit::{Done, Folder, Killed, Terminal, run, trifacet, wait_for};

/// A person with a session of their own.
struct Person(Folder);

impl Person {
    fn new() -> Self {
        let home = Folder::new();
        std::fs::create_dir(home.path("session")).unwrap();
        home.write(
            "lab.toml",
            "publishing.tcp = '127.0.0.1:0'\npublishing.udp = []\nmonitor.listen = 'off'\n",
        );
        Self(home)
    }

    fn command(&self, args: &[&str]) -> Command {
        let mut command = trifacet(args);
        command
            .current_dir(self.0.path("."))
            .env("XDG_RUNTIME_DIR", self.0.path("session"))
            .env("XDG_DATA_HOME", self.0.path("data"))
            .env_remove("RUNTIME_DIRECTORY")
            .env_remove("STATE_DIRECTORY");
        command
    }

    fn says(&self, args: &[&str]) -> Done {
        run(&mut self.command(args))
    }
}

#[test]
fn run_status_tare_record_and_replay_need_no_other_settings() {
    let person = Person::new();
    let mut daemon =
        Killed(person.command(&["run", "--config", "lab.toml"]).stderr(Stdio::null()).spawn().unwrap());
    let status: Value = wait_for("the control socket", || {
        let done = person.says(&["ctl", "status"]);
        if done.code == 0 { Ok(serde_json::from_str(&done.out).unwrap()) } else { Err(done.err) }
    });
    assert!(status["file"].as_str().unwrap().ends_with("lab.toml"), "{status}");
    let socket = person.0.path("session/trifacet");
    assert_eq!(socket.metadata().unwrap().permissions().mode() & 0o777, 0o700, "only for this person");
    wait_for("the lock", || {
        let done = person.says(&["ctl", "--config", "lab.toml", "status"]);
        if done.out.contains("\"lock\":\"locked\"") { Ok(()) } else { Err(done.out) }
    });
    assert_eq!(person.says(&["ctl", "tare"]).code, 0);
    assert_eq!(person.says(&["ctl", "record", "start"]).code, 0);
    std::thread::sleep(std::time::Duration::from_secs(1)); // some data
    let stopped = person.says(&["ctl", "record", "stop"]);
    assert_eq!(stopped.code, 0, "{}", stopped.err);
    let answer: Value = serde_json::from_str(&stopped.out).unwrap();
    let file = answer["recording"]["last"].as_str().unwrap();
    assert!(file.starts_with(person.0.path("data/trifacet/recordings").to_str().unwrap()), "{file}");
    for args in
        [&["info", file][..], &["replay", file], &["export", file, "--format", "csv", "--output", "a.csv"]]
    {
        let done = person.says(args);
        assert_eq!(done.code, 0, "{args:?}: {}{}", done.out, done.err);
    }
    // A second daemon of the same person does not take over the commands of the first one.
    let second = person.says(&["run", "--config", "lab.toml"]);
    assert!(second.code == 75 && second.err.contains("in use by another daemon"), "{}", second.err);
    daemon.0.kill().unwrap();
}

#[test]
fn without_a_socket_in_the_configuration_ctl_says_so() {
    let person = Person::new();
    person.0.write("off.toml", "control.socket = 'off'\n");
    let done = person.says(&["ctl", "--config", "off.toml", "status"]);
    assert!(done.code == 69 && done.err.contains("off.toml: control.socket is \"off\""), "{}", done.err);
}

#[test]
fn a_terminal_gets_lines_and_a_pipe_gets_json() {
    let mut daemon = crate::testkit::Daemon::start("");
    daemon.address();
    let socket = daemon.socket();
    let args = ["ctl", "--socket", socket.to_str().unwrap()];
    let shown = |more: &[&str]| {
        let terminal = Terminal::open();
        let done = trifacet(&[&args, more].concat()).stdout(Stdio::from(terminal.inside())).status().unwrap();
        assert!(done.success());
        terminal.text()
    };
    let text = shown(&["status"]);
    assert!(text.contains("\r\nloop\r\n") && text.contains("\r\n  mode                on\r\n"), "{text}");
    assert!(text.lines().all(|line| line.trim_end().len() < 80), "{text}");
    assert!(shown(&["--json", "status"]).starts_with('{'));
    let piped = run(&mut trifacet(&[&args[..], &["status"]].concat()));
    assert!(serde_json::from_str::<Value>(&piped.out).unwrap()["loop"]["mode"] == "on", "{}", piped.out);
}
