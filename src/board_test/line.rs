//! The port of the board under test: frames in, bytes out.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::time::Duration;

use trifacet_core::time::{Clock, Mono};
use trifacet_wire::board::{Answer, BoardIdentity, Corrupted, Deframer, Request};

use super::bench::ANSWER;
use crate::board_link::{self, Link, LinkError};
use crate::clock::SystemClock;
use crate::config::BoardPlace;
use crate::serial_port::Identity;

/// Shortest wait for bytes, nanoseconds.
const SHORTEST_NS: i64 = 1_000_000;

/// The end of a wait that begins now.
pub(super) fn within(wait: Duration) -> Mono {
    SystemClock.now() + wait.as_nanos() as i64
}

/// Why a test cannot be carried out.
#[derive(Debug, thiserror::Error)]
pub enum TestError {
    /// The link cannot be opened.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The board serves another host.
    #[error("{port} is in use by {host}")]
    Busy {
        /// The address or the socket.
        port: String,
        /// The other host, as the board names it.
        host: String,
    },
    /// The link fails.
    #[error("{port}: {error}")]
    Io {
        /// The port, the address or the socket.
        port: String,
        /// The error of the system.
        error: io::Error,
    },
    /// No board answers.
    #[error("no board answers on {place}: IDENTIFY was sent five times; {heard}")]
    NoBoard {
        /// The port with its baud rate, the address or the socket.
        place: String,
        /// What came instead.
        heard: String,
    },
    /// The amplitude is outside the range of the outputs.
    #[error(
        "--move {amplitude} is outside the range of the outputs of the board, which have {bits} bits: 1 to {most}"
    )]
    Amplitude {
        /// As requested.
        amplitude: i32,
        /// Resolution of the outputs.
        bits: u8,
        /// Largest amplitude.
        most: i32,
    },
}

/// How to test.
#[derive(Clone, Debug)]
pub struct Options {
    /// Where the board is.
    pub place: BoardPlace,
    /// Rate of the scans, scans per 1000 seconds; `None`: 1 kHz, or the nearest that board and line allow.
    pub rate_mhz: Option<u32>,
    /// Positions up to this code are commanded; `None`: the stage is not moved.
    pub amplitude: Option<i32>,
}

/// A frame from the board.
#[derive(Clone, Debug)]
pub struct Received {
    /// When it was read.
    pub at: Mono,
    /// The message without its checksum.
    pub message: Result<Vec<u8>, Corrupted>,
}

impl Received {
    /// The answer in the frame, if it is one.
    pub fn answer(&self) -> Option<Answer> {
        Answer::decode(self.message.as_ref().ok()?).ok()
    }

    /// The scan in the frame, if it is one.
    pub fn is_scan(&self) -> bool {
        matches!(self.answer(), Some(Answer::Scan(_)))
    }

    /// The frame, as a verdict names it.
    pub fn text(&self) -> String {
        match (&self.message, self.answer()) {
            (_, Some(answer)) => format!("{answer:?}"),
            (Ok(message), None) => format!("a message that is not in the protocol: {message:02x?}"),
            (Err(Corrupted), _) => "a damaged frame".into(),
        }
    }
}

/// The open link.
pub(super) struct Line {
    name: String,
    link: Link,
    deframer: Deframer,
    inbox: VecDeque<Received>,
}

impl Line {
    /// Opens the link, and terminates an incomplete frame in the board's buffer.
    ///
    /// # Errors
    /// The link cannot be opened.
    pub(super) fn open(options: &Options) -> Result<Self, TestError> {
        let link = board_link::open(&options.place, &mut Identity::default())?;
        let name = options.place.to_string();
        let mut line = Self { name, link, deframer: Deframer::default(), inbox: VecDeque::new() };
        line.send(&[0])?;
        Ok(line)
    }

    /// Forgets what has been read.
    pub(super) fn clear(&mut self) {
        self.inbox.clear();
    }

    /// The identity of the board, of version 1.0.
    ///
    /// # Errors
    /// No board answers, or the port fails.
    pub(super) fn first_identity(&mut self, place: &BoardPlace) -> Result<BoardIdentity, TestError> {
        let mut others = 0;
        for _ in 0..5 {
            self.request(Request::Identify { minor: 0 })?;
            let until = within(ANSWER);
            while let Some(received) = self.next(until)? {
                match received.answer() {
                    Some(Answer::Identity(identity)) => return Ok(identity),
                    Some(Answer::Scan(_)) => {}
                    Some(Answer::Busy { host }) => {
                        let host = host.escape_debug().to_string();
                        return Err(TestError::Busy { port: self.name.clone(), host });
                    }
                    _ => others += 1,
                }
            }
        }
        let place = match place.baud() {
            Some(baud) => format!("{place} at {baud} baud"),
            None => place.to_string(),
        };
        let heard = if others > 0 { format!("{others} other frames came") } else { "nothing came".into() };
        Err(TestError::NoBoard { place, heard })
    }

    fn failed(&self, error: io::Error) -> TestError {
        TestError::Io { port: self.name.clone(), error }
    }

    /// Sends bytes.
    ///
    /// # Errors
    /// The port fails.
    pub(super) fn send(&mut self, bytes: &[u8]) -> Result<(), TestError> {
        self.link
            .set_timeout(ANSWER)
            .and_then(|()| self.link.write_all(bytes))
            .map_err(|error| self.failed(error))
    }

    /// Sends a request.
    ///
    /// # Errors
    /// The port fails.
    pub(super) fn request(&mut self, request: Request) -> Result<(), TestError> {
        let mut frame = Vec::new();
        request.encode(&mut frame);
        self.send(&frame)
    }

    /// The next frame, if one comes in time.
    ///
    /// # Errors
    /// The port fails.
    pub(super) fn next(&mut self, until: Mono) -> Result<Option<Received>, TestError> {
        loop {
            if let Some(received) = self.inbox.pop_front() {
                return Ok(Some(received));
            }
            // What has arrived is read also if it is too late: then the host was busy.
            let left_ns = until - SystemClock.now();
            let wait = Duration::from_nanos(left_ns.max(SHORTEST_NS) as u64);
            if !self.read(wait)? && left_ns <= 0 {
                return Ok(None);
            }
        }
    }

    /// Reads once; false if nothing comes.
    fn read(&mut self, wait: Duration) -> Result<bool, TestError> {
        let mut buffer = [0; 4096];
        let read = self.link.set_timeout(wait).and_then(|()| self.link.read(&mut buffer));
        let mut bytes = match read {
            Ok(read) => &buffer[..read],
            // A serial port times out, a socket would block.
            Err(error)
                if matches!(
                    error.kind(),
                    ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted
                ) =>
            {
                return Ok(false);
            }
            Err(error) => return Err(self.failed(error)),
        };
        let at = SystemClock.now();
        while let Some(message) = self.deframer.next(&mut bytes) {
            self.inbox.push_back(Received { at, message: message.map(<[u8]>::to_vec) });
        }
        Ok(true)
    }
}
