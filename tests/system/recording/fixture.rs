//! A daemon that records, and what is in its files.

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

/// What a daemon has sent, with a bell for news.
type Heard = Arc<(Mutex<Vec<PoseFrame>>, Condvar)>;

/// A running daemon with everything that it sends.
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
    /// Starts one with these dotted keys.
    pub(crate) fn start(config: &str) -> Self {
        Self::start_in(&Folder::new(), config, &[])
    }

    /// The same in a folder, by way of another program.
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

    /// Everything that was sent so far and arrived.
    pub(crate) fn frames(&self) -> Vec<PoseFrame> {
        self.heard.0.lock().unwrap().clone()
    }

    /// Waits for a frame from now on of which this is true.
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

    /// Waits until the stream has gone on for so many seconds of its own time.
    pub(crate) fn runs_for(&self, seconds: f64) {
        let start = self.waits("at all", |_| true).time_ns;
        self.waits("later", |frame| (frame.time_ns - start) as f64 > seconds * 1e9);
    }

    /// Where its recordings are.
    pub(crate) fn folder(&self) -> PathBuf {
        self.home.path("recordings")
    }

    /// Ends it in order; gives every frame that it has sent.
    pub(crate) fn stop(&mut self) -> Vec<PoseFrame> {
        self.ends_in_order(Signal::TERM);
        self.frames()
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
