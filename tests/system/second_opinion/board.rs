//! The board of `firmware/host` as a child process, with the truth that it prints.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError, Weak, mpsc};

use tempfile::TempDir;

use crate::kits::tools::{compile, root};
use crate::testkit::{Daemon, Folder, Frame, Killed, PATIENCE};

/// The compiled program; its folder is removed at the end of the test.
pub(crate) struct Program(#[expect(dead_code, reason = "keeps the folder")] TempDir, PathBuf);

impl Program {
    /// Compiles a program of `firmware/host` with the core of the firmware. Undefined behaviour ends it.
    pub(crate) fn compile(main: &str, parts: &[&str]) -> Self {
        let core = ["core/frame.c", "core/message.c", "core/board.c"];
        let sources = parts.iter().chain(&core).map(|part| root("firmware").join(part).display().to_string());
        let options = ["-lm", "-fsanitize=undefined", "-fsanitize-undefined-trap-on-error"];
        let more: Vec<String> = sources.chain(options.map(Into::into)).collect();
        let more: Vec<&str> = more.iter().map(String::as_str).collect();
        let (place, program) = compile(main, &more);
        Self(place, program)
    }

    /// The board on a pseudo-terminal, compiled once for the tests that run at the same time.
    pub(crate) fn board() -> Arc<Self> {
        static ONCE: Mutex<Weak<Program>> = Mutex::new(Weak::new());
        let mut once = ONCE.lock().unwrap_or_else(PoisonError::into_inner);
        once.upgrade().unwrap_or_else(|| {
            let parts = ["core/serve.c", "host/options.c", "sensor/head.c", "sensor/sensor.c"];
            let program = Arc::new(Self::compile("firmware/host/board_host.c", &parts));
            *once = Arc::downgrade(&program);
            program
        })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.1
    }
}

/// What was true in a scan.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Truth {
    /// tx, ty, tz (m), roll, pitch, yaw (rad).
    pub(crate) pose: [f64; 6],
    /// Time of the scan by the system clock, nanoseconds of UTC since 1970.
    pub(crate) time_ns: i64,
    /// How much later the program sampled and sent it, because it had no processor, nanoseconds.
    pub(crate) late_ns: i64,
    /// Codes of the steering outputs.
    pub(crate) outputs: [i64; 2],
    /// The lease of the last command has expired.
    pub(crate) expired: bool,
}

/// A running board. It ends when its standard input is closed, at the latest with this object.
pub(crate) struct Board {
    _child: Killed,
    home: Folder,
    lines: mpsc::Receiver<String>,
    /// By sequence number; a number may be missing.
    truth: Vec<Option<Truth>>,
}

impl Board {
    /// Starts the board with these arguments (`KEY=VALUE ...`).
    pub(crate) fn start(program: &Program, arguments: &str) -> Self {
        let home = Folder::new();
        let mut child = Command::new(program.path())
            .arg(home.path("board"))
            .args(arguments.split_whitespace())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let out = child.stdout.take().unwrap();
        let (sender, lines) = mpsc::channel();
        std::thread::spawn(move || {
            BufReader::new(out).lines().map_while(Result::ok).try_for_each(|line| sender.send(line))
        });
        assert_eq!(lines.recv_timeout(PATIENCE).as_deref(), Ok("ready"), "{arguments}");
        Self { _child: Killed(child), home, lines, truth: Vec::new() }
    }

    /// Its port.
    pub(crate) fn port(&self) -> PathBuf {
        self.home.path("board")
    }

    /// A daemon with this board. `config` does not contain `[acquisition]`.
    pub(crate) fn daemon(&self, config: &str) -> Daemon {
        // On a busy machine, the kernel moves the bytes of a pseudo-terminal late: this must not end the daemon.
        Daemon::on_port(&self.home.path("board"), &format!("realtime.stall_ms = 60000\n{config}"))
    }

    /// The truth of the sample in a frame.
    pub(crate) fn truth(&mut self, frame: &Frame) -> Truth {
        let place = frame.sample_index as usize;
        while self.truth.len() <= place {
            self.next();
        }
        self.truth[place].unwrap_or_else(|| panic!("the board has not taken scan {place}: {frame:?}"))
    }

    /// The next scan that the board takes.
    pub(crate) fn next(&mut self) -> Truth {
        let line = self.lines.recv_timeout(PATIENCE).expect("the board prints every scan");
        let mut words = line.split(' ');
        let place: usize = words.next().unwrap().parse().unwrap();
        assert!(place >= self.truth.len(), "the daemon has started the board again: {line}");
        let pose = std::array::from_fn(|_| words.next().unwrap().parse().unwrap());
        let mut number = || words.next().unwrap().parse::<i64>().unwrap();
        let (time_ns, late_ns) = (number(), number());
        let truth = Truth { pose, time_ns, late_ns, outputs: [number(), number()], expired: number() == 1 };
        self.truth.resize(place, None);
        self.truth.push(Some(truth));
        truth
    }

    /// How late the program was at most in the scans so far, nanoseconds. On a busy machine the daemon cannot know
    /// the time of a scan better than this.
    pub(crate) fn latest_ns(&self) -> i64 {
        self.truth.iter().flatten().map(|truth| truth.late_ns).max().unwrap_or(0)
    }
}
