//! The pose frame, version 1: 192 bytes, little-endian, one frame per sample and datagram (`docs/stream.md`).

use crate::layout::FRAME_SIZE;
use crate::message::{self, CRC_SIZE, Kind, MAJOR};
use crate::{LockState, Status};

/// Value of the clock quality if the quality of the time is unknown.
pub const CLOCK_UNKNOWN: u16 = u16::MAX;

/// An encoded frame.
pub type FrameBytes = [u8; FRAME_SIZE];

/// A pose frame. Unknown values are NaN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseFrame {
    /// Random number, drawn at the start of the daemon: shows a restart.
    pub session: u32,
    /// Hash of geometry and calibration.
    pub config: u32,
    /// Counts the frames of a daemon; also counts frames that are dropped on the way.
    pub sequence: u64,
    /// Index of the converter's sample; keeps counting across gaps.
    pub sample_index: u64,
    /// When the signals were sampled: nanoseconds of UTC since 1970.
    pub time_ns: i64,
    /// Time from sampling until the pose was solved, nanoseconds, saturating.
    pub solve_delay_ns: u32,
    /// Time from sampling until the frame was sent, nanoseconds, saturating.
    pub send_delay_ns: u32,
    /// Status bits.
    pub status: Status,
    /// Standard uncertainty of `time_ns` in units of 0.1 us; [`CLOCK_UNKNOWN`] if unknown.
    pub clock_quality: u16,
    /// State of the centering loop.
    pub lock: LockState,
    /// Iterations of the solver.
    pub iterations: u8,
    /// tx, ty, tz (m), roll, pitch, yaw (rad).
    pub pose: [f64; 6],
    /// Standard uncertainty of each component of the pose; infinite with `POSE_HELD`.
    pub deviations: [f32; 6],
    /// The part of it that averaging does not reduce. Not in the bytes of a frame: `None` after decoding.
    pub systematic: Option<[f32; 6]>,
    /// Beam centre minus apex, x and y across the beam, metres.
    pub beam_offset: [f32; 2],
    /// Distance between the beam position from the steering readback and the one from the nine signals,
    /// metres.
    pub steering_residual: f32,
    /// Samples averaged into this frame.
    pub averaged: u16,
    /// Samples lost since the previous frame, saturating.
    pub lost: u16,
    /// u, v on PSD A, B, C, metres.
    pub spots: [f32; 6],
    /// Power on PSD A, B, C, watts.
    pub powers: [f32; 3],
    /// Steering position x, y, metres: read back if `STEERING_MEASURED` is set, otherwise as commanded.
    pub steering: [f32; 2],
}

/// Reasons why bytes are not a pose frame.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// The length is wrong.
    #[error("a pose frame has {FRAME_SIZE} bytes, not {0}")]
    Length(usize),
    /// The magic bytes are wrong.
    #[error("a pose frame starts with [54, 46, 50, 31] (\"TFP1\"), not {0:02x?}")]
    Magic([u8; 4]),
    /// Another major version of the layout.
    #[error("the frame has layout version {major}.{minor}; this program reads {MAJOR}.x")]
    Version {
        /// Major version: layout.
        major: u8,
        /// Minor version: compatible additions.
        minor: u8,
    },
    /// The size field is wrong.
    #[error("the frame gives its size as {0} bytes instead of {FRAME_SIZE}")]
    Size(u16),
    /// The CRC is wrong.
    #[error("wrong CRC: computed {expected:#010x}, received {received:#010x}")]
    Crc {
        /// Computed from the received bytes.
        expected: u32,
        /// As received in the frame.
        received: u32,
    },
    /// The number of the lock state is undefined.
    #[error("{0} is not a lock state; allowed: 0 to 7")]
    Lock(u8),
}

