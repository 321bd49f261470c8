//! A daemon that records, and what is in its files.

use std::io::{BufRead, BufReader};
use std::net::UdpSocket;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, mpsc};
use std::time::Duration;

use mcap::MessageStream;
use mcap::read::Options;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use trifacet::client::PoseFrame;
use trifacet::recording::codec::{Decoder, read};
use trifacet::recording::message::Gap;
use trifacet::recording::{Entry, Topic};

/// Longer than anything here takes on the slowest machine.
pub(crate) const PATIENCE: Duration = Duration::from_mins(1);

/// A running daemon with everything that it sends. Killed when dropped.
pub(crate) struct Daemon {
    child: Child,
    lines: mpsc::Receiver<Value>,
    pub(crate) log: Vec<Value>,
    pub(crate) home: tempfile::TempDir,
    heard: Arc<Mutex<Vec<PoseFrame>>>,
}

impl Daemon {
    /// Starts one with these dotted keys.
    pub(crate) fn start(config: &str) -> Self {
        Self::start_in(tempfile::tempdir().unwrap(), config, &[])
    }

    /// The same in a folder, by way of another program.
    pub(crate) fn start_in(home: tempfile::TempDir, config: &str, through: &[&str]) -> Self {
        let udp = UdpSocket::bind("127.0.0.1:0").unwrap();
        rustix::net::sockopt::set_socket_recv_buffer_size(&udp, 1 << 20).unwrap();
        let text = format!(
            "publishing = {{ tcp = \"off\", udp = [\"{}\"] }}\nlog.format = \"json\"\n\
             control.socket = \"{}/socket\"\n{config}\n",
            udp.local_addr().unwrap(),
            home.path().display()
        );
        let defaults = [("recording.folder", "recordings"), ("monitor.listen", "off")];
        let text = defaults
            .iter()
            .filter(|(key, _)| !config.contains(key))
            .fold(text, |text, (key, value)| format!("{key} = \"{value}\"\n{text}"));
        let file = home.path().join("lab.toml");
        std::fs::write(&file, text).unwrap();
        let program = [through, &[env!("CARGO_BIN_EXE_trifacet")]].concat();
        let mut child = Command::new(program[0])
            .args(&program[1..])
            .args(["run", "--config"])
            .arg(&file)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .process_group(0)
            .spawn()
            .unwrap();
        let errors = child.stderr.take().unwrap();
        let (sender, lines) = mpsc::channel();
        std::thread::spawn(move || {
            BufReader::new(errors)
                .lines()
                .map_while(Result::ok)
                .try_for_each(|line| sender.send(serde_json::from_str(&line).unwrap_or(Value::String(line))))
        });
        let heard = Arc::new(Mutex::new(Vec::new()));
        let into = Arc::downgrade(&heard);
        std::thread::spawn(move || {
            let mut bytes = [0; 300];
            while let Ok(n) = udp.recv(&mut bytes) {
                let Some(into) = into.upgrade() else { break };
                into.lock().unwrap().push(PoseFrame::decode(&bytes[..n]).unwrap());
            }
        });
        Self { child, lines, log: Vec::new(), home, heard }
    }

    /// Everything that was sent so far and arrived.
    pub(crate) fn frames(&self) -> Vec<PoseFrame> {
        self.heard.lock().unwrap().clone()
    }

    /// Waits for a frame from now on of which this is true.
    pub(crate) fn waits(&self, what: &str, is: impl Fn(&PoseFrame) -> bool) -> PoseFrame {
        let mut from = self.heard.lock().unwrap().len();
        for _ in 0..PATIENCE.as_millis() / 20 {
            std::thread::sleep(Duration::from_millis(20));
            let heard = self.heard.lock().unwrap();
            if let Some(frame) = heard[from..].iter().find(|frame| is(frame)) {
                return *frame;
            }
            from = heard.len();
        }
        panic!("no frame {what}");
    }

    /// Waits until the stream has gone on for so many seconds of its own time.
    pub(crate) fn runs_for(&self, seconds: f64) {
        let start = self.waits("at all", |_| true).time_ns;
        self.waits("later", |frame| (frame.time_ns - start) as f64 > seconds * 1e9);
    }

