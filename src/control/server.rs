//! Server of the control socket: one line in, one line of JSON out.

use std::net::SocketAddr;
use std::os::unix::fs::DirBuilderExt as _;
use std::os::unix::net as blocking;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use std::{fs, io};

use rustix::fs::Mode;
use rustix::process::umask;
use serde_json::Value;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::unix::OwnedReadHalf;
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::Mutex;
use tokio::task::JoinSet;
use tokio::time::timeout;
use tracing::field::display;

use super::live::{error, obey};
use super::{Command, RunningConfig};
use crate::config::{ControlConfig, places};
use crate::exit::{self, Failure};
use crate::listening::{Accepting, clear_unix};

/// Longest line in bytes, including its end.
const LINE: u64 = 256;
/// Permissions of a folder that is created for the socket: access for its owner.
const FOLDER_MODE: u32 = 0o700;
/// Most clients at a time.
const CLIENTS: usize = 16;
/// A client that sends no line or accepts no answer for this time is disconnected.
const CLIENT_TIMEOUT: Duration = Duration::from_mins(1);

/// The socket. Dropping it removes its file.
#[derive(Debug)]
pub struct Socket {
    listener: UnixListener,
    path: PathBuf,
}

impl Socket {
    /// Opens the configured socket; `None` if the configuration has no socket. A socket file without a
    /// listener is replaced.
    ///
    /// Must be called before other threads create files: the umask of the process is changed for a moment.
    ///
    /// # Errors
    /// [`exit::IN_USE`] if another daemon listens there, [`exit::IO`] if it cannot be opened.
    pub fn open(config: &ControlConfig) -> Result<Option<Self>, Failure> {
        let Some(path) = config.socket.clone() else { return Ok(None) };
        if clear_unix(&path).is_err() {
            let why = format!(
                "the control socket {} is in use by another daemon: stop it, or set another control.socket",
                path.display()
            );
            return Err(Failure::new(exit::IN_USE, why));
        }
        if let Some(folder) = path.parent().filter(|_| places::is_own(&path)) {
            // If this fails, so does opening, with the path in its message.
            let _ = fs::DirBuilder::new().mode(FOLDER_MODE).create(folder);
        }
        let fail = |e: io::Error| {
            Failure::new(exit::IO, format!("cannot open the control socket {}: {e}", path.display()))
        };
        let before = umask(Mode::from_raw_mode(!config.mode & 0o777));
        let bound = blocking::UnixListener::bind(&path);
        umask(before);
        let listener = bound.and_then(|listener| {
            listener.set_nonblocking(true)?;
            UnixListener::from_std(listener)
        });
        let listener = listener.map_err(fail)?;
        tracing::info!(socket = %path.display(), mode = format!("{:04o}", config.mode), "control socket is open");
        Ok(Some(Self { listener, path }))
    }

    /// Serves clients without end. Clients are served concurrently, their commands one after the other.
    pub async fn serve(self, live: Arc<Mutex<RunningConfig>>) {
        let mut clients = JoinSet::new();
        let mut accepting = Accepting::new("a client of the control socket");
        loop {
            let Some((stream, _)) = accepting.taken(self.listener.accept().await).await else { continue };
            while clients.try_join_next().is_some() {}
            if clients.len() < CLIENTS {
                clients.spawn(client(stream, Arc::clone(&live)));
            } else {
                tracing::warn!("control: refused a client: {CLIENTS} are already connected");
            }
        }
    }
}

impl Drop for Socket {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.path); // if this fails, the next daemon replaces it
    }
}

async fn client(stream: UnixStream, live: Arc<Mutex<RunningConfig>>) {
    let uid = stream.peer_cred().map(|peer| peer.uid()).ok();
    let (read, mut write) = stream.into_split();
    let mut lines = BufReader::new(read);
    loop {
        let line = match timeout(CLIENT_TIMEOUT, next_line(&mut lines)).await {
            Ok(Ok(Some(line))) => line,
            Ok(Ok(None)) | Err(_) => return,
            Ok(Err(why)) => {
                let refusal = error(&Failure::new(exit::USAGE, why.to_string()));
                let _ = timeout(CLIENT_TIMEOUT, write.write_all(&encode(refusal))).await;
                return;
            }
        };
        let answer = match line.parse::<Command>() {
            Ok(command) => {
                let answer = obey(&live, command).await;
                note(&command, Sender::User(uid), &answer);
                answer
            }
            Err(refusal) => error(&Failure::new(exit::USAGE, refusal.to_string())),
        };
        match timeout(CLIENT_TIMEOUT, write.write_all(&encode(answer))).await {
            Ok(Ok(())) => {}
            _ => return,
        }
    }
}

/// The next complete line; `None` at the end. An incomplete line is ignored: half a number is another number.
async fn next_line(lines: &mut BufReader<OwnedReadHalf>) -> io::Result<Option<String>> {
    let mut line = Vec::new();
    lines.take(LINE).read_until(b'\n', &mut line).await?;
    if line.last() == Some(&b'\n') {
        return Ok(Some(String::from_utf8_lossy(&line).into_owned()));
    }
    let whole = line.len() as u64 == LINE;
    let too_long = || io::Error::other(format!("a line has at most {LINE} bytes, its end included"));
    if whole { Err(too_long()) } else { Ok(None) }
}

/// The sender of a command.
#[derive(Clone, Copy, Debug)]
pub enum Sender {
    /// A user of this machine, through the socket; `None` if the system does not provide the id.
    User(Option<u32>),
    /// A program at this address, through the live page.
    Page(SocketAddr),
    /// SIGHUP.
    Signal,
}

/// Logs a command with its sender and its result, except for `status`.
pub fn note(command: &Command, sender: Sender, answer: &Value) {
    if *command == Command::Status {
        return;
    }
    let (uid, peer) = match sender {
        Sender::User(uid) => (uid, None),
        Sender::Page(peer) => (None, Some(display(peer))),
        Sender::Signal => (None, None),
    };
    match answer["error"].as_str() {
        None => tracing::info!(%command, uid, peer, %answer, "control"),
        Some(error) => tracing::warn!(%command, uid, peer, "control: {error}"),
    }
}

fn encode(mut answer: Value) -> Vec<u8> {
    answer["ok"] = answer["error"].is_null().into();
    let mut line = answer.to_string().into_bytes();
    line.push(b'\n');
    line
}
