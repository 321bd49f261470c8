//! Log entries with fields for the journal (`journalctl -u trifacet TASK=centering`).
//!
//! The existing crate sends from the logging thread, which may have to wait for the journal, and drops what
//! it cannot send. Here a separate thread sends, and entries that the journal does not accept go to standard
//! error.

use std::fmt::{Debug, Write as _};
use std::io::{self, Write};
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};

use rustix::fs::fstat;
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_appender::non_blocking::NonBlocking;
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;

/// Socket of the journal for entries with fields.
pub(super) const SOCKET: &str = "/run/systemd/journal/socket";

/// Whether standard error is connected to the journal, according to systemd (`JOURNAL_STREAM`, device and
/// inode).
pub(super) fn is_standard_error() -> bool {
    let Ok(stream) = std::env::var("JOURNAL_STREAM") else { return false };
    fstat(io::stderr()).is_ok_and(|file| stream == format!("{}:{}", file.st_dev, file.st_ino))
}

/// Converts each event into an entry.
pub(super) struct Entries(pub NonBlocking);

impl<S: Subscriber> Layer<S> for Entries {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        // The queue drops entries when it is full, and never fails.
        let _ = self.0.clone().write_all(&entry(event));
    }
}

/// Sends entries; one write is one entry.
pub(super) struct Journal<E> {
    socket: UnixDatagram,
    path: PathBuf,
    otherwise: E,
}

impl<E: Write> Journal<E> {
    /// Connects to the journal at this socket. Entries that it does not accept are written to `otherwise`, as
    /// a line that starts with the priority.
    ///
    /// # Errors
    /// There is no such socket, or it refuses the connection.
    pub fn connect(path: &Path, otherwise: E) -> io::Result<Self> {
        let socket = UnixDatagram::unbound()?;
        socket.connect(path)?;
        Ok(Self { socket, path: path.to_owned(), otherwise })
    }
}

impl<E: Write> Write for Journal<E> {
    fn write(&mut self, entry: &[u8]) -> io::Result<usize> {
        if self.socket.send(entry).is_err() {
            // The journal may have been restarted.
            let again = self.socket.connect(&self.path).and_then(|()| self.socket.send(entry));
            if again.is_err() {
                self.otherwise.write_all(&plain(entry))?;
            }
        }
        Ok(entry.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The start of every entry, up to the length of its message.
const HEAD: &[u8] = b"PRIORITY=p\nMESSAGE\n";

/// Encodes an event: priority and message come first, so that [`plain`] finds them.
fn entry(event: &Event<'_>) -> Vec<u8> {
    let metadata = event.metadata();
    let mut fields = Fields::default();
    event.record(&mut fields);
    let mut bytes = HEAD.to_vec();
    bytes[9] = match *metadata.level() {
        Level::ERROR => b'3',
        Level::WARN => b'4',
        Level::INFO => b'6',
        _ => b'7',
    };
    bytes.extend((fields.line.len() as u64).to_le_bytes());
    bytes.extend(fields.line.as_bytes());
    bytes.push(b'\n');
    put(&mut bytes, "SYSLOG_IDENTIFIER", "trifacet");
    put(&mut bytes, "TARGET", metadata.target());
    if let (Some(file), Some(line)) = (metadata.file(), metadata.line()) {
        put(&mut bytes, "CODE_FILE", file);
        put(&mut bytes, "CODE_LINE", &line.to_string());
    }
    for (name, value) in fields.named {
        put(&mut bytes, &name, &value);
    }
    bytes
}

/// Appends a field in the form that allows any value.
fn put(bytes: &mut Vec<u8>, name: &str, value: &str) {
    bytes.extend(name.as_bytes());
    bytes.push(b'\n');
    bytes.extend((value.len() as u64).to_le_bytes());
    bytes.extend(value.as_bytes());
    bytes.push(b'\n');
}

/// Priority and message of an entry as a line, in the form that systemd reads from standard error.
fn plain(entry: &[u8]) -> Vec<u8> {
    let rest = entry.get(HEAD.len()..).unwrap_or_default();
    let (length, rest) = rest.split_first_chunk::<8>().unwrap_or((&[0; 8], &[]));
    let message = rest.get(..u64::from_le_bytes(*length) as usize).unwrap_or(rest);
    let priority = entry.get(9).copied().unwrap_or(b'6');
    let lines = message.split(|b| *b == b'\n');
    lines.flat_map(|line| [b"<", &[priority][..], b">", line, b"\n"].concat()).collect()
}

/// The fields of an event: each with its name in capitals, and all of them in a readable line.
#[derive(Default)]
struct Fields {
    line: String,
    named: Vec<(String, String)>,
}

impl Fields {
    fn push(&mut self, field: &Field, value: String, quoted: bool) {
        if field.name() == "message" {
            self.line.insert_str(0, &value); // the message comes first, wherever it is recorded
            return;
        }
        let quote = if quoted { "\"" } else { "" };
        // Writing to a String cannot fail.
        let _ = write!(self.line, " {}={quote}{value}{quote}", field.name());
        self.named.push((capitals(field.name()), value));
    }
}

impl Visit for Fields {
    fn record_str(&mut self, field: &Field, value: &str) {
        self.push(field, value.to_owned(), field.name() != "message");
    }

    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        self.push(field, format!("{value:?}"), false);
    }
}

/// The name of a field in the form that the journal allows.
fn capitals(name: &str) -> String {
    let fine = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_uppercase() } else { '_' };
    name.chars().map(fine).collect::<String>().trim_start_matches('_').to_owned()
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use tracing_subscriber::layer::SubscriberExt;
    use tracing_subscriber::util::SubscriberInitExt;

    use super::*;

    /// The entry of an event.
    fn entry_of(log: impl FnOnce()) -> Vec<u8> {
        #[derive(Clone, Default)]
        struct Last(Arc<Mutex<Vec<u8>>>);
        impl<S: Subscriber> Layer<S> for Last {
            fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
                *self.0.lock().unwrap() = entry(event);
            }
        }
        let last = Last::default();
        {
            let _here = tracing_subscriber::registry().with(last.clone()).set_default();
            log();
        }
        Arc::into_inner(last.0).unwrap().into_inner().unwrap()
    }

