//! Lines from a TCP client.

use super::request::MAX_LINE;

/// U+FEFF in UTF-8.
const BYTE_ORDER_MARK: &[u8] = "\u{feff}".as_bytes();

/// Error: a line is longer than [`MAX_LINE`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooLong;

/// Splits incoming bytes into lines that end with LF or CR LF. A byte order mark before the first line, as
/// Windows programs send it, is dropped.
#[derive(Debug, Default)]
pub struct Lines {
    bytes: Vec<u8>,
    /// The first bytes have been checked for a byte order mark.
    begun: bool,
}

impl Lines {
    /// Takes the next bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// The next line without its line end; `None` if more bytes are needed.
    ///
    /// # Errors
    /// The line is longer than [`MAX_LINE`].
    pub fn next_line(&mut self) -> Option<Result<Vec<u8>, TooLong>> {
        self.begin();
        match self.bytes.iter().position(|b| *b == b'\n') {
            Some(end) => {
                self.begun = true;
                let mut line: Vec<u8> = self.bytes.drain(..=end).collect();
                line.pop();
                line.pop_if(|last| *last == b'\r');
                Some(if line.len() > MAX_LINE { Err(TooLong) } else { Ok(line) })
            }
            None if self.bytes.len() > MAX_LINE + 1 => Some(Err(TooLong)),
            None => None,
        }
    }

    /// Drops a byte order mark at the beginning, once enough bytes are there.
    fn begin(&mut self) {
        if self.begun || self.bytes.len() < BYTE_ORDER_MARK.len() {
            return;
        }
        self.begun = true;
        if self.bytes.starts_with(BYTE_ORDER_MARK) {
            self.bytes.drain(..BYTE_ORDER_MARK.len());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_end_with_or_without_cr_and_have_a_limited_length() {
        let mut lines = Lines::default();
        lines.push(b"pose?\r\nsta");
        assert_eq!(lines.next_line(), Some(Ok(b"pose?".to_vec())));
        assert_eq!(lines.next_line(), None);
        lines.push(b"tus?\n\n");
        assert_eq!(lines.next_line(), Some(Ok(b"status?".to_vec())));
        assert_eq!(lines.next_line(), Some(Ok(Vec::new())));
        lines.push(&[b'x'; MAX_LINE]);
        lines.push(b"\r");
        assert_eq!(lines.next_line(), None, "the end may follow");
        lines.push(b"\n");
        assert_eq!(lines.next_line(), Some(Ok(vec![b'x'; MAX_LINE])));
        lines.push(&[b'x'; MAX_LINE + 2]);
        assert_eq!(lines.next_line(), Some(Err(TooLong)));
    }

    #[test]
    fn a_byte_order_mark_is_dropped_at_the_beginning_only() {
        let mut lines = Lines::default();
        for piece in [&b"\xef"[..], b"\xbb\xbfbye", b"\n\xef\xbb\xbfbye\n"] {
            lines.push(piece);
        }
        assert_eq!(lines.next_line(), Some(Ok(b"bye".to_vec())));
        assert_eq!(lines.next_line(), Some(Ok(b"\xef\xbb\xbfbye".to_vec())));
        let mut lines = Lines::default();
        lines.push(b"\n\xef\xbb\xbf\n");
        assert_eq!(lines.next_line(), Some(Ok(Vec::new())));
        assert_eq!(lines.next_line(), Some(Ok(b"\xef\xbb\xbf".to_vec())));
    }
}
