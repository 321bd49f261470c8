//! Client of the control socket, for `trifacet ctl`.

use std::io::{self, BufRead, BufReader, ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Duration;

use rustix::net::sockopt::{Timeout, set_socket_timeout, socket_peercred};
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType, connect, socket_with};
use serde_json::Value;

use super::Command;
use crate::exit::{self, Failure};

/// Time without an answer after which the daemon is checked. A daemon that works answers to the check, however
/// long the command takes.
const CHECK_AFTER: Duration = Duration::from_secs(3);

/// Sends a command to a daemon and returns its answer.
///
/// # Errors
/// [`exit::UNAVAILABLE`] if no daemon listens, the daemon is stopped or stuck, or the answer is invalid;
/// [`exit::IO`] if the socket cannot be opened. A refusal by the daemon is an answer, not an error.
pub fn ask(socket: &Path, command: &Command) -> Result<Value, Failure> {
    let at = socket.display();
    let stream = open(socket).map_err(|e| match e.kind() {
        ErrorKind::NotFound | ErrorKind::ConnectionRefused => {
            let hint = "is it running, and does [control] socket in its configuration name this path?";
            Failure::new(exit::UNAVAILABLE, format!("no daemon listens on {at}; {hint}"))
        }
        // The queue of a daemon that accepts nobody is full.
        ErrorKind::WouldBlock => stuck(socket, None),
        _ => Failure::new(exit::IO, format!("cannot connect to {at}: {e}")),
    })?;
    let broke = |e: io::Error| match e.kind() {
        ErrorKind::WouldBlock => stuck(socket, Some(&stream)),
        _ => Failure::new(exit::UNAVAILABLE, format!("the daemon at {at} closed without an answer: {e}")),
    };
    (&stream).write_all(format!("{command}\n").as_bytes()).map_err(broke)?;
    let mut line = Vec::new();
    let mut answer = BufReader::new(&stream);
    // An incomplete line is kept when the time limit is reached.
    while let Err(e) = answer.read_until(b'\n', &mut line) {
        if e.kind() != ErrorKind::WouldBlock || !works(socket) {
            return Err(broke(e));
        }
    }
    if line.is_empty() {
        return Err(Failure::new(exit::UNAVAILABLE, format!("the daemon at {at} closed without an answer")));
    }
    serde_json::from_slice(&line).map_err(|e| {
        Failure::new(exit::UNAVAILABLE, format!("what listens on {at} is not a trifacet daemon: {e}"))
    })
}

/// Connects. Connecting, reading and writing end with [`ErrorKind::WouldBlock`] after [`CHECK_AFTER`].
fn open(path: &Path) -> io::Result<UnixStream> {
    let socket = socket_with(AddressFamily::UNIX, SocketType::STREAM, SocketFlags::CLOEXEC, None)?;
    for direction in [Timeout::Send, Timeout::Recv] {
        set_socket_timeout(&socket, direction, Some(CHECK_AFTER))?;
    }
    connect(&socket, &SocketAddrUnix::new(path)?)?;
    Ok(socket.into())
}

/// Whether the daemon works: it answers to an empty line at once, even while it executes a command, or closes
/// the connection because it has too many clients.
fn works(socket: &Path) -> bool {
    let answer = open(socket).and_then(|mut stream| {
        stream.write_all(b"\n")?;
        stream.read(&mut [0])
    });
    answer.is_ok()
}

/// The failure of a daemon that does not answer, with the state of its process if the system provides it.
fn stuck(socket: &Path, stream: Option<&UnixStream>) -> Failure {
    let pid = stream.and_then(|stream| socket_peercred(stream).ok()).map(|peer| peer.pid);
    let state = pid.and_then(|pid| {
        let status = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
        let state = status.lines().find_map(|line| line.strip_prefix("State:"))?.trim().to_owned();
        Some((pid, state))
    });
    let at = socket.display();
    let why = match state {
        Some((pid, state)) if state.starts_with(['T', 't']) => {
            format!("process {pid} is stopped, by a signal or a debugger; `kill -CONT {pid}` continues it")
        }
        Some((pid, state)) => format!("process {pid} is stuck or far too busy (state {state}); see its log"),
        None => "it is stopped, stuck or far too busy".into(),
    };
    Failure::new(exit::UNAVAILABLE, format!("the daemon at {at} does not answer: {why}"))
}