impl PoseFrame {
    /// A frame with a value in every field, for tests and examples.
    pub fn example() -> Self {
        Self {
            session: 7,
            config: 8,
            sequence: 9,
            sample_index: 1234,
            time_ns: 10,
            solve_delay_ns: 80_000,
            send_delay_ns: 90_000,
            status: Status::POSE_VALID | Status::SIMULATED,
            clock_quality: 18,
            lock: LockState::Locked,
            iterations: 2,
            pose: [1e-6, -2e-6, 3e-6, 4e-6, -5e-6, 6e-6],
            deviations: [2e-6; 6],
            systematic: None,
            beam_offset: [0.5e-6, -0.25e-6],
            steering_residual: 1e-7,
            averaged: 1,
            lost: 0,
            spots: [1e-3; 6],
            powers: [0.8e-3 / 3.0; 3],
            steering: [1e-5, 2e-5],
        }
    }

    /// Encodes this frame.
    pub fn encode(&self) -> FrameBytes {
        let mut w = Writer { bytes: [0; FRAME_SIZE], at: 0 };
        w.put(message::header(Kind::Pose, FRAME_SIZE as u16));
        w.put(self.session.to_le_bytes());
        w.put(self.config.to_le_bytes());
        w.put(self.sequence.to_le_bytes());
        w.put(self.sample_index.to_le_bytes());
        w.put(self.time_ns.to_le_bytes());
        w.put(self.solve_delay_ns.to_le_bytes());
        w.put(self.send_delay_ns.to_le_bytes());
        w.put(self.status.0.to_le_bytes());
        w.put(self.clock_quality.to_le_bytes());
        w.put([self.lock as u8, self.iterations]);
        for x in self.pose {
            w.put(x.to_le_bytes());
        }
        w.put_f32s(&self.deviations);
        w.put_f32s(&self.beam_offset);
        w.put_f32s(&[self.steering_residual]);
        w.put(self.averaged.to_le_bytes());
        w.put(self.lost.to_le_bytes());
        w.put_f32s(&self.spots);
        w.put_f32s(&self.powers);
        w.put_f32s(&self.steering);
        w.put(crc32fast::hash(&w.bytes[..FRAME_SIZE - CRC_SIZE]).to_le_bytes());
        w.bytes
    }

    /// Decodes a frame. A frame with a higher minor version is read without its additions.
    ///
    /// # Errors
    /// The length, magic, major version, size, CRC or lock state is wrong.
    pub fn decode(bytes: &[u8]) -> Result<Self, FrameError> {
        let bytes = checked(bytes)?;
        let mut r = Reader { bytes, at: message::HEADER_SIZE };
        Ok(Self {
            session: u32::from_le_bytes(r.take()),
            config: u32::from_le_bytes(r.take()),
            sequence: u64::from_le_bytes(r.take()),
            sample_index: u64::from_le_bytes(r.take()),
            time_ns: i64::from_le_bytes(r.take()),
            solve_delay_ns: u32::from_le_bytes(r.take()),
            send_delay_ns: u32::from_le_bytes(r.take()),
            status: Status(u32::from_le_bytes(r.take())),
            clock_quality: u16::from_le_bytes(r.take()),
            lock: lock_state(r.take())?,
            iterations: u8::from_le_bytes(r.take()),
            pose: core::array::from_fn(|_| f64::from_le_bytes(r.take())),
            deviations: r.take_f32s(),
            systematic: None,
            beam_offset: r.take_f32s(),
            steering_residual: f32::from_le_bytes(r.take()),
            averaged: u16::from_le_bytes(r.take()),
            lost: u16::from_le_bytes(r.take()),
            spots: r.take_f32s(),
            powers: r.take_f32s(),
            steering: r.take_f32s(),
        })
    }
}

/// Checks that the bytes are a complete, undamaged frame of this major version.
fn checked(bytes: &[u8]) -> Result<&FrameBytes, FrameError> {
    let header = message::Header::read(bytes).ok_or(FrameError::Length(bytes.len()))?;
    if header.magic != Kind::Pose.magic() {
        return Err(FrameError::Magic(header.magic));
    }
    if header.major != MAJOR {
        return Err(FrameError::Version { major: header.major, minor: header.minor });
    }
    let bytes: &FrameBytes = bytes.try_into().map_err(|_| FrameError::Length(bytes.len()))?;
    if usize::from(header.size) != FRAME_SIZE {
        return Err(FrameError::Size(header.size));
    }
    match message::crcs(bytes) {
        Some((expected, received)) if expected != received => Err(FrameError::Crc { expected, received }),
        _ => Ok(bytes),
    }
}

