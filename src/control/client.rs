//! Client of the control socket, for `trifacet ctl`.

use std::io::{self, BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Duration;

use serde_json::Value;

use super::Command;
use crate::exit::{self, Failure};

/// Time limit for an answer, longer than any command takes.
const ANSWER_TIMEOUT: Duration = Duration::from_mins(1);

/// Sends a command to a daemon and returns its answer.
///
/// # Errors
/// [`exit::UNAVAILABLE`] if no daemon listens or the answer is missing or invalid, [`exit::IO`] if the socket
/// cannot be opened. A refusal by the daemon is an answer, not an error.
pub fn ask(socket: &Path, command: &Command) -> Result<Value, Failure> {
    let at = socket.display();
    let stream = UnixStream::connect(socket).map_err(|e| {
        let absent = matches!(e.kind(), io::ErrorKind::NotFound | io::ErrorKind::ConnectionRefused);
        if absent {
            let hint = "is it running, and does [control] socket in its configuration name this path?";
            Failure::new(exit::UNAVAILABLE, format!("no daemon listens on {at}; {hint}"))
        } else {
            Failure::new(exit::IO, format!("cannot connect to {at}: {e}"))
        }
    })?;
    let broke =
        |e: io::Error| Failure::new(exit::UNAVAILABLE, format!("the daemon at {at} does not answer: {e}"));
    stream.set_read_timeout(Some(ANSWER_TIMEOUT)).map_err(broke)?;
    stream.set_write_timeout(Some(ANSWER_TIMEOUT)).map_err(broke)?;
    (&stream).write_all(format!("{command}\n").as_bytes()).map_err(broke)?;
    let mut line = String::new();
    BufReader::new(&stream).read_line(&mut line).map_err(broke)?;
    if line.is_empty() {
        return Err(Failure::new(exit::UNAVAILABLE, format!("the daemon at {at} closed without an answer")));
    }
    serde_json::from_str(&line).map_err(|e| {
        Failure::new(exit::UNAVAILABLE, format!("what listens on {at} is not a trifacet daemon: {e}"))
    })
}
