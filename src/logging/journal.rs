//! Log lines for the journal, with their fields (`journalctl -u trifacet TASK=centering`).
//!
//! Written here and not by a crate: the one that there is sends from the thread that logs, which may wait for
//! the journal, and drops what it cannot send. Here a thread of its own sends, and what the journal does not
//! take goes to standard error.

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

/// Where the journal listens for entries with fields.
pub(super) const SOCKET: &str = "/run/systemd/journal/socket";

/// Whether standard error leads to the journal, as systemd says (`JOURNAL_STREAM`, device and inode).
pub(super) fn is_standard_error() -> bool {
    let Ok(stream) = std::env::var("JOURNAL_STREAM") else { return false };
    fstat(io::stderr()).is_ok_and(|file| stream == format!("{}:{}", file.st_dev, file.st_ino))
}

/// Makes an entry of each event.
pub(super) struct Entries(pub NonBlocking);

impl<S: Subscriber> Layer<S> for Entries {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        // The queue drops what it has no room for, and never fails.
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
    /// A way to the journal at this socket. What it does not take is written to `otherwise`, as a line with
    /// its priority in front.
    pub fn connect(path: &Path, otherwise: E) -> io::Result<Self> {
        let socket = UnixDatagram::unbound()?;
        socket.connect(path)?;
        Ok(Self { socket, path: path.to_owned(), otherwise })
    }
}

impl<E: Write> Write for Journal<E> {
    fn write(&mut self, entry: &[u8]) -> io::Result<usize> {
        if self.socket.send(entry).is_err() {
            // It may have been started anew since.
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

/// An entry as bytes: priority and message first, so that [`plain`] finds them.
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

/// A field in the form that allows any value.
fn put(bytes: &mut Vec<u8>, name: &str, value: &str) {
    bytes.extend(name.as_bytes());
    bytes.push(b'\n');
    bytes.extend((value.len() as u64).to_le_bytes());
    bytes.extend(value.as_bytes());
    bytes.push(b'\n');
}

/// Priority and message of an entry as a line, as systemd reads it from standard error.
fn plain(entry: &[u8]) -> Vec<u8> {
    let rest = entry.get(HEAD.len()..).unwrap_or_default();
    let (length, rest) = rest.split_first_chunk::<8>().unwrap_or((&[0; 8], &[]));
    let message = rest.get(..u64::from_le_bytes(*length) as usize).unwrap_or(rest);
    let priority = entry.get(9).copied().unwrap_or(b'6');
    let lines = message.split(|b| *b == b'\n');
    lines.flat_map(|line| [b"<", &[priority][..], b">", line, b"\n"].concat()).collect()
}

/// The fields of an event: each by its name in capitals, and all of them in a line for people.
#[derive(Default)]
struct Fields {
    line: String,
    named: Vec<(String, String)>,
}

impl Fields {
    fn push(&mut self, field: &Field, value: String, quoted: bool) {
        if field.name() == "message" {
            self.line.insert_str(0, &value); // it is told first, wherever it stands
            return;
        }
        let quote = if quoted { "\"" } else { "" };
        // A String takes everything.
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

/// What the journal allows as the name of a field.
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

    /// What an event becomes.
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
    fn an_entry_has_a_line_for_people_and_fields_for_machines() {
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
    fn what_the_journal_does_not_take_goes_to_standard_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("socket");
        let journal = UnixDatagram::bind(&path).unwrap();
        let mut errors = Vec::new();
        let mut writer = Journal::connect(&path, &mut errors).unwrap();
        let bytes = entry_of(|| tracing::info!(n = 7, "hello"));
        writer.write_all(&bytes).unwrap();
        let mut heard = [0; 1000];
        let n = journal.recv(&mut heard).unwrap();
        assert_eq!(heard[..n], bytes);
        drop(journal);
        writer.write_all(&bytes).unwrap();
        assert_eq!(errors, b"<6>hello n=7\n");
    }
}