fn lock_state([number]: [u8; 1]) -> Result<LockState, FrameError> {
    LockState::ALL.get(usize::from(number)).copied().ok_or(FrameError::Lock(number))
}

struct Writer {
    bytes: FrameBytes,
    at: usize,
}

impl Writer {
    fn put<const N: usize>(&mut self, bytes: [u8; N]) {
        self.bytes[self.at..self.at + N].copy_from_slice(&bytes);
        self.at += N;
    }

    fn put_f32s(&mut self, numbers: &[f32]) {
        for x in numbers {
            self.put(x.to_le_bytes());
        }
    }
}

struct Reader<'a> {
    bytes: &'a FrameBytes,
    at: usize,
}

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let start = self.at;
        self.at += N;
        core::array::from_fn(|i| self.bytes[start + i])
    }

    fn take_f32s<const N: usize>(&mut self) -> [f32; N] {
        core::array::from_fn(|_| f32::from_le_bytes(self.take()))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn resealed(mut bytes: FrameBytes) -> FrameBytes {
        let crc = crc32fast::hash(&bytes[..188]);
        bytes[188..].copy_from_slice(&crc.to_le_bytes());
        bytes
    }

    #[test]
    fn errors_name_the_cause() {
        let good = PoseFrame::example().encode();
        let with = |at: usize, value: u8| {
            let mut bytes = good;
            bytes[at] = value;
            bytes
        };
        assert_eq!(PoseFrame::decode(&good[..191]), Err(FrameError::Length(191)));
        assert_eq!(PoseFrame::decode(&[]), Err(FrameError::Length(0)));
        assert_eq!(PoseFrame::decode(&with(3, b'2')), Err(FrameError::Magic(*b"TFP2")));
        assert_eq!(
            PoseFrame::decode(&with(4, 2)),
            Err(FrameError::Version { major: 2, minor: crate::message::MINOR })
        );
        assert_eq!(PoseFrame::decode(&with(6, 191)), Err(FrameError::Size(191)));
        let damaged = with(100, !good[100]);
        let expected = crc32fast::hash(&damaged[..188]);
        let received = crc32fast::hash(&good[..188]);
        assert_eq!(PoseFrame::decode(&damaged), Err(FrameError::Crc { expected, received }));
        assert_eq!(PoseFrame::decode(&resealed(with(54, 8))), Err(FrameError::Lock(8)));
    }

    #[test]
    fn a_later_minor_version_with_new_status_bits_is_read() {
        let mut bytes = PoseFrame::example().encode();
        bytes[5] = 3;
        bytes[51] |= 0x80;
        let frame = PoseFrame::decode(&resealed(bytes)).unwrap();
        assert_eq!(frame.status.0, PoseFrame::example().status.0 | 1 << 31);
    }

    proptest! {
        #[test]
        fn every_frame_survives_the_wire(body in prop::collection::vec(any::<u8>(), 180), lock in 0u8..8) {
            let mut bytes = [0; FRAME_SIZE];
            bytes[..8].copy_from_slice(&message::header(Kind::Pose, 192));
            bytes[8..188].copy_from_slice(&body);
            bytes[54] = lock;
            let bytes = resealed(bytes);
            prop_assert_eq!(PoseFrame::decode(&bytes).unwrap().encode(), bytes);
        }

        #[test]
        fn no_bytes_make_the_decoder_panic(mut bytes in prop::collection::vec(any::<u8>(), 0..400), dressed: bool) {
            if dressed && bytes.len() >= 8 {
                bytes[..8].copy_from_slice(&message::header(Kind::Pose, 192));
            }
            let read = PoseFrame::decode(&bytes);
            prop_assert!(read.is_err(), "a random CRC does not fit");
        }
    }
}
