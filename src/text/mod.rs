//! Text files that people and spreadsheet programs write: encoding, line ends, separators.
//!
//! - [`decode`]: the text of a whole file. [`TextReader`]: the text of a stream.
//! - [`table`]: tables as CSV.

mod encoding;
mod reader;
pub mod table;

pub use encoding::{Encoding, EncodingError, decode};
pub use reader::TextReader;

/// A place in a file, as editors count it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Line, from 1.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
}

impl Place {
    /// The first character of a file.
    pub const START: Self = Self { line: 1, column: 1 };

    /// The place after a text that begins at this place. Its line ends are LF, CR LF or CR.
    fn after(self, text: &[u8]) -> Self {
        let next = text.iter().skip(1).map(Some).chain([None]);
        text.iter().zip(next).fold(self, |Self { line, column }, pair| match pair {
            (b'\n', _) => Self { line: line + 1, column: 1 },
            (b'\r', next) if next != Some(&b'\n') => Self { line: line + 1, column: 1 },
            (0x80..0xc0, _) => Self { line, column }, // continues a character of UTF-8
            _ => Self { line, column: column + 1 },
        })
    }
}
