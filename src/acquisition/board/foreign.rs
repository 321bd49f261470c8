//! Describes the bytes on a port at which no board answers: what may be connected there instead.

use std::fmt;

/// Bytes that are kept as an example.
const EXAMPLE: usize = 32;
/// Fewer bytes than these have no recognisable kind.
const FEW: u64 = 8;
/// From this number on, all counts are halved, so that the description follows what arrives now.
const MANY: u64 = 1 << 16;

/// What arrives where a board is missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Nothing,
    /// Frames of a board, but not the answer.
    Frames,
    /// The requests of the host.
    Echo,
    OneValue(u8),
    Text,
    Unknown,
}

/// A description of what arrives. Equal as long as the kind remains the same.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Foreign {
    kind: Kind,
    /// Number of bytes when this kind was first described.
    bytes: u64,
    example: Vec<u8>,
    baud: Option<u32>,
}

/// The bytes since the port was opened or the last undamaged frame arrived.
#[derive(Debug)]
pub(super) struct ForeignBytes {
    baud: Option<u32>,
    total: u64,
    /// Bytes that have not been counted yet.
    uncounted: u64,
    /// Number of bytes of each value.
    values: [u64; 256],
    example: Vec<u8>,
    frames: bool,
    echo: bool,
    described: Option<Foreign>,
}

impl ForeignBytes {
    pub(super) fn new(baud: Option<u32>) -> Self {
        Self {
            baud,
            total: 0,
            uncounted: 0,
            values: [0; 256],
            example: Vec::new(),
            frames: false,
            echo: false,
            described: None,
        }
    }

    /// The port was opened.
    pub(super) fn opened(&mut self) {
        *self = Self::new(self.baud);
    }

    /// Bytes have arrived, which may or may not contain frames.
    pub(super) fn bytes(&mut self, bytes: &[u8]) {
        if self.total >= MANY {
            self.values.iter_mut().for_each(|n| *n /= 2);
            self.total = self.values.iter().sum();
        }
        self.total += bytes.len() as u64;
        self.uncounted += bytes.len() as u64;
        for byte in bytes {
            self.values[usize::from(*byte)] += 1;
        }
        let room = EXAMPLE - self.example.len();
        self.example.extend(bytes.iter().take(room));
    }

    /// A frame of a board was among them: what came before it was no other device.
    pub(super) fn frame(&mut self) {
        if self.total > 0 || self.echo {
            self.opened();
        }
        self.frames = true;
    }

    /// A request was sent: frames of a board count only after it.
    pub(super) fn asked(&mut self) {
        self.frames = false;
    }

    /// A request of the host was among them.
    pub(super) fn echo(&mut self) {
        self.echo = true;
    }

    /// Number of bytes since the last call that no frame has followed.
    pub(super) fn count(&mut self) -> u64 {
        std::mem::take(&mut self.uncounted)
    }

    /// Describes what has arrived. The description stays the same while its kind does.
    pub(super) fn describe(&mut self) -> Foreign {
        let kind = self.kind();
        match &self.described {
            Some(described) if described.kind == kind => described.clone(),
            _ => {
                let example = self.example.clone();
                let now = Foreign { kind, bytes: self.total, example, baud: self.baud };
                self.described.insert(now).clone()
            }
        }
    }

    fn kind(&self) -> Kind {
        let count = |byte: u8| self.values[usize::from(byte)];
        // At least nine tenths of the bytes; a cable that is plugged in makes single wrong ones.
        let most = |n: u64| self.total >= FEW && n * 10 >= self.total * 9;
        let commonest = (0..=u8::MAX).max_by_key(|byte| count(*byte)).unwrap_or_default();
        let text = (0..=u8::MAX).filter(|byte| matches!(byte, b' '..=b'~' | b'\r' | b'\n' | b'\t'));
        if self.echo {
            Kind::Echo
        } else if self.frames && self.total == 0 {
            Kind::Frames
        } else if self.total == 0 {
            Kind::Nothing
        } else if most(count(commonest)) {
            Kind::OneValue(commonest)
        } else if most(text.map(count).sum()) {
            Kind::Text
        } else {
            Kind::Unknown
        }
    }
}

impl fmt::Display for Foreign {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { kind, bytes, example, baud } = self;
        match kind {
            Kind::Nothing => write!(f, "nothing arrives: is the board powered, and is this its port?"),
            Kind::Frames => {
                write!(f, "other frames of a board arrive: does it receive what the daemon sends?")
            }
            Kind::Echo => {
                let why =
                    baud.map_or("does a service echo them", |_| "are RX and TX connected to each other");
                write!(f, "the requests of the daemon come back: {why}?")
            }
            Kind::OneValue(value) => {
                let why =
                    baud.map_or("is this another service", |_| "is the line broken or its wiring wrong");
                write!(f, "only bytes 0x{value:02x} arrive ({bytes}): {why}?")
            }
            Kind::Text => write!(
                f,
                "text arrives{} instead of frames, for example \"{}\": is this the port of another {}?",
                baud.map_or(String::new(), |baud| format!(" at {baud} baud")),
                example.escape_ascii(),
                baud.map_or("service", |_| "device, or a console")
            ),
            Kind::Unknown => {
                write!(f, "{bytes} bytes arrive that are not frames of a board, for example")?;
                example.iter().take(12).try_for_each(|byte| write!(f, " {byte:02x}"))?;
                match baud {
                    Some(baud) => write!(f, ": another protocol, or another baud rate than {baud}?"),
                    None => write!(f, ": another protocol?"),
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(line: &[u8]) -> String {
        let mut bytes = ForeignBytes::new(Some(9600));
        bytes.bytes(line);
        bytes.describe().to_string()
    }

    #[test]
    fn each_kind_of_bytes_has_its_description() {
        let noise: Vec<u8> = (0..200_u32).map(|i| ((i * i * 7919) >> 3) as u8).collect();
        for (line, text) in [
            (&b""[..], "nothing arrives"),
            (&[0; 100], "only bytes 0x00 arrive (100)"),
            (&[0xff; 9], "only bytes 0xff arrive"),
            (b"login: \r\nPassword: ", "\"login: \\r\\nPassword: \""),
            (&noise, "200 bytes arrive that are not frames of a board, for example 00"),
            (&[0; 3], "3 bytes arrive that are not frames"),
        ] {
            assert!(told(line).contains(text), "{}", told(line));
        }
        // An escape sequence of a terminal does not reach the log.
        assert!(told(b"\x1b[31mred alert, all is lost\x07").contains("\\x1b[31mred"));
    }

    #[test]
    fn the_description_is_stable_and_follows_what_arrives_now() {
        let mut bytes = ForeignBytes::new(Some(9600));
        bytes.bytes(b"a banner of a boot loader\r\n");
        let first = bytes.describe();
        bytes.bytes(b"a second line of it\r\n");
        assert_eq!(bytes.describe(), first);
        (0..100).for_each(|_| bytes.bytes(&[0; 4096]));
        assert!(bytes.describe().to_string().contains("only bytes 0x00"));
        bytes.frame();
        assert!(bytes.describe().to_string().contains("other frames"));
        bytes.echo();
        bytes.asked();
        assert!(bytes.describe().to_string().contains("RX and TX"));
        bytes.frame();
        bytes.asked();
        assert!(bytes.describe().to_string().contains("nothing"));
    }
}
