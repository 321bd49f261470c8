//! `trifacet emulate` as a child process.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Stdio};
use std::sync::mpsc;

use serde_json::Value;

use super::{Folder, Killed, PATIENCE, now_ns, trifacet, wait_for};

/// A link in a folder of its own, to which boards can be plugged in one after the other.
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
    socket: Socket,
    /// The steering outputs must stay within this, micrometres.
    limit_um: f64,
}

impl Board {
    /// A board with this configuration, behind a link of its own.
    pub(crate) fn start(config: &str) -> Self {
        Self::plug_into(Socket::new(), config)
    }

    /// Another board behind the same link.
    pub(crate) fn another(&self, config: &str) -> Self {
        Self::plug_into(self.socket.clone(), config)
    }

    /// A board with this configuration, behind this link.
    pub(crate) fn plug_into(socket: Socket, config: &str) -> Self {
        let file = socket.0.write("emulate.toml", config);
        let mut child = trifacet(&["emulate", "--link"])
            .arg(socket.link())
            .arg("--config")
            .arg(&file)
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
        let board = Self { child: Killed(child), orders, lines, socket, limit_um: 400.0 };
        assert!(board.line().starts_with("/dev/pts/"));
        board
    }

    /// Expects the steering within these limits instead of the default ones.
    pub(crate) fn steered_within(mut self, limit_um: f64) -> Self {
        self.limit_um = limit_um;
        self
    }

    pub(crate) fn link(&self) -> PathBuf {
        self.socket.link()
    }

    pub(crate) fn pid(&self) -> u32 {
        self.child.0.id()
    }

    fn line(&self) -> String {
        self.lines.recv_timeout(PATIENCE).unwrap()
    }

    /// Orders something; returns the moment before it was ordered, by the system clock. The board
    /// obeys some time later, so what is measured from here is measured generously to nobody but it.
    pub(crate) fn order(&mut self, order: &str) -> i64 {
        let before = now_ns();
        writeln!(self.orders, "{order}").unwrap();
        before
    }

    /// What the board is doing. The steering outputs are within their limits, whatever it is.
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
            assert!(Path::new(&line).starts_with("/dev/pts"), "{line}"); // plugged in again
        }
    }

    /// Asks until the board says so.
    pub(crate) fn until(&mut self, is: impl Fn(&Value) -> bool) -> Value {
        wait_for("so", || {
            let status = self.status();
            if is(&status) { Ok(status) } else { Err(status.to_string()) }
        })
    }

    /// Ends the board as a power cut would; returns the moment before.
    pub(crate) fn kill(&mut self) -> i64 {
        let before = now_ns();
        self.child.0.kill().unwrap();
        self.child.0.wait().unwrap();
        before
    }
}
