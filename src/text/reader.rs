//! The text of a stream.

use std::io::{self, BufReader, Chain, Cursor, ErrorKind, Read};

use super::Place;
use super::encoding::{BOM, Encoding, EncodingError, is_utf16};

/// Reads text: without the byte order mark, with every line end (LF, CR LF or CR) as LF.
///
/// Bytes that are not UTF-8 pass: they may be in a part that nobody reads. Reading UTF-16 fails with an
/// [`EncodingError`] in an error of the kind [`ErrorKind::InvalidData`].
#[derive(Debug)]
pub struct TextReader<R: Read> {
    bytes: BufReader<Chain<Cursor<Vec<u8>>, R>>,
    place: Place,
    /// The last byte was a CR, which was passed on as LF.
    after_cr: bool,
}

impl<R: Read> TextReader<R> {
    /// Reads the first bytes and checks for a byte order mark.
    ///
    /// # Errors
    /// Fails if they cannot be read, or are in UTF-16.
    pub fn new(mut bytes: R) -> io::Result<Self> {
        let mut start = Vec::new();
        (&mut bytes).take(BOM.len() as u64).read_to_end(&mut start)?;
        if is_utf16(&start) {
            return Err(invalid(Place::START, Encoding::Utf16));
        }
        if start == BOM {
            start.clear();
        }
        let bytes = BufReader::new(Cursor::new(start).chain(bytes));
        Ok(Self { bytes, place: Place::START, after_cr: false })
    }

    /// Passes on one byte, or nothing for the second byte of a line end.
    fn pass(&mut self, byte: u8) -> io::Result<Option<u8>> {
        let second = byte == b'\n' && self.after_cr;
        self.after_cr = byte == b'\r';
        match byte {
            0 => return Err(invalid(self.place, Encoding::Zero)),
            _ if second => return Ok(None),
            b'\n' | b'\r' => self.place = Place { line: self.place.line + 1, column: 1 },
            0x80..0xc0 => {} // within a character
            _ => self.place.column += 1,
        }
        Ok(Some(if byte == b'\r' { b'\n' } else { byte }))
    }
}

fn invalid(place: Place, found: Encoding) -> io::Error {
    io::Error::new(ErrorKind::InvalidData, EncodingError { place, found })
}

impl<R: Read> Read for TextReader<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        loop {
            let read = self.bytes.read(out)?;
            let chunk = &mut out[..read];
            // Most text has neither of them, and passes as it is.
            if !self.after_cr && !chunk.contains(&b'\r') && !chunk.contains(&0) {
                self.place = self.place.after(chunk);
                return Ok(read);
            }
            let mut passed = 0;
            for i in 0..read {
                if let Some(byte) = self.pass(chunk[i])? {
                    chunk[passed] = byte;
                    passed += 1;
                }
            }
            // A chunk that is only the second byte of a line end is not the end of the stream.
            if passed > 0 || read == 0 {
                return Ok(passed);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Delivers one byte at a time, as a slow pipe.
    struct Drip(&'static [u8]);

    impl Read for Drip {
        fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
            let n = self.0.len().min(out.len()).min(1);
            let (now, later) = self.0.split_at(n);
            out[..n].copy_from_slice(now);
            self.0 = later;
            Ok(n)
        }
    }

    fn read(bytes: &'static [u8]) -> io::Result<String> {
        let mut text = String::new();
        TextReader::new(Drip(bytes))?.read_to_string(&mut text)?;
        Ok(text)
    }

    #[test]
    fn line_ends_and_the_byte_order_mark_do_not_matter() {
        for bytes in [&b"\xef\xbb\xbfa\r\n\r\nb\r\n"[..], b"a\n\nb\n", b"a\r\rb\r", b"a\n\rb\r\n"] {
            assert_eq!(read(bytes).unwrap(), "a\n\nb\n");
        }
        assert_eq!(read(b"").unwrap(), "");
    }

    #[test]
    fn utf16_is_named_with_its_place() {
        for (bytes, line, column) in [(&b"\xff\xfea\0"[..], 1, 1), (b"a\r\nbc\0", 2, 3)] {
            let error = read(bytes).unwrap_err();
            let inner = error.get_ref().unwrap().downcast_ref::<EncodingError>().unwrap();
            assert_eq!(inner.place, Place { line, column });
            assert!(error.to_string().contains("UTF-16"), "{error}");
        }
    }
}
