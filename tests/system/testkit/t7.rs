//! `trifacet emulate --device t7` as a child process.

use std::io::{BufRead, BufReader, Write};
use std::net::SocketAddr;
use std::process::{ChildStdin, Stdio};
use std::sync::mpsc;

use serde_json::Value;

use super::{Folder, Killed, PATIENCE, trifacet, wait_for};

/// The inputs of the tests: they are not in the order of their numbers.
const WIRING: &str = "[acquisition.labjack]\ninputs = [8, 7, 6, 5, 4, 3, 2, 1, 0]\nreadback = [12, 10]\n";

/// An emulated LabJack T7. Killed when dropped.
pub(crate) struct T7 {
    _child: Killed,
    orders: ChildStdin,
    lines: mpsc::Receiver<String>,
    /// Of the registers and of the stream.
    pub(crate) ports: [u16; 2],
}

impl T7 {
    /// A device at two free ports.
    pub(crate) fn start(config: &str) -> Self {
        let folder = Folder::new();
        let file = folder.write("emulate.toml", format!("{config}\n{WIRING}"));
        let mut child =
            trifacet(&["emulate", "--device", "t7", "--port", "0", "--stream-port", "0", "--config"])
                .arg(&file)
                .stdin(Stdio::piped())
                .stdout(Stdio::piped())
                .spawn()
                .unwrap();
        let (orders, out) = (child.stdin.take().unwrap(), child.stdout.take().unwrap());
        let (sender, lines) = mpsc::channel();
        std::thread::spawn(move || {
            BufReader::new(out).lines().map_while(Result::ok).try_for_each(|line| sender.send(line))
        });
        let mut device = Self { _child: Killed(child), orders, lines, ports: [0; 2] };
        device.ports = device.plugged_in();
        device
    }

    /// The ports that it prints when it is plugged in.
    fn plugged_in(&self) -> [u16; 2] {
        let line = self.lines.recv_timeout(PATIENCE).unwrap();
        let words: Vec<_> = line.split(' ').collect();
        let ["registers", registers, "stream", stream] = words[..] else { panic!("{line}") };
        [registers, stream].map(|address| {
            let address: SocketAddr = address.parse().unwrap();
            assert!(address.ip().is_loopback(), "{address}");
            address.port()
        })
    }

    /// The configuration of a daemon for this device. `config` has no tables; `labjack` are further keys of its section.
    pub(crate) fn host(&self, config: &str, labjack: &str) -> String {
        let [registers, stream] = self.ports;
        format!(
            "acquisition.source = \"labjack\"\ncentering.loop_delay_ms = 4.0\n{config}\n{WIRING}address = \"127.0.0.1\"\n\
             port = {registers}\nstream_port = {stream}\n{labjack}\n"
        )
    }

    pub(crate) fn order(&mut self, order: &str) {
        writeln!(self.orders, "{order}").unwrap();
    }

    pub(crate) fn status(&mut self) -> Value {
        self.order("status");
        loop {
            let line = self.lines.recv_timeout(PATIENCE).unwrap();
            if line.starts_with('{') {
                return serde_json::from_str(&line).unwrap();
            }
            assert!(line.starts_with("registers "), "{line}"); // connected again
        }
    }

    /// Requests the status until it fulfils this condition.
    pub(crate) fn until(&mut self, is: impl Fn(&Value) -> bool) -> Value {
        wait_for("so", || {
            let status = self.status();
            if is(&status) { Ok(status) } else { Err(status.to_string()) }
        })
    }
}
