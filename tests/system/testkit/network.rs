//! Two network namespaces with cables between them, so that tests can pull cables, take hosts away and change
//! addresses. Both have their own /etc/hosts.

use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;

use serde_json::Value;

use super::{Daemon, Folder, Killed, NO_SESSION, PATIENCE};

/// A network: `near`, where the daemon runs, and `far`, where receivers are. Cables are added by the test. The
/// first one is v0 (near, 10.7.0.1/24) to v1 (far, up, without an address).
pub(crate) struct Network {
    near: Killed,
    far: Killed,
    home: Folder,
}

/// `trifacet watch` in the far namespace. Its output is read all the time, so that it never waits for the test.
pub(crate) struct Receiver {
    _program: Killed,
    frames: mpsc::Receiver<u64>,
}

impl Network {
    /// Opens the network. `None` if this user may not make namespaces; a failure in CI.
    pub(crate) fn open() -> Option<Self> {
        let home = Folder::new();
        let hosts = home.path("hosts");
        std::fs::write(&hosts, "127.0.0.1 localhost\n").unwrap();
        let user: &[&str] = if root() { &[] } else { &["--user", "--map-root-user"] };
        let script = format!("mount --bind {} /etc/hosts && ip link set lo up", hosts.display());
        let near = holder(Command::new("unshare").args(user).args(["--net", "--mount"]), &script);
        let Some(near) = near else {
            assert!(
                std::env::var_os("CI").is_none(),
                "unshare, ip and the right to make namespaces are needed"
            );
            eprintln!("no unshare, no ip, or no right to make network namespaces: skipped");
            return None;
        };
        let mut inside = enter(&near.0, "unshare");
        let far = holder(inside.arg("--net"), "ip link set lo up").expect("a second namespace");
        let network = Self { near, far, home };
        network.cable("v0", "v1");
        network.near("ip addr add 10.7.0.1/24 dev v0");
        Some(network)
    }

    /// Adds a cable between two new interfaces, which are then up.
    pub(crate) fn cable(&self, near: &str, far: &str) {
        let far_pid = self.far.0.id();
        self.near(&format!(
            "ip link add {near} type veth peer name {far} netns {far_pid} && ip link set {near} up"
        ));
        self.far(&format!("ip link set {far} up"));
    }

    /// Runs a shell command where the daemon is.
    pub(crate) fn near(&self, command: &str) -> String {
        shell(&self.near.0, command)
    }

    /// Runs a shell command where the receivers are.
    pub(crate) fn far(&self, command: &str) -> String {
        shell(&self.far.0, command)
    }

    /// Starts a daemon with a TCP server, and waits for it.
    pub(crate) fn daemon(&self, config: &str) -> Daemon {
        let through = entering(&self.near.0);
        let through: Vec<_> = through.iter().map(String::as_str).collect();
        let mut daemon = Daemon::start_through(&Folder::new(), config, &through);
        daemon.address();
        daemon
    }

    /// The program with these arguments, where the daemon is.
    pub(crate) fn trifacet(&self, args: &[&str]) -> Command {
        let mut command = enter(&self.near.0, env!("CARGO_BIN_EXE_trifacet"));
        command.args(args).stdin(Stdio::null()).env("XDG_RUNTIME_DIR", NO_SESSION);
        command
    }

    /// A receiver on this endpoint.
    pub(crate) fn watch(&self, endpoint: &str) -> Receiver {
        let mut command = enter(&self.far.0, env!("CARGO_BIN_EXE_trifacet"));
        command.args(["watch", endpoint, "--format", "json", "--reconnect"]);
        let mut program = Killed(command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn().unwrap());
        let lines = BufReader::new(program.0.stdout.take().unwrap()).lines();
        let (sender, frames) = mpsc::channel();
        std::thread::spawn(move || {
            lines.map_while(Result::ok).try_for_each(|line| {
                let frame: Value = serde_json::from_str(&line).unwrap();
                sender.send(frame["sequence"].as_u64().unwrap())
            })
        });
        Receiver { _program: program, frames }
    }

    /// The file that is /etc/hosts in both namespaces.
    pub(crate) fn hosts(&self) -> PathBuf {
        self.home.path("hosts")
    }
}

impl Receiver {
    /// The sequence number of the next frame.
    pub(crate) fn sequence(&mut self) -> u64 {
        self.frames.recv_timeout(PATIENCE).expect("a frame in time")
    }

    /// Waits for frames that are newer than all that have arrived.
    pub(crate) fn goes_on(&mut self, frames: u64) {
        let last = self.frames.try_iter().last().unwrap_or_default().max(self.sequence());
        while self.sequence() < last + frames {}
    }
}

/// Command line that runs a program in the namespaces of a holder. A process cannot enter the user namespace in
/// which it is already.
fn entering(holder: &Child) -> Vec<String> {
    let user: &[&str] = if root() { &[] } else { &["--user", "--preserve-credentials"] };
    let pid = holder.id().to_string();
    [&["nsenter"], user, &["--net", "--mount", "-t", &pid]].concat().into_iter().map(str::to_owned).collect()
}

fn root() -> bool {
    rustix::process::geteuid().is_root()
}

fn enter(holder: &Child, program: &str) -> Command {
    let entering = entering(holder);
    let mut command = Command::new(&entering[0]);
    command.args(&entering[1..]).arg(program);
    command
}

/// A process that keeps new namespaces alive; `None` if they cannot be prepared.
fn holder(unshare: &mut Command, script: &str) -> Option<Killed> {
    let script = format!("{script} && echo ready && exec cat");
    let child = unshare.args(["sh", "-c", &script]).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
    let mut child = Killed(child.ok()?);
    let mut line = String::new();
    BufReader::new(child.0.stdout.take()?).read_line(&mut line).ok()?;
    (line == "ready\n").then_some(child)
}

fn shell(holder: &Child, command: &str) -> String {
    let output = enter(holder, "sh").args(["-c", command]).output().unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command}: {errors}");
    String::from_utf8(output.stdout).unwrap()
}
