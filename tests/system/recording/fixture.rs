//! A daemon that records, and the contents of its files.

use std::net::UdpSocket;
use std::ops::{Deref, DerefMut};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex};

use mcap::MessageStream;
use mcap::read::Options;
use rustix::process::Signal;
use trifacet::client::PoseFrame;
use trifacet::recording::codec::{Decoder, read};
use trifacet::recording::message::Gap;
use trifacet::recording::{Entry, Topic};

use crate::testkit::{Daemon, Folder, PATIENCE, now_ns};

/// The frames that a daemon has sent, with a notification of new ones.
type Heard = Arc<(Mutex<Vec<PoseFrame>>, Condvar)>;

/// A running daemon with all frames that it sends.
pub(crate) struct Recorder {
    daemon: Daemon,
    heard: Heard,
}

impl Deref for Recorder {
    type Target = Daemon;

    fn deref(&self) -> &Daemon {
        &self.daemon
    }
}

impl DerefMut for Recorder {
    fn deref_mut(&mut self) -> &mut Daemon {
        &mut self.daemon
    }
}

impl Recorder {
    /// Starts a daemon with these dotted keys.
    pub(crate) fn start(config: &str) -> Self {
        Self::start_in(&Folder::new(), config, &[])
    }

    /// The same in a folder, started through another program.
    pub(crate) fn start_in(home: &Folder, config: &str, through: &[&str]) -> Self {
        let udp = UdpSocket::bind("127.0.0.1:0").unwrap();
        rustix::net::sockopt::set_socket_recv_buffer_size(&udp, 1 << 20).unwrap();
        let folder = if config.contains("recording.folder") {
            ""
        } else {
            "recording.folder = \"recordings\"
"
        };
        let to = udp.local_addr().unwrap();
        let text = format!(
            "publishing.tcp = \"off\"
publishing.udp = [\"{to}\"]
{folder}{config}
"
        );
        let daemon = Daemon::start_through(home, &text, through);
        let heard = Heard::default();
        let into = Arc::downgrade(&heard);
        std::thread::spawn(move || {
            let mut bytes = [0; 300];
            while let Ok(n) = udp.recv(&mut bytes) {
                let Some(into) = into.upgrade() else { break };
                into.0.lock().unwrap().push(PoseFrame::decode(&bytes[..n]).unwrap());
                into.1.notify_all();
            }
        });
        Self { daemon, heard }
    }

    /// All frames that have arrived so far.
    pub(crate) fn frames(&self) -> Vec<PoseFrame> {
        self.heard.0.lock().unwrap().clone()
    }

    /// Waits for a new frame that fulfils this condition.
    pub(crate) fn waits(&self, what: &str, is: impl Fn(&PoseFrame) -> bool) -> PoseFrame {
        let begin_ns = now_ns();
        let mut heard = self.heard.0.lock().unwrap();
        let mut from = heard.len();
        loop {
            if let Some(frame) = heard[from..].iter().find(|frame| is(frame)) {
                return *frame;
            }
            from = heard.len();
            assert!(now_ns() - begin_ns < PATIENCE.as_nanos() as i64, "no frame {what}");
            heard = self.heard.1.wait_timeout(heard, PATIENCE).unwrap().0;
        }
    }

    /// Waits until the time stamps of the stream have advanced by this many seconds.
    pub(crate) fn runs_for(&self, seconds: f64) {
        let start = self.waits("at all", |_| true).time_ns;
        self.waits("later", |frame| (frame.time_ns - start) as f64 > seconds * 1e9);
    }

    /// The folder of the recordings.
    pub(crate) fn folder(&self) -> PathBuf {
        self.home.path("recordings")
    }

    /// Shuts the daemon down and returns all frames that it has sent.
    pub(crate) fn stop(&mut self) -> Vec<PoseFrame> {
        self.ends_in_order(Signal::TERM);
        self.frames()
    }
}

/// The recordings in a folder, sorted from the oldest to the newest.
pub(crate) fn recordings(folder: &Path) -> Vec<PathBuf> {
    let mut all: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|file| file.unwrap().path()).collect();
    all.sort();
    all
}

/// The contents of a file: its readable entries and its gaps.
#[derive(Default)]
pub(crate) struct Content {
    pub(crate) entries: Vec<Entry>,
    pub(crate) gaps: u64,
    /// Number of missing entries according to the gaps.
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

/// Checks that the file contains every frame of the stream between its first and its last one, bit by bit.
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