    /// The next line of the log with this message.
    pub(crate) fn says(&mut self, text: &str) -> Value {
        loop {
            let Ok(line) = self.lines.recv_timeout(PATIENCE) else {
                panic!("never {text}: {:#?}", self.log);
            };
            self.log.push(line.clone());
            if line["message"].as_str().is_some_and(|message| message.contains(text)) {
                return line;
            }
        }
    }

    /// Where its recordings are.
    pub(crate) fn folder(&self) -> PathBuf {
        self.home.path().join("recordings")
    }

    /// What `trifacet ctl` answers: its exit code, what it prints, what it complains of.
    pub(crate) fn ctl(&self, args: &[&str]) -> (i32, Value, String) {
        let socket = self.home.path().join("socket");
        let output = Command::new(env!("CARGO_BIN_EXE_trifacet"))
            .args(["ctl", "--socket"])
            .arg(socket)
            .args(args)
            .output()
            .unwrap();
        let answer = serde_json::from_slice(&output.stdout).unwrap_or_default();
        (output.status.code().unwrap(), answer, String::from_utf8(output.stderr).unwrap())
    }

    pub(crate) fn status(&self) -> Value {
        self.ctl(&["status"]).1
    }

    pub(crate) fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// Ends it in order; gives every frame that it has sent.
    pub(crate) fn stop(&mut self) -> Vec<PoseFrame> {
        kill_process(Pid::from_child(&self.child), Signal::TERM).unwrap();
        let end: ExitStatus = self.child.wait().unwrap();
        self.log.extend(self.lines.iter());
        assert_eq!(end.code(), Some(0), "{:#?}", self.log);
        self.frames()
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        if std::thread::panicking() {
            self.log.extend(self.lines.try_iter());
            self.log.iter().for_each(|line| eprintln!("{line}"));
        }
    }
}

/// The recordings in a folder, the oldest first.
pub(crate) fn recordings(folder: &Path) -> Vec<PathBuf> {
    let mut all: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|file| file.unwrap().path()).collect();
    all.sort();
    all
}

/// What a file holds: entries as far as it is whole, and what it says of gaps.
#[derive(Default)]
pub(crate) struct Content {
    pub(crate) entries: Vec<Entry>,
    pub(crate) gaps: u64,
    /// Entries that are missing by those gaps.
    pub(crate) missing: u64,
    pub(crate) whole: bool,
}

impl Content {
    pub(crate) fn read(path: &Path) -> Self {
        let bytes = std::fs::read(path).unwrap();
        let options = Options::IgnoreEndMagic.into();
        let mut content = Self::default();
        let mut decoder = Decoder::default();
        for message in MessageStream::new_with_options(&bytes, options).unwrap() {
            let Ok(message) = message else { return content };
            let topic = Topic::of(&message.channel.topic).unwrap();
            if topic == Topic::Gap {
                content.gaps += 1;
                content.missing += read::<Gap>(topic, &message.data).unwrap().entries;
            }
            content.entries.extend(decoder.decode(topic, &message.data).unwrap());
        }
        content.whole = mcap::Summary::read(&bytes).is_ok_and(|summary| summary.is_some());
        content
    }

    pub(crate) fn frames(&self) -> Vec<PoseFrame> {
        let frame = |entry: &Entry| match entry {
            Entry::Frame { frame, .. } => Some(*frame),
            _ => None,
        };
        self.entries.iter().filter_map(frame).collect()
    }

    pub(crate) fn sample_indices(&self) -> Vec<u64> {
        let index = |entry: &Entry| match entry {
            Entry::Sample { scan, .. } => Some(scan.index),
            _ => None,
        };
        self.entries.iter().filter_map(index).collect()
    }
}

/// Every frame of the stream from the first to the last in the file is in the file, the same to the bit.
pub(crate) fn same(file: &[PoseFrame], stream: &[PoseFrame]) {
    let (first, last) = (file.first().unwrap().sequence, file.last().unwrap().sequence);
    assert_eq!(file.len() as u64, last - first + 1, "frames are missing in the file");
    let mut compared = 0;
    for frame in stream.iter().filter(|frame| (first..=last).contains(&frame.sequence)) {
        let recorded = &file[(frame.sequence - first) as usize];
        assert_eq!(recorded.encode(), frame.encode(), "{frame:?}");
        compared += 1;
    }
    assert!(compared * 2 > file.len(), "only {compared} of {} arrived by UDP", file.len());
}
