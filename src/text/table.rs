//! Tables as CSV, whose columns are identified by name.
//!
//! The fields are separated by commas, semicolons or tabs: by what separates the names of the needed columns
//! in the first line. With semicolons or tabs, numbers may have a decimal comma, as spreadsheet programs write
//! them in many countries. Between commas a decimal comma would be ambiguous. So is `1,234` in any table, unless
//! an earlier number has shown that the comma is the decimal mark: it can be a thousands separator.

use std::borrow::Cow;
use std::cell::Cell;
use std::io::{Chain, Cursor, ErrorKind, Read};

use csv::ByteRecord;

use super::{EncodingError, TextReader};
use crate::exit::{self, Failure};

/// The characters that can separate fields. Of two that separate equally many names, the first one counts.
const SEPARATORS: [u8; 3] = [b',', b';', b'\t'];
/// Longest first line in bytes.
const HEAD: usize = 64 << 10;

/// Why a row does not contain the expected values.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RowError {
    /// The row has more or fewer fields than the header.
    #[error("{found} fields where the header has {expected}{hint}")]
    Width {
        /// Number of fields.
        found: usize,
        /// Number of fields of the header.
        expected: usize,
        /// A likely cause; "" if there is none.
        hint: &'static str,
    },
    /// A field is empty, as in the tables of `watch` and `export`.
    #[error("{column} is empty: the value is unknown")]
    Unknown {
        /// Name of the column.
        column: String,
    },
    /// A field does not have one of the allowed values.
    #[error("{column} is \"{text}\": allowed is {allowed}")]
    Field {
        /// Name of the column.
        column: String,
        /// The text of the field.
        text: String,
        /// The allowed values.
        allowed: String,
    },
    /// A field is not text in UTF-8.
    #[error("{column} contains the byte {byte:#04x}, which is not UTF-8: save the file in this encoding")]
    NotUtf8 {
        /// Name of the column.
        column: String,
        /// The first wrong byte.
        byte: u8,
    },
    /// Fields are valid, but not together.
    #[error("{0}")]
    Other(String),
}

/// How to read a table.
#[derive(Clone, Copy, Debug)]
pub struct Layout<'a> {
    /// Names of the columns that the table must have.
    pub needed: &'a [&'a str],
    /// Names of the columns that are used if the table has them.
    pub optional: &'a [&'a str],
    /// Other names of columns, each with its name in the two lists.
    pub aliases: &'a [(&'a str, &'a str)],
    /// Lines that begin with # are comments.
    pub comments: bool,
}

impl Layout<'_> {
    /// The name of a column in the lists, for one of its names.
    fn canonical<'n>(&self, name: &'n str) -> &'n str
    where
        Self: 'n,
    {
        self.aliases.iter().find(|(alias, _)| *alias == name).map_or(name, |(_, meant)| meant)
    }
}

/// A table after its first line was read.
#[derive(Debug)]
pub struct Table<R: Read> {
    name: String,
    reader: csv::Reader<Text<R>>,
    separator: u8,
    columns: Vec<String>,
    record: ByteRecord,
    /// The decimal mark of the numbers so far.
    mark: Cell<Option<char>>,
}

/// The first line, the rest of the text, and a line feed.
type Text<R> = Chain<Chain<Cursor<Vec<u8>>, TextReader<R>>, &'static [u8]>;

/// One row of a table.
#[derive(Debug)]
pub struct Row<'t> {
    name: &'t str,
    columns: &'t [String],
    separator: u8,
    mark: &'t Cell<Option<char>>,
    line: u64,
    record: &'t ByteRecord,
}

