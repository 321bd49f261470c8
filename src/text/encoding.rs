//! Detects the encoding of a text.

use std::fmt;

use super::Place;

/// The byte order mark of UTF-8, which some programs write at the start of a file.
pub(super) const BOM: &[u8] = b"\xef\xbb\xbf";

/// An encoding other than UTF-8.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// UTF-16 with its byte order mark.
    Utf16,
    /// A zero byte: UTF-16 without a byte order mark, or no text.
    Zero,
    /// A byte that is not part of a character in UTF-8.
    Other(u8),
}

/// Why bytes are not text in UTF-8.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EncodingError {
    /// Place of the first wrong byte.
    pub place: Place,
    /// What was found.
    pub found: Encoding,
}

impl fmt::Display for EncodingError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.found {
            Encoding::Utf16 => f.write_str("the text is in UTF-16")?,
            Encoding::Zero => f.write_str("a zero byte: the text is in UTF-16, or the file is damaged")?,
            // Latin-1 and Windows-1252 agree from here on.
            Encoding::Other(byte @ 0xa0..) => {
                let char = char::from(byte);
                write!(f, "the byte {byte:#04x} is not UTF-8; in Latin-1 and Windows-1252 it is \"{char}\"")?;
            }
            Encoding::Other(byte) => write!(f, "the byte {byte:#04x} is not UTF-8")?,
        }
        f.write_str("; allowed is UTF-8: save the file in this encoding")
    }
}

impl std::error::Error for EncodingError {}

/// Whether the bytes begin with the byte order mark of UTF-16.
pub(super) fn is_utf16(start: &[u8]) -> bool {
    start.starts_with(b"\xff\xfe") || start.starts_with(b"\xfe\xff")
}

/// The text of a file, without the byte order mark.
///
/// # Errors
/// Fails with the place of the first byte that is not text in UTF-8.
pub fn decode(bytes: &[u8]) -> Result<&str, EncodingError> {
    if is_utf16(bytes) {
        return Err(EncodingError { place: Place::START, found: Encoding::Utf16 });
    }
    let bytes = bytes.strip_prefix(BOM).unwrap_or(bytes);
    let fail = |at: usize, found| Err(EncodingError { place: Place::START.after(&bytes[..at]), found });
    if let Some(zero) = bytes.iter().position(|byte| *byte == 0) {
        return fail(zero, Encoding::Zero);
    }
    std::str::from_utf8(bytes).or_else(|e| {
        let at = e.valid_up_to();
        fail(at, Encoding::Other(bytes[at]))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_encodings_are_named_with_their_place() {
        assert_eq!(decode(b"\xef\xbb\xbfa = 1\r\n"), Ok("a = 1\r\n"));
        let le: Vec<u8> = "a = 1".encode_utf16().flat_map(u16::to_le_bytes).collect();
        for (bytes, line, column, found) in [
            (&b"\xff\xfea\0"[..], 1, 1, Encoding::Utf16),
            (b"\xfe\xff\0a", 1, 1, Encoding::Utf16),
            (&le, 1, 2, Encoding::Zero),
            (b"a\r\nb\r\n\0\0\0", 3, 1, Encoding::Zero),
            (b"\xc3\xa4 = 1\n# 5 \0", 2, 5, Encoding::Zero),
        ] {
            let place = Place { line, column };
            assert_eq!(decode(bytes), Err(EncodingError { place, found }));
        }
        let error = decode(b"\xef\xbb\xbf\ra\r# 5 \xb5m").unwrap_err();
        assert_eq!((error.place, error.found), (Place { line: 3, column: 5 }, Encoding::Other(0xb5)));
        assert!(error.to_string().contains("0xb5 is not UTF-8; in Latin-1 and Windows-1252 it is \"µ\""));
    }
}
