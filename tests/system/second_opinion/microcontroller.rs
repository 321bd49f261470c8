//! The reference firmware on a microcontroller that QEMU emulates.

use std::fs::OpenOptions;
use std::io::{BufRead, BufReader, Read};
use std::path::PathBuf;
use std::process::{Command, Stdio};

use tempfile::TempDir;
use trifacet_wire::board::{Answer, BoardScan, Deframer};

use crate::kits::tools::{root, succeeded};
use crate::testkit::{Daemon, Killed, lacks};

/// A running microcontroller.
struct Machine {
    _child: Killed,
    _place: TempDir,
    port: PathBuf,
}

impl Machine {
    /// Builds the firmware and starts it; `None` without the tools.
    fn start() -> Option<Self> {
        let present = ["arm-none-eabi-gcc", "qemu-system-arm"]
            .iter()
            .all(|tool| Command::new(tool).arg("--version").output().is_ok());
        if lacks(present, "arm-none-eabi-gcc and qemu-system-arm: run firmware/check") {
            return None;
        }
        let place = tempfile::tempdir().unwrap();
        let program = place.path().join("firmware.elf");
        let build = root("firmware/port/lm3s6965/build");
        succeeded(Command::new(build).arg(&program), "firmware/port/lm3s6965/build");
        let mut child = Command::new("qemu-system-arm")
            .args(["-M", "lm3s6965evb", "-nographic", "-monitor", "none", "-serial", "pty", "-kernel"])
            .arg(&program)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines().map_while(Result::ok);
        let child = Killed(child);
        let name =
            |line: String| line.split_whitespace().find(|word| word.starts_with("/dev/")).map(PathBuf::from);
        let port = lines.find_map(name).expect("QEMU prints the name of the terminal");
        Some(Self { _child: child, _place: place, port })
    }

    /// Reads the line without a host until a scan fulfils this condition.
    fn scan(&self, is: impl Fn(&BoardScan) -> bool) -> BoardScan {
        let mut line = OpenOptions::new().read(true).write(true).open(&self.port).unwrap();
        let (mut deframer, mut bytes) = (Deframer::default(), [0; 256]);
        loop {
            let count = line.read(&mut bytes).unwrap();
            let mut rest = &bytes[..count];
            while let Some(message) = deframer.next(&mut rest) {
                match message.ok().and_then(|message| Answer::decode(message).ok()) {
                    Some(Answer::Scan(scan)) if is(&scan) => return scan,
                    _ => {}
                }
            }
        }
    }
}

#[test]
fn a_microcontroller_closes_the_loop_and_parks_the_stage_without_the_daemon() {
    let Some(machine) = Machine::start() else { return };
    let mut daemon = Daemon::on_port(
        &machine.port,
        "acquisition.rate_hz = 200\nacquisition.serial.baud = 460800\nacquisition.silence_ms = 2000\n\
         steering.on_lease = \"park\"\nsteering.park_um = [-50, 100]",
    );
    let mut client = daemon.client();
    client.locked();
    client.samples(400);
    let counters = client.heartbeat().counters;
    for name in ["scans_lost", "frames_corrupted", "frames_unknown", "board_errors", "board_restarts"] {
        assert_eq!(counters[name], 0, "{name}: {counters:?}");
    }
    daemon.kill();
    let expired = machine.scan(|scan| scan.lease_expired);
    // The readback, 50 um per volt, 18 bits for +-10 V, some scans later.
    let parked = machine.scan(|scan| scan.sequence > expired.sequence + 10);
    let position_um = [9, 10].map(|channel: usize| f64::from(parked.codes[channel]) * 500.0 / 131_072.0);
    assert!((position_um[0] + 50.0).abs() < 2.0 && (position_um[1] - 100.0).abs() < 2.0, "{position_um:?}");
}
