//! Splits a file into chunks. Every length is checked against the size of the file before it is used.

use std::fs::{File, FileType};
use std::io;
use std::os::unix::fs::{FileExt, FileTypeExt};
use std::path::{Path, PathBuf};

use super::bytes::Bytes;
use super::chunk::{Chunk, Header, MOST};
use super::damage::{Damage, ReadError};

/// Signature at the start and at the end of a file.
const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";
/// Opcode and length in front of each record, bytes.
const PREFIX: u64 = 9;
/// Largest record other than a chunk that is read, bytes; larger than any index of a chunk.
const SMALL: u64 = 8 << 20;
/// Bytes searched at once for the next chunk.
const WINDOW: u64 = 1 << 20;

mod op {
    pub const HEADER: u8 = 1;
    pub const FOOTER: u8 = 2;
    pub const SCHEMA: u8 = 3;
    pub const CHANNEL: u8 = 4;
    pub const CHUNK: u8 = 6;
    pub const MESSAGE_INDEX: u8 = 7;
    pub const CHUNK_INDEX: u8 = 8;
    pub const STATISTICS: u8 = 0x0b;
    pub const METADATA: u8 = 0x0c;
    pub const METADATA_INDEX: u8 = 0x0d;
    pub const SUMMARY_OFFSET: u8 = 0x0e;
    pub const DATA_END: u8 = 0x0f;
}

/// A part of a file.
#[derive(Debug)]
pub enum Part {
    /// Messages, with the definitions in the same chunk.
    Chunk(Chunk),
    /// A part that cannot be read.
    Damage(Damage),
}

/// The parts of a file, in order.
#[derive(Debug)]
pub struct Parts {
    file: File,
    path: PathBuf,
    size: u64,
    at: u64,
    chunks: u64,
    ended: bool,
    /// The file was closed properly.
    pub finished: bool,
    /// The end of the data was reached. What follows is the index.
    pub indexed: bool,
    /// Bytes of an incomplete record at the end: the file was not closed.
    pub torn: u64,
}

