//! Modbus TCP: the frames, and the two requests that the daemon makes. Pure.
//!
//! Source: "MODBUS Messaging on TCP/IP Implementation Guide" 1.0b. Requests are answered in order, so that several may
//! be on their way: a steering command does not wait for the answer to the one before.

use super::registers::{Register, Value};

/// Function: read registers.
pub const READ: u8 = 3;
/// Function: write registers.
pub const WRITE: u8 = 16;
/// Bit of the function in an answer that refuses a request.
pub const EXCEPTION: u8 = 0x80;
/// Longest contents of a frame after its length: a T7 takes 1040 bytes in all.
const LONGEST: usize = 1034;
/// Bytes before the contents: transaction, protocol, length.
const HEADER: usize = 6;

/// A frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Number of the request; the answer repeats it.
    pub transaction: u16,
    /// Unit; 1 for a T7.
    pub unit: u8,
    /// Function.
    pub function: u8,
    /// The bytes after the function.
    pub body: Vec<u8>,
}

impl Frame {
    /// A request to read registers.
    pub fn read(transaction: u16, register: Register, count: u16) -> Self {
        let body = [register.address, count].map(u16::to_be_bytes).concat();
        Self { transaction, unit: 1, function: READ, body }
    }

    /// A request to write values into consecutive registers.
    pub fn write(transaction: u16, first: Register, values: &[Value]) -> Self {
        let mut registers = Vec::new();
        for value in values {
            value.push_to(&mut registers);
        }
        let mut body = [first.address, registers.len() as u16].map(u16::to_be_bytes).concat();
        body.push(2 * registers.len() as u8);
        body.extend(registers.iter().flat_map(|register| register.to_be_bytes()));
        Self { transaction, unit: 1, function: WRITE, body }
    }

    /// Appends the frame as bytes.
    pub fn encode(&self, out: &mut Vec<u8>) {
        out.extend(self.transaction.to_be_bytes());
        out.extend([0, 0]);
        out.extend((self.body.len() as u16 + 2).to_be_bytes());
        out.extend([self.unit, self.function]);
        out.extend(&self.body);
    }

    /// The answer to a request of this function: registers that were read, or nothing; or the code of its refusal.
    ///
    /// # Errors
    /// [`Broken`] if this is no answer to that function.
    pub fn answer(&self, function: u8) -> Result<Result<Vec<u16>, u8>, Broken> {
        let broken = |what| Broken { what };
        match (self.function, &self.body[..]) {
            (f, [code, ..]) if f == function | EXCEPTION => Ok(Err(*code)),
            (READ, [count, data @ ..]) if function == READ && usize::from(*count) == data.len() => {
                Ok(Ok(data.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect()))
            }
            (WRITE, [_, _, _, _]) if function == WRITE => Ok(Ok(Vec::new())),
            _ => Err(broken("an answer to another request")),
        }
    }
}

/// Bytes that are not Modbus TCP.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what}")]
pub struct Broken {
    what: &'static str,
}

/// Cuts a stream of bytes into frames.
#[derive(Clone, Debug, Default)]
pub struct Frames {
    bytes: Vec<u8>,
}

impl Frames {
    /// Takes bytes that have arrived.
    pub fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend(bytes);
    }

    /// The next complete frame.
    ///
    /// # Errors
    /// [`Broken`] if the bytes are no frames. Where the next frame begins is then unknown.
    pub fn next_frame(&mut self) -> Result<Option<Frame>, Broken> {
        let Some(header) = self.bytes.first_chunk::<HEADER>() else { return Ok(None) };
        let [t0, t1, p0, p1, l0, l1] = *header;
        let length = usize::from(u16::from_be_bytes([l0, l1]));
        if [p0, p1] != [0, 0] {
            return Err(Broken { what: "the protocol of a frame is not Modbus" });
        }
        if !(2..=LONGEST).contains(&length) {
            return Err(Broken { what: "the length of a frame is not possible" });
        }
        let Some(contents) = self.bytes.get(HEADER..HEADER + length) else { return Ok(None) };
        let frame = Frame {
            transaction: u16::from_be_bytes([t0, t1]),
            unit: contents[0],
            function: contents[1],
            body: contents[2..].to_vec(),
        };
        self.bytes.drain(..HEADER + length);
        Ok(Some(frame))
    }
}

#[cfg(test)]
mod tests {
    use super::super::registers::{DAC, FLASH_CALIBRATION, FLASH_POINTER, SCAN_RATE};
    use super::*;

    #[test]
    fn requests_have_the_bytes_of_the_standard() {
        let mut bytes = Vec::new();
        Frame::read(0x0102, SCAN_RATE, 2).encode(&mut bytes);
        assert_eq!(bytes, [1, 2, 0, 0, 0, 6, 1, 3, 0x0f, 0xa2, 0, 2]);
        bytes.clear();
        Frame::write(3, FLASH_POINTER, &[Value::U32(FLASH_CALIBRATION)]).encode(&mut bytes);
        assert_eq!(bytes, [0, 3, 0, 0, 0, 11, 1, 16, 0xf1, 0x72, 0, 2, 4, 0, 0x3c, 0x40, 0]);
        bytes.clear();
        Frame::write(4, DAC, &[Value::F32(2.5), Value::F32(1.0)]).encode(&mut bytes);
        assert_eq!(bytes[6..], [1, 16, 3, 0xe8, 0, 4, 8, 0x40, 0x20, 0, 0, 0x3f, 0x80, 0, 0]);
    }

    #[test]
    fn frames_are_found_in_pieces_and_other_bytes_are_refused() {
        let answer = Frame { transaction: 7, unit: 1, function: READ, body: vec![4, 0x40, 0x20, 0, 1] };
        let refusal = Frame { transaction: 8, unit: 1, function: WRITE | EXCEPTION, body: vec![4] };
        let mut bytes = Vec::new();
        answer.encode(&mut bytes);
        refusal.encode(&mut bytes);
        let (mut frames, mut found) = (Frames::default(), Vec::new());
        for byte in bytes {
            frames.push(&[byte]);
            found.extend(frames.next_frame().unwrap());
        }
        assert_eq!(found, [answer.clone(), refusal.clone()]);
        assert_eq!(answer.answer(READ).unwrap(), Ok(vec![0x4020, 1]));
        assert_eq!(refusal.answer(WRITE).unwrap(), Err(4));
        assert!(answer.answer(WRITE).is_err() && refusal.answer(READ).is_err());
        for garbage in [[0, 1, 0, 1, 0, 6], [0, 1, 0, 0, 0xff, 0xff], [0, 1, 0, 0, 0, 1]] {
            let mut frames = Frames::default();
            frames.push(&garbage);
            assert!(frames.next_frame().is_err());
        }
    }
}
