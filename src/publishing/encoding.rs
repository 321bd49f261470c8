//! Encodes frames, descriptors and answers in the format that a TCP client requested.

use std::io;

use serde::Serialize;
use tokio::time::Instant;
use trifacet_wire::PoseFrame;
use trifacet_wire::frame::FrameBytes;
use trifacet_wire::held::Hold;
use trifacet_wire::message::Kind;
use trifacet_wire::stream::{
    Answer, Descriptor, Format, Heartbeat, LockEvent, Refusal, StreamForm, StreamRequest, json,
};

use super::columns::Columns;
use crate::config::Deviations;

/// A frame, encoded once and shared by all TCP clients.
#[derive(Clone, Debug)]
pub struct EncodedFrame {
    frame: PoseFrame,
    bytes: FrameBytes,
    /// The frame with the last valid pose instead, if it differs.
    held: Option<(PoseFrame, FrameBytes)>,
    came: Instant,
}

impl EncodedFrame {
    /// Encodes the next frame of the stream. The binary form carries these standard uncertainties.
    pub fn new(frame: PoseFrame, hold: &mut Hold, deviations: Deviations) -> Self {
        let encode = |frame: &PoseFrame| deviations.stated(frame).encode();
        let held = hold.next(&frame).map(|held| (held, encode(&held)));
        Self { frame, bytes: encode(&frame), held, came: Instant::now() }
    }

    /// The frame without a held pose.
    pub fn frame(&self) -> &PoseFrame {
        &self.frame
    }

    /// Age of the measurement, in seconds.
    pub fn age_s(&self) -> f64 {
        f64::from(self.frame.send_delay_ns) * 1e-9 + self.came.elapsed().as_secs_f64()
    }

    fn choose(&self, held: bool) -> (&PoseFrame, &FrameBytes) {
        match &self.held {
            Some((frame, bytes)) if held => (frame, bytes),
            _ => (&self.frame, &self.bytes),
        }
    }
}

/// Encoder of one client's stream.
#[derive(Clone, Debug)]
pub struct ClientEncoder {
    request: StreamRequest,
    divider: u64,
}

impl ClientEncoder {
    /// An encoder for this request, in a stream with `frames_hz` frames per second.
    pub fn new(request: StreamRequest, frames_hz: f64) -> Self {
        let divider = request.pace.divider(frames_hz).into();
        Self { request, divider }
    }

    /// Every `divider`-th frame is sent.
    pub fn divider(&self) -> u64 {
        self.divider
    }

    /// Whether changes of the lock state are sent to the client.
    pub fn events(&self) -> bool {
        self.request.events
    }

    /// Whether this frame is sent to the client.
    pub fn wants(&self, encoded: &EncodedFrame) -> bool {
        encoded.frame.sequence.is_multiple_of(self.divider)
    }

    /// The number of the `n` frames before this one that would have been sent.
    pub fn wanted_before(&self, encoded: &EncodedFrame, n: u64) -> u64 {
        let end = encoded.frame.sequence;
        end.div_ceil(self.divider) - end.saturating_sub(n).div_ceil(self.divider)
    }

    /// The bytes before the first frame: the descriptor, and for CSV the header line.
    ///
    /// # Errors
    /// The descriptor cannot be serialized.
    pub fn greeting(&self, descriptor: &Descriptor) -> io::Result<Vec<u8>> {
        let mut bytes = self.descriptor(descriptor)?;
        if self.request.format == Format::Csv {
            bytes.extend(format!("{}\n", self.columns(descriptor).join(",")).bytes());
        }
        Ok(bytes)
    }

    fn columns(&self, descriptor: &Descriptor) -> Vec<String> {
        match (self.request.format, &self.request.fields) {
            (Format::Binary, _) => Vec::new(),
            (_, Some(names)) => names.iter().map(|name| (*name).to_owned()).collect(),
            (_, None) => descriptor.columns.clone(),
        }
    }

    /// The descriptor of the daemon, with the description of this stream.
    ///
    /// # Errors
    /// The descriptor cannot be serialized.
    pub fn descriptor(&self, descriptor: &Descriptor) -> io::Result<Vec<u8>> {
        let descriptor = Descriptor {
            stream: Some(StreamForm {
                format: self.request.format.name().into(),
                divider: self.divider as u32,
                rate_hz: descriptor.rate_hz / self.divider as f64,
                held: self.request.held,
                events: self.request.events,
                columns: self.columns(descriptor),
            }),
            ..descriptor.clone()
        };
        self.write(Kind::Descriptor, &descriptor)
    }

    /// Appends a frame to `to`.
    ///
    /// # Errors
    /// The frame cannot be serialized.
    pub fn frame(&self, encoded: &EncodedFrame, to: &mut Vec<u8>) -> io::Result<()> {
        let (frame, bytes) = encoded.choose(self.request.held);
        let columns = || Columns::of(frame).select(self.request.fields.as_deref());
        match self.request.format {
            Format::Binary => to.extend(bytes),
            Format::Json => {
                serde_json::to_writer(&mut *to, &columns())?;
                to.push(b'\n');
            }
            Format::Csv => to.extend(format!("{}\n", columns().csv_line()).bytes()),
        }
        Ok(())
    }

    /// The bytes of a heartbeat.
    ///
    /// # Errors
    /// The heartbeat cannot be serialized.
    pub fn heartbeat(&self, heartbeat: &Heartbeat) -> io::Result<Vec<u8>> {
        self.write(Kind::Heartbeat, heartbeat)
    }

    /// The bytes of a change of the lock state.
    ///
    /// # Errors
    /// The event cannot be serialized.
    pub fn event(&self, event: &LockEvent) -> io::Result<Vec<u8>> {
        self.write(Kind::Event, event)
    }

    fn write<T: Serialize>(&self, kind: Kind, body: &T) -> io::Result<Vec<u8>> {
        let text = |body: &T| serde_json::to_string(body);
        Ok(match self.request.format {
            Format::Binary => json(kind, body)?,
            Format::Json => match kind.key() {
                Some(key) => format!("{{\"{key}\":{}}}\n", text(body)?).into_bytes(),
                None => format!("{}\n", text(body)?).into_bytes(),
            },
            Format::Csv => format!("# {} {}\n", kind.key().unwrap_or("error"), text(body)?).into_bytes(),
        })
    }
}

/// The answer to a query: a plain line, or a message of the running stream if there is one.
///
/// # Errors
/// The answer cannot be serialized.
pub fn answer(form: Option<&ClientEncoder>, line: &str) -> io::Result<Vec<u8>> {
    match form {
        Some(form) => form.write(Kind::Answer, &Answer(line.to_owned())),
        None => Ok(format!("{line}\n").into_bytes()),
    }
}

/// The reason for which the daemon closes the connection, as a plain line or a message of the stream.
///
/// # Errors
/// The reason cannot be serialized.
pub fn farewell(form: Option<&ClientEncoder>, error: &str) -> io::Result<Vec<u8>> {
    match form {
        Some(form) => form.write(Kind::Refusal, &Refusal { error: error.to_owned() }),
        None => Ok(format!("error: {error}\n").into_bytes()),
    }
}
