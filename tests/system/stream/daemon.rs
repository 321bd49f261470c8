//! `trifacet run` with the twin, as its users start it. Killed when dropped.

use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;

use serde_json::Value;

use super::fixture::PATIENCE;

pub(crate) struct Daemon {
    child: Child,
    lines: mpsc::Receiver<Value>,
    _folder: tempfile::TempDir,
}

impl Daemon {
    /// With these keys of `[publishing]`, and others after them.
    pub(crate) fn start(publishing: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("trifacet.toml");
        std::fs::write(
            &file,
            format!("log.format = \"json\"\nmonitor.listen = \"off\"\n[publishing]\n{publishing}\n"),
        )
        .unwrap();
        let mut child = Command::new(env!("CARGO_BIN_EXE_trifacet"))
            .args(["run", "--config"])
            .arg(&file)
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let log = BufReader::new(child.stderr.take().unwrap());
        let (sender, lines) = mpsc::channel();
        std::thread::spawn(move || {
            log.lines()
                .map_while(Result::ok)
                .try_for_each(|line| sender.send(serde_json::from_str(&line).unwrap_or(Value::String(line))))
        });
        Self { child, lines, _folder: folder }
    }

    /// The address in the next line of the log with this message.
    fn address(&self, message: &str) -> SocketAddr {
        let mut log = Vec::new();
        loop {
            let line = self.lines.recv_timeout(PATIENCE).unwrap_or_else(|_| panic!("no {message}: {log:#?}"));
            if line["message"] == message {
                return line["address"].as_str().unwrap().parse().unwrap();
            }
            log.push(line);
        }
    }

    /// Where TCP clients connect. To be asked first, and once.
    pub(crate) fn tcp(&self) -> SocketAddr {
        self.address("listening")
    }

    /// Where receivers subscribe. To be asked once.
    pub(crate) fn subscriptions(&self) -> SocketAddr {
        self.address("UDP subscriptions are taken")
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
