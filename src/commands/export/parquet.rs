//! As Parquet: one row group after the other, plain columns without nulls, pages compressed with Zstandard.
//!
//! This is all of the format that a table of numbers and words needs. The crate `parquet` would add minutes to
//! every build of the daemon for it.

use std::io::{self, Write};

use trifacet::publishing::columns::Value;

use super::{Row, Table};

/// Rows in a group.
const GROUP: usize = 65_536;
/// At the start of a file, and at its end.
const MAGIC: &[u8; 4] = b"PAR1";
/// As the format numbers it.
const ZSTD: i64 = 6;

/// What a column holds, as the format numbers it.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Int64 = 2,
    Double = 5,
    Bytes = 6,
}

struct Column {
    name: &'static str,
    kind: Kind,
    /// Counts have no sign.
    unsigned: bool,
    page: Vec<u8>,
}

/// Where a column of a group stands in the file.
struct Piece {
    at: u64,
    size: usize,
    unpacked: usize,
}

/// A file that is being written.
pub(super) struct Parquet<W> {
    to: W,
    at: u64,
    columns: Vec<Column>,
    rows: usize,
    groups: Vec<(usize, Vec<Piece>)>,
}

impl<W: Write> Parquet<W> {
    pub(super) fn new(mut to: W) -> io::Result<Self> {
        to.write_all(MAGIC)?;
        Ok(Self { to, at: MAGIC.len() as u64, columns: Vec::new(), rows: 0, groups: Vec::new() })
    }

    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.at += bytes.len() as u64;
        self.to.write_all(bytes)
    }

    /// Writes the rows so far.
    fn group(&mut self) -> io::Result<()> {
        let rows = std::mem::take(&mut self.rows);
        let mut pieces = Vec::new();
        for i in 0..self.columns.len() {
            let page = std::mem::take(&mut self.columns[i].page);
            let packed = zstd::bulk::compress(&page, 1)?;
            let mut header = Thrift::default();
            header.int(1, 0); // a data page
            header.int(2, page.len() as i64);
            header.int(3, packed.len() as i64);
            header.structure(5, |data| {
                data.int(1, rows as i64);
                data.int(2, 0); // plain
                data.int(3, 3); // levels: none are written
                data.int(4, 3);
            });
            let header = header.end();
            let (at, head) = (self.at, header.len());
            self.put(&header)?;
            self.put(&packed)?;
            pieces.push(Piece { at, size: head + packed.len(), unpacked: head + page.len() });
        }
        self.groups.push((rows, pieces));
        Ok(())
    }

    fn footer(&self) -> Vec<u8> {
        let mut meta = Thrift::default();
        meta.int(1, 1);
        meta.list(2, self.columns.len() + 1, |i, element| match i.checked_sub(1) {
            None => {
                element.text(4, "schema");
                element.int(5, self.columns.len() as i64);
            }
            Some(i) => {
                let Column { name, kind, unsigned, .. } = &self.columns[i];
                element.int(1, *kind as i64);
                element.int(3, 0); // required
                element.text(4, name);
                match kind {
                    Kind::Bytes => element.int(6, 0),               // UTF-8
                    Kind::Int64 if *unsigned => element.int(6, 14), // UINT_64
                    _ => {}
                }
            }
        });
        meta.long(3, self.groups.iter().map(|(rows, _)| *rows as i64).sum());
        meta.list(4, self.groups.len(), |i, group| {
            let (rows, pieces) = &self.groups[i];
            group.list(1, pieces.len(), |i, chunk| {
                let (piece, column) = (&pieces[i], &self.columns[i]);
                chunk.long(2, piece.at as i64);
                chunk.structure(3, |about| {
                    about.int(1, column.kind as i64);
                    about.ints(2, &[0]); // plain
                    about.texts(3, &[column.name]);
                    about.int(4, ZSTD);
                    about.long(5, *rows as i64);
                    about.long(6, piece.unpacked as i64);
                    about.long(7, piece.size as i64);
                    about.long(9, piece.at as i64);
                });
            });
            group.long(2, pieces.iter().map(|piece| piece.unpacked as i64).sum());
            group.long(3, *rows as i64);
        });
        meta.text(6, concat!("trifacet ", env!("CARGO_PKG_VERSION")));
        meta.end()
    }
}