impl<R: Read> Table<R> {
    /// Reads the first line. `name` is the name of the file in messages.
    ///
    /// # Errors
    /// [`exit::IO`] if the file cannot be read; [`exit::DATA`] if it is empty or not text, or if a column is
    /// missing or occurs twice.
    pub fn open(name: impl Into<String>, bytes: R, layout: Layout<'_>) -> Result<Self, Failure> {
        let name = name.into();
        let (head, rest) = TextReader::new(bytes)
            .and_then(|mut text| Ok((head(&mut text, layout.comments)?, text)))
            .map_err(|e| unreadable(&name, &e))?;
        let separator = separator(&head, layout);
        // The reader counts a line at its line feed. One is appended, so that the line numbers are right for
        // the last record too.
        let reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .delimiter(separator)
            .trim(csv::Trim::All)
            .comment(layout.comments.then_some(b'#'))
            .terminator(csv::Terminator::Any(b'\n'))
            .from_reader(Cursor::new(head).chain(rest).chain(&b"\n"[..]));
        let (record, mark) = (ByteRecord::new(), Cell::new(None));
        let mut table = Self { name, reader, separator, columns: Vec::new(), record, mark };
        table.read_header(layout)?;
        Ok(table)
    }

    /// The name of the file in messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    fn read_header(&mut self, layout: Layout<'_>) -> Result<(), Failure> {
        let Layout { needed, optional, .. } = layout;
        let list = needed.join(", ");
        let first = self.next_record()?;
        let unfit =
            |line: u64, what: String| Failure::new(exit::DATA, format!("{}:{line}: {what}", self.name));
        let Some(line) = first else {
            return Err(unfit(1, format!("empty: the first line must name the columns {list}")));
        };
        let names = self.record.iter().map(String::from_utf8_lossy);
        self.columns = names.map(|name| layout.canonical(&name).to_owned()).collect();
        for column in needed.iter().chain(optional) {
            match self.columns.iter().filter(|name| name == column).count() {
                1 => {}
                0 if optional.contains(column) => {}
                0 => {
                    let found = shortened(&self.columns.join(&char::from(self.separator).to_string()));
                    let what = format!(
                        "the column {column} is missing; required are {list}, separated by commas, semicolons \
                         or tabs, but the first line is \"{found}\""
                    );
                    return Err(unfit(line, what));
                }
                _ => {
                    let other = layout.aliases.iter().find(|(_, name)| name == column);
                    let or = other.map_or_else(String::new, |(alias, _)| format!(" or {alias}"));
                    return Err(unfit(line, format!("the column {column}{or} occurs twice")));
                }
            }
        }
        Ok(())
    }

    /// The next row. `None` at the end of the file.
    ///
    /// # Errors
    /// [`exit::IO`] if the file cannot be read, [`exit::DATA`] if it is not text.
    pub fn next_row(&mut self) -> Result<Option<Row<'_>>, Failure> {
        let Some(line) = self.next_record()? else { return Ok(None) };
        let Self { name, columns, separator, mark, record, .. } = self;
        Ok(Some(Row { name, columns, separator: *separator, mark, line, record }))
    }

    /// Reads the next record that is not blank, and returns its line number.
    fn next_record(&mut self) -> Result<Option<u64>, Failure> {
        while self.reader.read_byte_record(&mut self.record).map_err(|e| match e.into_kind() {
            csv::ErrorKind::Io(e) => unreadable(&self.name, &e),
            other => Failure::new(exit::DATA, format!("cannot read {}: {other:?}", self.name)),
        })? {
            if self.record.iter().any(|field| !field.is_empty()) {
                let within = self.record.iter().flatten().filter(|byte| **byte == b'\n').count() as u64;
                return Ok(Some(self.reader.position().line().saturating_sub(1 + within)));
            }
        }
        Ok(None)
    }
}

impl<'t> Row<'t> {
    /// An error message for this row, with its file and line.
    pub fn wrong(&self, what: impl std::fmt::Display) -> Failure {
        Failure::new(exit::DATA, format!("{}:{}: {what}", self.name, self.line))
    }

    /// The line of the file in which the row begins, from 1.
    pub fn line(&self) -> u64 {
        self.line
    }

    /// Checks that the row has as many fields as the header.
    ///
    /// # Errors
    /// Fails if it has more or fewer.
    pub fn check_width(&self) -> Result<(), RowError> {
        let (found, expected) = (self.record.len(), self.columns.len());
        if found == expected {
            return Ok(());
        }
        let commas = self.separator == b',' && found > expected;
        let hint = if commas {
            "; numbers may have a decimal comma only if the fields are separated by semicolons or tabs"
        } else {
            ""
        };
        Err(RowError::Width { found, expected, hint })
    }