    /// The fields of an entry, read as the journal does.
    fn fields(mut bytes: &[u8]) -> Vec<(String, String)> {
        let mut fields = Vec::new();
        while !bytes.is_empty() {
            let end = bytes.iter().position(|b| *b == b'\n').unwrap();
            let (name, rest) = (String::from_utf8(bytes[..end].to_vec()).unwrap(), &bytes[end + 1..]);
            if let Some((name, value)) = name.split_once('=') {
                fields.push((name.into(), value.into()));
                bytes = rest;
                continue;
            }
            let (length, rest) = rest.split_first_chunk::<8>().unwrap();
            let (value, rest) = rest.split_at(u64::from_le_bytes(*length) as usize);
            fields.push((name, String::from_utf8(value.to_vec()).unwrap()));
            bytes = rest.strip_prefix(b"\n").unwrap();
        }
        fields
    }

    #[test]
    fn an_entry_has_a_readable_line_and_fields_for_programs() {
        let bytes = entry_of(|| tracing::warn!(task = "centering", age.s = 1.5, "it stalls\nfor \u{3bc}s"));
        let fields = fields(&bytes);
        let of = |name: &str| fields.iter().find(|(n, _)| n == name).map(|(_, value)| value.as_str());
        assert_eq!(of("PRIORITY"), Some("4"));
        assert_eq!(of("MESSAGE"), Some("it stalls\nfor \u{3bc}s task=\"centering\" age.s=1.5"));
        assert_eq!([of("TASK"), of("AGE_S")], [Some("centering"), Some("1.5")]);
        assert!(of("CODE_FILE").unwrap().ends_with("journal.rs") && of("CODE_LINE").is_some());
        assert_eq!(plain(&bytes), "<4>it stalls\n<4>for \u{3bc}s task=\"centering\" age.s=1.5\n".as_bytes());
    }

    #[test]
    fn entries_that_the_journal_rejects_go_to_standard_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("socket");
        let journal = UnixDatagram::bind(&path).unwrap();
        let mut errors = Vec::new();
        let mut writer = Journal::connect(&path, &mut errors).unwrap();
        let bytes = entry_of(|| tracing::info!(n = 7, "hello"));
        writer.write_all(&bytes).unwrap();
        let mut received = [0; 1000];
        let n = journal.recv(&mut received).unwrap();
        assert_eq!(received[..n], bytes);
        drop(journal);
        writer.write_all(&bytes).unwrap();
        assert_eq!(errors, b"<6>hello n=7\n");
    }
}