impl<W: Write> Table for Parquet<W> {
    fn row(&mut self, row: Row) -> io::Result<()> {
        if self.columns.is_empty() {
            self.columns = row.iter().map(|(name, value)| Column::new(name, value)).collect();
        }
        for (column, (_, value)) in self.columns.iter_mut().zip(row) {
            column.push(value);
        }
        self.rows += 1;
        if self.rows == GROUP { self.group() } else { Ok(()) }
    }

    fn finish(mut self: Box<Self>) -> io::Result<()> {
        if self.rows > 0 {
            self.group()?;
        }
        let footer = self.footer();
        self.put(&footer)?;
        self.put(&(footer.len() as u32).to_le_bytes())?;
        self.put(MAGIC)?;
        self.to.flush()
    }
}

impl Column {
    fn new(name: &'static str, value: &Value) -> Self {
        let (kind, unsigned) = match value {
            Value::Number(_) => (Kind::Double, false),
            Value::Integer(_) => (Kind::Int64, false),
            Value::Count(_) => (Kind::Int64, true),
            Value::Text(_) | Value::Names(_) => (Kind::Bytes, false),
        };
        Self { name, kind, unsigned, page: Vec::new() }
    }

    /// What is not known is NaN.
    fn push(&mut self, value: Value) {
        match value {
            Value::Number(x) => self.page.extend(x.to_le_bytes()),
            Value::Integer(x) => self.page.extend(x.to_le_bytes()),
            Value::Count(x) => self.page.extend(x.to_le_bytes()),
            Value::Text(text) => self.words(&text),
            Value::Names(names) => self.words(&names.join(" ")),
        }
    }

    fn words(&mut self, text: &str) {
        self.page.extend((text.len() as u32).to_le_bytes());
        self.page.extend(text.as_bytes());
    }
}

/// A structure in Thrift's compact protocol.
#[derive(Default)]
struct Thrift {
    bytes: Vec<u8>,
    last: i16,
}

impl Thrift {
    const INT: u8 = 5;
    const LONG: u8 = 6;
    const BINARY: u8 = 8;
    const LIST: u8 = 9;
    const STRUCT: u8 = 12;

    /// Fields come in the order of their numbers, fewer than 15 apart.
    fn field(&mut self, id: i16, kind: u8) {
        self.bytes.push(((id - self.last) as u8) << 4 | kind);
        self.last = id;
    }

    fn varint(&mut self, mut x: u64) {
        while x >= 0x80 {
            self.bytes.push(x as u8 | 0x80);
            x >>= 7;
        }
        self.bytes.push(x as u8);
    }

    fn zigzag(&mut self, x: i64) {
        self.varint((x << 1 ^ x >> 63) as u64);
    }

    fn int(&mut self, id: i16, x: i64) {
        self.field(id, Self::INT);
        self.zigzag(x);
    }

    fn long(&mut self, id: i16, x: i64) {
        self.field(id, Self::LONG);
        self.zigzag(x);
    }

    fn binary(&mut self, text: &str) {
        self.varint(text.len() as u64);
        self.bytes.extend(text.as_bytes());
    }

    fn text(&mut self, id: i16, text: &str) {
        self.field(id, Self::BINARY);
        self.binary(text);
    }

    fn begin(&mut self, id: i16, count: usize, kind: u8) {
        self.field(id, Self::LIST);
        if count < 15 {
            self.bytes.push((count as u8) << 4 | kind);
        } else {
            self.bytes.push(0xf0 | kind);
            self.varint(count as u64);
        }
    }

    fn ints(&mut self, id: i16, values: &[i64]) {
        self.begin(id, values.len(), Self::INT);
        for x in values {
            self.zigzag(*x);
        }
    }

    fn texts(&mut self, id: i16, values: &[&str]) {
        self.begin(id, values.len(), Self::BINARY);
        for text in values {
            self.binary(text);
        }
    }

    fn list(&mut self, id: i16, count: usize, mut element: impl FnMut(usize, &mut Thrift)) {
        self.begin(id, count, Self::STRUCT);
        for i in 0..count {
            let mut structure = Thrift::default();
            element(i, &mut structure);
            self.bytes.extend(structure.end());
        }
    }

    fn structure(&mut self, id: i16, fill: impl FnOnce(&mut Thrift)) {
        self.field(id, Self::STRUCT);
        let mut structure = Thrift::default();
        fill(&mut structure);
        self.bytes.extend(structure.end());
    }

    fn end(mut self) -> Vec<u8> {
        self.bytes.push(0);
        self.bytes
    }
}
