//! A daemon on the twin, told what to do through the binary, its socket and signals.

use std::io::{BufRead, BufReader, Write};
use std::net::UdpSocket;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::mpsc;
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use trifacet::client::PoseFrame;

/// Longer than anything here takes on the slowest machine.
pub(crate) const PATIENCE: Duration = Duration::from_secs(30);

/// A mirror at rest, away from the origin; no readback of the stage.
pub(crate) const AT_REST: &str = "\
[twin]
steering.readback_noise_um = \"off\"
[[twin.motion]]
axis = \"tx\"
kind = \"step\"
amount_um = 100.0
[[twin.motion]]
axis = \"yaw\"
kind = \"step\"
amount_urad = 300.0
";

/// A running daemon. Killed when dropped.
pub(crate) struct Daemon {
    child: Child,
    lines: mpsc::Receiver<Value>,
    pub(crate) folder: tempfile::TempDir,
    udp: UdpSocket,
    /// Where TCP clients connect.
    pub(crate) tcp: String,
}

pub(crate) fn trifacet(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_trifacet")).args(args).stdin(Stdio::null()).output().unwrap()
}

impl Daemon {
    /// Starts one and waits for its socket. The text must not have `[publishing]`, `[control]`, `[monitor]`
    /// or `[log]`.
    pub(crate) fn start(text: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let udp = UdpSocket::bind("127.0.0.1:0").unwrap();
        udp.set_read_timeout(Some(PATIENCE)).unwrap();
        let port = udp.local_addr().unwrap().port();
        let text = format!(
            "# our lab\n[publishing]\ntcp = \"127.0.0.1:0\"\nudp = [\"127.0.0.1:{port}\"]\n\
             [control]\nsocket = \"{}/socket\"\nmode = \"0640\"\n[monitor]\nlisten = \"off\"\n\
             [log]\nformat = \"json\"\n{text}",
            folder.path().display()
        );
        std::fs::write(folder.path().join("lab.toml"), text).unwrap();
        let mut daemon =
            Self { child: run(folder.path()), lines: mpsc::channel().1, folder, udp, tcp: String::new() };
        daemon.listen();
        daemon
    }

    fn listen(&mut self) {
        let errors = self.child.stderr.take().unwrap();
        let (sender, lines) = mpsc::channel();
        std::thread::spawn(move || {
            BufReader::new(errors)
                .lines()
                .map_while(Result::ok)
                .try_for_each(|line| sender.send(serde_json::from_str(&line).unwrap_or(Value::String(line))))
        });
        self.lines = lines;
        self.says("control socket is open");
        let listening = self.says("listening");
        listening["address"].as_str().unwrap().clone_into(&mut self.tcp);
    }

    /// The next line of the log with this message.
    pub(crate) fn says(&mut self, text: &str) -> Value {
        let mut log = Vec::new();
        loop {
            let Ok(line) = self.lines.recv_timeout(PATIENCE) else { panic!("never {text}: {log:#?}") };
            log.push(line.to_string());
            if line["message"].as_str().is_some_and(|message| message.contains(text)) {
                return line;
            }
        }
    }

    pub(crate) fn file(&self) -> PathBuf {
        self.folder.path().join("lab.toml")
    }

    pub(crate) fn text(&self) -> String {
        std::fs::read_to_string(self.file()).unwrap()
    }

    /// Changes the configuration file.
    pub(crate) fn rewrite(&self, from: &str, to: &str) {
        let text = self.text();
        assert!(text.contains(from), "{text}");
        std::fs::write(self.file(), text.replacen(from, to, 1)).unwrap();
    }

    pub(crate) fn socket(&self) -> PathBuf {
        self.folder.path().join("socket")
    }

    /// What `trifacet ctl` answers: its exit code, what it prints, what it complains of.
    pub(crate) fn ctl(&self, args: &[&str]) -> (i32, Value, String) {
        let socket = self.socket();
        let output = trifacet(&[&["ctl", "--socket", socket.to_str().unwrap()], args].concat());
        let answer = serde_json::from_slice(&output.stdout).unwrap_or_default();
        (output.status.code().unwrap(), answer, String::from_utf8(output.stderr).unwrap())
    }

    /// The answer to a command that must work.
    pub(crate) fn told(&self, args: &[&str]) -> Value {
        let (code, answer, errors) = self.ctl(args);
        assert_eq!((code, &answer["ok"]), (0, &Value::Bool(true)), "{args:?}: {answer} {errors}");
        answer
    }

    /// Asks for the status until this is true of it.
    pub(crate) fn until(&self, is: impl Fn(&Value) -> bool) -> Value {
        let mut status = Value::Null;
        for _ in 0..PATIENCE.as_millis() / 20 {
            status = self.told(&["status"]);
            if is(&status) {
                return status;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        panic!("never so: {status}");
    }

    /// A connection to the socket, for what `ctl` would not say.
    pub(crate) fn connect(&self) -> (BufReader<UnixStream>, UnixStream) {
        let stream = UnixStream::connect(self.socket()).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        (BufReader::new(stream.try_clone().unwrap()), stream)
    }

    /// The next frame.
    pub(crate) fn frame(&self) -> PoseFrame {
        let mut bytes = [0; 300];
        let n = self.udp.recv(&mut bytes).unwrap();
        PoseFrame::decode(&bytes[..n]).unwrap()
    }

    /// The next frame of which this is true.
    pub(crate) fn frame_with(&self, is: impl Fn(&PoseFrame) -> bool) -> PoseFrame {
        for _ in 0..60_000 {
            let frame = self.frame();
            if is(&frame) {
                return frame;
            }
        }
        panic!("no such frame in a minute")
    }

    pub(crate) fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).unwrap();
    }

    /// Ends it in order and starts it again with what is in its file.
    pub(crate) fn restart(&mut self) {
        self.end();
        self.start_again();
    }

    /// Starts it after it has ended.
    pub(crate) fn start_again(&mut self) {
        self.child = run(self.folder.path());
        self.listen();
    }

    /// Ends it as a power cut would.
    pub(crate) fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    pub(crate) fn end(&mut self) {
        self.signal(Signal::TERM);
        assert_eq!(self.child.wait().unwrap().code(), Some(0));
        assert!(!self.socket().exists(), "the socket goes with the daemon");
        self.udp.set_nonblocking(true).unwrap();
        while self.udp.recv(&mut [0; 300]).is_ok() {} // frames of the past
        self.udp.set_nonblocking(false).unwrap();
    }
}

fn run(folder: &Path) -> Child {
    Command::new(env!("CARGO_BIN_EXE_trifacet"))
        .args(["run", "--config"])
        .arg(folder.join("lab.toml"))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Says a line and returns the answer.
pub(crate) fn say((read, write): &mut (BufReader<UnixStream>, UnixStream), line: &str) -> Value {
    write.write_all(line.as_bytes()).unwrap();
    let mut answer = String::new();
    read.read_line(&mut answer).unwrap();
    serde_json::from_str(&answer).unwrap()
}
