//! `trifacet emulate` as a child process.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Stdio};
use std::sync::mpsc;

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use super::{Folder, Killed, PATIENCE, now_ns, trifacet, wait_for};

/// A symbolic link in its own folder, to which boards can be connected one after the other.
#[derive(Clone)]
pub(crate) struct Socket(Folder);

impl Socket {
    pub(crate) fn new() -> Self {
        Self(Folder::new())
    }

    pub(crate) fn link(&self) -> PathBuf {
        self.0.path("board")
    }
}

/// An emulated board. Killed when dropped.
pub(crate) struct Board {
    child: Killed,
    orders: ChildStdin,
    lines: mpsc::Receiver<String>,
    /// Where a host finds it.
    place: String,
    socket: Socket,
    /// Limit of the steering outputs, micrometres.
    limit_um: f64,
}

impl Board {
    /// A board with this configuration behind its own link.
    pub(crate) fn start(config: &str) -> Self {
        Self::plug_into(Socket::new(), config)
    }

    /// Another board behind the same link.
    pub(crate) fn another(&self, config: &str) -> Self {
        Self::plug_into(self.socket.clone(), config)
    }

    /// A board with this configuration, behind this link.
    pub(crate) fn plug_into(socket: Socket, config: &str) -> Self {
        let link = socket.link();
        Self::launch(socket, config, &["--link", link.to_str().unwrap()])
    }

    /// A board with this configuration that listens at an address, or at a Unix socket (`unix:PATH`).
    pub(crate) fn listening(at: &str, config: &str) -> Self {
        Self::launch(Socket::new(), config, &["--listen", at])
    }

    /// A board with these options of `trifacet emulate`, among them `--listen`.
    pub(crate) fn with_options(options: &[&str], config: &str) -> Self {
        Self::launch(Socket::new(), config, options)
    }

    /// Another board at the same address or Unix socket.
    pub(crate) fn another_listening(&self, config: &str) -> Self {
        Self::listening(&self.place, config)
    }

    /// A board that speaks this version of the protocol.
    pub(crate) fn of_version(version: &str, config: &str) -> Self {
        let socket = Socket::new();
        let link = socket.link();
        Self::launch(socket, config, &["--link", link.to_str().unwrap(), "--protocol", version])
    }

    fn launch(socket: Socket, config: &str, options: &[&str]) -> Self {
        let file = socket.0.write("emulate.toml", config);
        let mut child = trifacet(&["emulate", "--config"])
            .arg(&file)
            .args(options)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let orders = child.stdin.take().unwrap();
        let out = child.stdout.take().unwrap();
        let (sender, lines) = mpsc::channel();
        std::thread::spawn(move || {
            BufReader::new(out).lines().map_while(Result::ok).try_for_each(|line| sender.send(line))
        });
        let place = lines.recv_timeout(PATIENCE).unwrap();
        assert_eq!(place.starts_with("/dev/pts/"), options.contains(&"--link"), "{place}");
        Self { child: Killed(child), orders, lines, place, socket, limit_um: 400.0 }
    }

    /// Expects the steering within these limits instead of the default ones.
    pub(crate) fn steered_within(mut self, limit_um: f64) -> Self {
        self.limit_um = limit_um;
        self
    }

    pub(crate) fn link(&self) -> PathBuf {
        self.socket.link()
    }

    /// The address or the Unix socket at which it listens.
    pub(crate) fn place(&self) -> &str {
        &self.place
    }

    pub(crate) fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child.0), signal).unwrap();
    }

    pub(crate) fn pid(&self) -> u32 {
        self.child.0.id()
    }

    fn line(&self) -> String {
        self.lines.recv_timeout(PATIENCE).unwrap()
    }

    /// Sends an order; returns the system time before it. The board obeys later, so a delay measured from
    /// this time is longer than the true one.
    pub(crate) fn order(&mut self, order: &str) -> i64 {
        let before = now_ns();
        writeln!(self.orders, "{order}").unwrap();
        before
    }

    /// The status of the board. The steering outputs must be within their limits in every state.
    pub(crate) fn status(&mut self) -> Value {
        self.order("status");
        loop {
            let line = self.line();
            if line.starts_with('{') {
                let status: Value = serde_json::from_str(&line).unwrap();
                for axis in 0..2 {
                    let output_um = status["output_um"][axis].as_f64().unwrap();
                    assert!(output_um.abs() <= self.limit_um + 0.02, "{status}");
                }
                return status;
            }
            // Connected again.
            assert!(line == self.place || Path::new(&line).starts_with("/dev/pts"), "{line}");
        }
    }

    /// Requests the status until it fulfils this condition.
    pub(crate) fn until(&mut self, is: impl Fn(&Value) -> bool) -> Value {
        wait_for("so", || {
            let status = self.status();
            if is(&status) { Ok(status) } else { Err(status.to_string()) }
        })
    }

    /// Ends the board as a power cut would; returns the time before it.
    pub(crate) fn kill(&mut self) -> i64 {
        let before = now_ns();
        self.child.0.kill().unwrap();
        self.child.0.wait().unwrap();
        before
    }
}
