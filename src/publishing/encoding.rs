//! What goes to a TCP client, in the form that it asked for.

use std::io;

use serde::Serialize;
use tokio::time::Instant;
use trifacet_wire::PoseFrame;
use trifacet_wire::frame::FrameBytes;
use trifacet_wire::held::Hold;
use trifacet_wire::message::Kind;
use trifacet_wire::stream::{
    Answer, Descriptor, Format, Heartbeat, Refusal, StreamForm, StreamRequest, json,
};

use super::columns::Columns;

/// A frame as all TCP clients share it.
#[derive(Clone, Debug)]
pub struct EncodedFrame {
    frame: PoseFrame,
    bytes: FrameBytes,
    /// With the last valid pose, if that is another frame.
    held: Option<(PoseFrame, FrameBytes)>,
    came: Instant,
}

impl EncodedFrame {
    /// The next frame of the stream.
    pub fn new(frame: PoseFrame, hold: &mut Hold) -> Self {
        let held = hold.next(&frame).map(|held| (held, held.encode()));
        Self { frame, bytes: frame.encode(), held, came: Instant::now() }
    }

    /// The frame as it was made.
    pub fn frame(&self) -> &PoseFrame {
        &self.frame
    }

    /// How long ago its light was measured, in seconds.
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

/// The form of a client's stream.
#[derive(Clone, Debug)]
pub struct ClientEncoder {
    request: StreamRequest,
    divider: u64,
}

impl ClientEncoder {
    /// The form of a request, in a stream of so many frames a second.
    pub fn new(request: StreamRequest, frames_hz: f64) -> Self {
        let divider = request.pace.divider(frames_hz).into();
        Self { request, divider }
    }

    /// One frame in so many is sent.
    pub fn divider(&self) -> u64 {
        self.divider
    }

    /// Whether this frame is one of those that are sent.
    pub fn wants(&self, frame_once: &EncodedFrame) -> bool {
        frame_once.frame.sequence.is_multiple_of(self.divider)
    }

    /// How many of the `n` frames before this one would have been sent.
    pub fn wanted_before(&self, frame_once: &EncodedFrame, n: u64) -> u64 {
        let end = frame_once.frame.sequence;
        end.div_ceil(self.divider) - end.saturating_sub(n).div_ceil(self.divider)
    }

    /// What comes before the first frame.
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

    /// What the daemon says of itself and of this stream.
    pub fn descriptor(&self, descriptor: &Descriptor) -> io::Result<Vec<u8>> {
        let descriptor = Descriptor {
            stream: Some(StreamForm {
                format: self.request.format.name().into(),
                divider: self.divider as u32,
                rate_hz: descriptor.rate_hz / self.divider as f64,
                held: self.request.held,
                columns: self.columns(descriptor),
            }),
            ..descriptor.clone()
        };
        self.write(Kind::Descriptor, &descriptor)
    }

    /// Appends a frame.
    pub fn frame(&self, frame_once: &EncodedFrame, to: &mut Vec<u8>) -> io::Result<()> {
        let (frame, bytes) = frame_once.choose(self.request.held);
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

    /// A heartbeat.
    pub fn heartbeat(&self, heartbeat: &Heartbeat) -> io::Result<Vec<u8>> {
        self.write(Kind::Heartbeat, heartbeat)
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

/// An answer to a query: a line of its own, or one that fits into the stream that runs.
pub fn answer(form: Option<&ClientEncoder>, line: &str) -> io::Result<Vec<u8>> {
    match form {
        Some(form) => form.write(Kind::Answer, &Answer(line.to_owned())),
        None => Ok(format!("{line}\n").into_bytes()),
    }
}

/// Why the connection ends, likewise.
pub fn farewell(form: Option<&ClientEncoder>, error: &str) -> io::Result<Vec<u8>> {
    match form {
        Some(form) => form.write(Kind::Refusal, &Refusal { error: error.to_owned() }),
        None => Ok(format!("error: {error}\n").into_bytes()),
    }
}