    /// Whether the table has this column.
    pub fn has(&self, column: &str) -> bool {
        self.columns.iter().any(|name| name == column)
    }

    /// A field as text; "" if the column does not exist.
    ///
    /// # Errors
    /// Fails if it is not UTF-8.
    pub fn text(&self, column: &str) -> Result<&'t str, RowError> {
        let place = self.columns.iter().position(|name| name == column);
        let field = place.and_then(|place| self.record.get(place)).unwrap_or_default();
        std::str::from_utf8(field)
            .map_err(|e| RowError::NotUtf8 { column: column.to_owned(), byte: field[e.valid_up_to()] })
    }

    /// A field parsed by `parse`. `allowed` states the allowed values, for the error message.
    ///
    /// # Errors
    /// Fails if `parse` returns `None`.
    pub fn parse<T>(
        &self,
        column: &str,
        allowed: &str,
        parse: impl Fn(&str) -> Option<T>,
    ) -> Result<T, RowError> {
        let text = self.text(column)?;
        parse(text).ok_or_else(|| field(column, text, allowed))
    }

    /// A field as a whole number.
    ///
    /// # Errors
    /// Fails if the field is not a whole number within the range of the type.
    pub fn count<T: std::str::FromStr>(&self, column: &str) -> Result<T, RowError> {
        self.parse(column, "a whole number", |text| text.parse().ok())
    }

    /// A field as a finite number.
    ///
    /// # Errors
    /// Fails if the field is not a finite number, or if its decimal mark is ambiguous.
    pub fn number(&self, column: &str) -> Result<f64, RowError> {
        let text = self.text(column)?;
        if text.is_empty() {
            return Err(RowError::Unknown { column: column.to_owned() });
        }
        let mark = match (text.contains('.'), text.matches(',').count()) {
            (_, 0) => text.contains('.').then_some('.'),
            (false, 1) => Some(','),
            _ => return Err(field(column, text, "a finite number without thousands separators")),
        };
        if mark == Some(',') && self.separator == b',' {
            let allowed =
                "a finite number; a decimal comma only if the fields are separated by semicolons or tabs";
            return Err(field(column, text, allowed));
        }
        let before = self.mark.get();
        if before.is_none() && has_thousands(text) {
            let allowed = "a number with a clear decimal mark; this comma can be a decimal comma or a thousands \
                           separator";
            return Err(field(column, text, allowed));
        }
        if let (Some(before), Some(mark)) = (before, mark)
            && before != mark
        {
            let allowed = format!("a number with the decimal mark of the rows before, \"{before}\"");
            return Err(field(column, text, &allowed));
        }
        let number = plain(text);
        let number = if mark == Some(',') { number.replace(',', ".").parse() } else { number.parse() };
        let number = number
            .ok()
            .filter(|x: &f64| x.is_finite())
            .ok_or_else(|| field(column, text, "a finite number"))?;
        self.mark.set(before.or(mark));
        Ok(number)
    }
}

/// Whether a comma can separate thousands: one to three digits before it, of which the first is not zero, and
/// three digits after it.
fn has_thousands(text: &str) -> bool {
    let digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    let Some((before, after)) = text.split_once(',') else { return false };
    let before = before.trim_start_matches(['+', '-', '\u{2212}']);
    let [before_ok, after_ok] = [(1..=3).contains(&before.len()), after.len() == 3];
    before_ok && after_ok && digits(before) && digits(after) && !before.starts_with('0')
}

/// Replaces the minus sign U+2212, which some programs write, by the ASCII hyphen.
pub fn plain(number: &str) -> Cow<'_, str> {
    if number.contains('\u{2212}') { number.replace('\u{2212}', "-").into() } else { number.into() }
}

fn field(column: &str, text: &str, allowed: &str) -> RowError {
    RowError::Field { column: column.to_owned(), text: text.to_owned(), allowed: allowed.to_owned() }
}

