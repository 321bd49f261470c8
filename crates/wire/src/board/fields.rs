//! Reader and writer for the fields of a message.

use alloc::vec;
use alloc::vec::Vec;

use super::error::{MessageError, VERSION};
use super::framing;

/// Writes a message field by field.
pub(super) struct Writer(Vec<u8>);

impl Writer {
    pub(super) fn new(kind: u8) -> Self {
        Self(vec![kind, VERSION])
    }

    pub(super) fn bytes(mut self, bytes: &[u8]) -> Self {
        self.0.extend_from_slice(bytes);
        self
    }

    pub(super) fn u8(self, x: u8) -> Self {
        self.bytes(&[x])
    }

    pub(super) fn u16(self, x: u16) -> Self {
        self.bytes(&x.to_le_bytes())
    }

    pub(super) fn u32(self, x: u32) -> Self {
        self.bytes(&x.to_le_bytes())
    }

    pub(super) fn i8(self, x: i8) -> Self {
        self.bytes(&x.to_le_bytes())
    }

    pub(super) fn i32(self, x: i32) -> Self {
        self.bytes(&x.to_le_bytes())
    }

    pub(super) fn u64(self, x: u64) -> Self {
        self.bytes(&x.to_le_bytes())
    }

    pub(super) fn i24(self, x: i32) -> Self {
        self.bytes(&x.to_le_bytes()[..3])
    }

    /// The minor version of a request; version 1.0 does not have this field.
    pub(super) fn minor(self, minor: u8) -> Self {
        if minor == 0 { self } else { self.u8(minor) }
    }

    pub(super) fn frame(self, out: &mut Vec<u8>) {
        framing::encode(&self.0, out);
    }
}

/// Reads a message field by field.
pub(super) struct Reader<'a> {
    pub(super) kind: u8,
    length: usize,
    pub(super) rest: &'a [u8],
}

impl<'a> Reader<'a> {
    pub(super) fn new(message: &'a [u8]) -> Result<Self, MessageError> {
        match *message {
            [kind, VERSION, ref rest @ ..] => Ok(Self { kind, length: message.len(), rest }),
            [kind, version, ..] => Err(MessageError::Version { kind, version }),
            _ => Err(MessageError::Length { kind: 0, length: message.len() }),
        }
    }

    pub(super) fn wrong_length(&self) -> MessageError {
        MessageError::Length { kind: self.kind, length: self.length }
    }

    pub(super) fn meaningless(&self, field: &'static str) -> MessageError {
        MessageError::Value { kind: self.kind, field }
    }

    pub(super) fn bytes(&mut self, n: usize) -> Result<&'a [u8], MessageError> {
        let (bytes, rest) = self.rest.split_at_checked(n).ok_or_else(|| self.wrong_length())?;
        self.rest = rest;
        Ok(bytes)
    }

    pub(super) fn array<const N: usize>(&mut self) -> Result<[u8; N], MessageError> {
        let (bytes, rest) = self.rest.split_first_chunk().ok_or_else(|| self.wrong_length())?;
        self.rest = rest;
        Ok(*bytes)
    }

    pub(super) fn u8(&mut self) -> Result<u8, MessageError> {
        self.array().map(u8::from_le_bytes)
    }

    /// The last field of a message: a wrong length has precedence over its value.
    pub(super) fn last_u8(&mut self) -> Result<u8, MessageError> {
        let value = self.u8()?;
        if self.rest.is_empty() { Ok(value) } else { Err(self.wrong_length()) }
    }

    /// The minor version at the end of a request to a board of version 1.`own`; 0 if it is absent.
    pub(super) fn minor(&mut self, own: u8) -> Result<u8, MessageError> {
        if self.rest.is_empty() {
            Ok(0)
        } else if own == 0 {
            Err(self.wrong_length())
        } else {
            self.last_u8()
        }
    }

    pub(super) fn u16(&mut self) -> Result<u16, MessageError> {
        self.array().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Result<u32, MessageError> {
        self.array().map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self) -> Result<u64, MessageError> {
        self.array().map(u64::from_le_bytes)
    }

    pub(super) fn i8(&mut self) -> Result<i8, MessageError> {
        self.array().map(i8::from_le_bytes)
    }

    pub(super) fn i32(&mut self) -> Result<i32, MessageError> {
        self.array().map(i32::from_le_bytes)
    }

    pub(super) fn i24(&mut self) -> Result<i32, MessageError> {
        let [a, b, c] = self.array()?;
        Ok(i32::from_le_bytes([0, a, b, c]) >> 8)
    }

    pub(super) fn end<T>(self, message: T) -> Result<T, MessageError> {
        if self.rest.is_empty() { Ok(message) } else { Err(self.wrong_length()) }
    }
}