impl Parts {
    /// Opens a file.
    ///
    /// # Errors
    /// The file cannot be read, or is not an MCAP file.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let io = |why| ReadError::Io { path: path.to_owned(), why };
        // Checked before opening: opening a pipe waits for a writer.
        let about = std::fs::metadata(path).map_err(io)?;
        if let Some(what) = no_file(about.file_type()) {
            return Err(ReadError::NoFile { path: path.to_owned(), what });
        }
        let file = File::open(path).map_err(io)?;
        let mut parts = Self {
            file,
            path: path.to_owned(),
            size: about.len(),
            at: 0,
            chunks: 0,
            ended: false,
            finished: false,
            indexed: false,
            torn: 0,
        };
        if parts.size == 0 {
            return Err(ReadError::Empty(path.to_owned()));
        } else if parts.magic(0).map_err(io)? {
            parts.at = MAGIC.len() as u64;
        } else if parts.chunk_after(0).map_err(io)?.is_none() {
            return Err(ReadError::NotMcap(path.to_owned()));
        }
        Ok(parts)
    }

    /// Size of the file, bytes.
    pub fn size(&self) -> u64 {
        self.size
    }

    /// Position in the file, bytes.
    pub fn at(&self) -> u64 {
        self.at
    }

    /// The next part; `None` at the end.
    ///
    /// # Errors
    /// The system reports an error.
    pub fn take(&mut self) -> Result<Option<Part>, ReadError> {
        self.part().map_err(|why| ReadError::Io { path: self.path.clone(), why })
    }

    fn part(&mut self) -> io::Result<Option<Part>> {
        while !self.ended {
            if let Some(part) = self.record()? {
                return Ok(Some(part));
            }
        }
        Ok(None)
    }

    fn magic(&self, at: u64) -> io::Result<bool> {
        Ok(self.size >= at + 8 && self.read(at, 8)? == MAGIC)
    }

    fn read(&self, at: u64, length: u64) -> io::Result<Vec<u8>> {
        let mut bytes = vec![0; usize::try_from(length).map_err(io::Error::other)?];
        self.file.read_exact_at(&mut bytes, at)?;
        Ok(bytes)
    }

    /// Reads the next record. `None`: the record contains nothing to report.
    fn record(&mut self) -> io::Result<Option<Part>> {
        if self.at == 0 {
            return self.lost("the file does not begin with the MCAP signature");
        }
        if self.size - self.at < PREFIX {
            return self.lost("an incomplete record");
        }
        let prefix = self.read(self.at, PREFIX)?;
        let (opcode, length) = (prefix[0], Bytes(&prefix[1..]).u64().unwrap_or(u64::MAX));
        if length > self.size - self.at - PREFIX {
            return self.lost("a record that is longer than the file");
        }
        match opcode {
            op::CHUNK => self.chunk(length),
            _ if length > SMALL => self.lost("a record that is too long"),
            _ => {
                let body = self.read(self.at + PREFIX, length)?;
                self.small(opcode, &body)
            }
        }
    }

    fn chunk(&mut self, length: u64) -> io::Result<Option<Part>> {
        let Some(header) = self.header(self.at)? else {
            return self.lost("the header of a chunk is inconsistent");
        };
        let (at, body) = (self.at, self.at + PREFIX + header.size());
        self.at += PREFIX + length;
        self.chunks += 1;
        let compressed = self.read(body, header.compressed)?;
        Ok(Some(match Chunk::unpack(&header, compressed) {
            Ok(chunk) => Part::Chunk(chunk),
            Err(error) => Part::Damage(Damage { at, bytes: PREFIX + length, what: error.to_string() }),
        }))
    }

    /// The header of the chunk at this position, if there is a plausible one.
    fn header(&self, at: u64) -> io::Result<Option<Header>> {
        let room = self.size - at;
        let bytes = self.read(at, room.min(PREFIX + Header::LONGEST))?;
        let mut bytes = Bytes(&bytes);
        if bytes.u8() != Some(op::CHUNK) {
            return Ok(None);
        }
        let Some((length, header)) = bytes.u64().zip(Header::read(&mut bytes)) else { return Ok(None) };
        let fits = header.uncompressed <= MOST
            && header.size().checked_add(header.compressed) == Some(length)
            && length <= room - PREFIX;
        Ok(fits.then_some(header))
    }

    /// Handles a record between or after the chunks.
    fn small(&mut self, opcode: u8, body: &[u8]) -> io::Result<Option<Part>> {
        if !well_formed(opcode, body) {
            return self.lost("a malformed record");
        }
        let at = self.at;
        self.at += PREFIX + body.len() as u64;
        match opcode {
            op::DATA_END => self.indexed = true,
            op::STATISTICS => {
                let counted = Bytes(body.get(22..).unwrap_or_default()).u32();
                if counted.map(u64::from) != Some(self.chunks) {
                    let what = format!("{} chunks found, {} written", self.chunks, counted.unwrap_or(0));
                    return Ok(Some(Part::Damage(Damage { at, bytes: 0, what })));
                }
            }
            op::FOOTER => return self.end(),
            _ => {}
        }
        Ok(None)
    }

    /// Handles the end of the file, after the footer.
    fn end(&mut self) -> io::Result<Option<Part>> {
        let magic = MAGIC.len() as u64;
        let (at, closed) = (self.at, self.magic(self.at)?);
        let (left, behind) = (self.size - at, at + magic);
        (self.ended, self.finished, self.at) = (true, closed, self.size);
        if left > magic {
            let what = "extra bytes after the end of the recording".into();
            return Ok(Some(Part::Damage(Damage { at: behind, bytes: left - magic, what })));
        }
        self.torn = if closed { 0 } else { left };
        Ok(None)
    }

    /// Skips to the next plausible chunk, or to the end of an unfinished file.
    fn lost(&mut self, what: &str) -> io::Result<Option<Part>> {
        let at = self.at;
        let Some(next) = self.chunk_after(at)? else {
            (self.at, self.ended, self.torn) = (self.size, true, self.size - at);
            return Ok(None);
        };
        self.at = next;
        Ok(Some(Part::Damage(Damage { at, bytes: next - at, what: what.into() })))
    }

    /// Position of the next plausible chunk.
    fn chunk_after(&self, at: u64) -> io::Result<Option<u64>> {
        let mut start = at + 1;
        while start < self.size {
            let window = self.read(start, WINDOW.min(self.size - start))?;
            for (offset, _) in (start..).zip(&window).filter(|(_, byte)| **byte == op::CHUNK) {
                if self.header(offset)?.is_some() {
                    return Ok(Some(offset));
                }
            }
            start += window.len() as u64;
        }
        Ok(None)
    }
}

/// The kind of a path that is not a regular file.
fn no_file(kind: FileType) -> Option<&'static str> {
    match kind {
        kind if kind.is_file() => None,
        kind if kind.is_dir() => Some("a folder"),
        kind if kind.is_fifo() => Some("a pipe"),
        kind if kind.is_socket() => Some("a socket"),
        _ => Some("a device"),
    }
}

/// Whether a record has the format of its kind. These records have no checksum. Only the number of chunks is
/// taken from them.
fn well_formed(opcode: u8, body: &[u8]) -> bool {
    let mut rest = Bytes(body);
    let ends = |rest: &Bytes<'_>| rest.0.is_empty();
    let whole = match opcode {
        op::HEADER => rest.text().and_then(|_| rest.text()).is_some(),
        op::SCHEMA => {
            rest.u16().is_some() && rest.text().is_some() && rest.text().is_some() && rest.block().is_some()
        }
        op::CHANNEL => {
            rest.u32().is_some() && rest.text().is_some() && rest.text().is_some() && rest.block().is_some()
        }
        op::MESSAGE_INDEX => rest.u16().is_some() && rest.block().is_some_and(|b| b.len().is_multiple_of(16)),
        op::CHUNK_INDEX => {
            rest.skip(32) && rest.block().is_some() && rest.skip(8) && rest.text().is_some() && rest.skip(16)
        }
        op::STATISTICS => rest.skip(42) && rest.block().is_some(),
        op::METADATA => rest.text().is_some() && rest.block().is_some(),
        op::METADATA_INDEX => rest.skip(16) && rest.text().is_some(),
        op::SUMMARY_OFFSET => rest.skip(17),
        op::DATA_END => rest.skip(4),
        op::FOOTER => rest.skip(20),
        _ => false,
    };
    whole && ends(&rest)
}