/// Reads to the end of the first line that is neither blank nor a comment.
fn head(text: &mut impl Read, comments: bool) -> std::io::Result<Vec<u8>> {
    let mut head = Vec::new();
    let mut chunk = [0; 1024];
    while first_line(&head, comments).is_none_or(|line| !line.ends_with(b"\n")) && head.len() < HEAD {
        match text.read(&mut chunk) {
            Ok(0) => break,
            Ok(n) => head.extend_from_slice(&chunk[..n]),
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(head)
}

/// The first line that is neither blank nor a comment, with its line feed if it is complete.
fn first_line(text: &[u8], comments: bool) -> Option<&[u8]> {
    let skipped = |line: &[u8]| line.trim_ascii().is_empty() || (comments && line.starts_with(b"#"));
    text.split_inclusive(|byte| *byte == b'\n').find(|line| !skipped(line))
}

/// The separator between most names of needed columns in the first line.
fn separator(head: &[u8], layout: Layout<'_>) -> u8 {
    let line = String::from_utf8_lossy(first_line(head, layout.comments).unwrap_or_default()).into_owned();
    let names = |separator: u8| {
        let fields = line.split(char::from(separator)).map(|field| field.trim().trim_matches('"').trim());
        fields.filter(|field| layout.needed.contains(&layout.canonical(field))).count()
    };
    // Of equal ones, `max_by_key` returns the last.
    SEPARATORS.into_iter().rev().max_by_key(|separator| names(*separator)).unwrap_or(b',')
}

fn unreadable(name: &str, error: &std::io::Error) -> Failure {
    match error.get_ref().and_then(|inner| inner.downcast_ref::<EncodingError>()) {
        Some(EncodingError { place, .. }) => {
            Failure::new(exit::DATA, format!("{name}:{}:{}: {error}", place.line, place.column))
        }
        None => Failure::new(exit::IO, format!("cannot read {name}: {error}")),
    }
}

/// The beginning of a text, for a message.
fn shortened(text: &str) -> String {
    let start: String = text.chars().take(60).collect();
    if start.len() < text.len() { start + "..." } else { start }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const LAYOUT: Layout<'_> =
        Layout { needed: &["x_m", "y_m"], optional: &["z_m"], aliases: &[], comments: true };

    proptest! {
        #[test]
        fn numbers_are_the_same_in_every_dialect(
            rows in prop::collection::vec([any::<f64>(), any::<f64>()], 0..20),
            dialect in prop::sample::select(vec![(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ",")]),
            end in prop::sample::select(vec!["\n", "\r\n", "\r"]),
        ) {
            let (separator, mark) = dialect;
            let mut text = ["# lab", end, &["y_m", "note", "x_m"].join(separator), end].concat();
            for row in &rows {
                let [x, y] = row.map(|x| format!("{:e}", if x.is_finite() { x } else { 0.5 }).replace('.', mark));
                text += &[[&*y, "", &*x].join(separator).as_str(), end].concat();
            }
            let mut table = Table::open("t", text.as_bytes(), LAYOUT).unwrap();
            for (i, row) in rows.iter().enumerate() {
                let read = table.next_row().unwrap().unwrap();
                prop_assert_eq!(read.wrong("").message, format!("t:{}: ", i + 3));
                read.check_width().unwrap();
                for (column, x) in ["x_m", "y_m"].iter().zip(row) {
                    let x = if x.is_finite() { *x } else { 0.5 };
                    prop_assert_eq!(read.number(column).unwrap().to_bits(), x.to_bits());
                }
            }
            prop_assert!(table.next_row().unwrap().is_none());
        }

        #[test]
        fn no_bytes_make_the_reader_panic(
            start in prop::sample::select(vec![&b""[..], b"x_m;y_m\n", b"\xef\xbb\xbfx_m\ty_m\r", b"x_m,\"y_m\"\n"]),
            bytes in prop::collection::vec(prop_oneof![any::<u8>(), prop::sample::select(b",;\t\r\n\"#.1-".to_vec())], 0..200),
        ) {
            let text = [start, &bytes].concat();
            if let Ok(mut table) = Table::open("t", &text[..], LAYOUT) {
                while let Ok(Some(row)) = table.next_row() {
                    let _ = (row.check_width(), row.number("x_m"), row.count::<u8>("z_m"));
                }
            }
        }
    }
}
