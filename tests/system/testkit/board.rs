//! `trifacet emulate` as a child process.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc;

use serde_json::Value;

use super::{PATIENCE, now_ns};

/// A link in a folder of its own, to which boards can be plugged in one after the other.
pub(crate) struct Socket {
    folder: tempfile::TempDir,
}

impl Socket {
    pub(crate) fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    pub(crate) fn link(&self) -> PathBuf {
        self.folder.path().join("board")
    }
}

/// An emulated board. Killed when dropped.
pub(crate) struct Board {
    child: Child,
    orders: ChildStdin,
    lines: mpsc::Receiver<String>,
    socket: std::sync::Arc<Socket>,
    /// The steering outputs must stay within this, micrometres.
    limit_um: f64,
}

impl Board {
    /// A board with this configuration, behind a link of its own.
    pub(crate) fn start(config: &str) -> Self {
        Self::plug_into(Socket::new().into(), config)
    }

    /// Another board behind the same link.
    pub(crate) fn another(&self, config: &str) -> Self {
        Self::plug_into(self.socket.clone(), config)
    }

    /// A board with this configuration, behind this link.
    pub(crate) fn plug_into(socket: std::sync::Arc<Socket>, config: &str) -> Self {
        let file = socket.folder.path().join("emulate.toml");
        std::fs::write(&file, config).unwrap();
        let mut child = Command::new(env!("CARGO_BIN_EXE_trifacet"))
            .args(["emulate", "--link"])
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
        let board = Self { child, orders, lines, socket, limit_um: 400.0 };
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
        let mut status = Value::Null;
        for _ in 0..PATIENCE.as_millis() / 10 {
            status = self.status();
            if is(&status) {
                return status;
            }
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
        panic!("never so: {status}");
    }

    /// Ends the board as a power cut would; returns the moment before.
    pub(crate) fn kill(&mut self) -> i64 {
        let before = now_ns();
        self.child.kill().unwrap();
        self.child.wait().unwrap();
        before
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
