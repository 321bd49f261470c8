//! Writes messages to an MCAP file in chunks, so that an incomplete end costs at most the last chunk.

use std::collections::BTreeMap;
use std::io::Write;

use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use mcap::{Compression, McapError, WriteOptions};

use super::Topic;
use super::codec::{EncodeError, Encoded, VERSION};

/// Size of a chunk before compression, bytes: a third of a second at 10 kHz.
const CHUNK: u64 = 2 << 20;

/// Why a message cannot be recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// It cannot be encoded.
    #[error("{0}")]
    Encode(#[from] EncodeError),
    /// The system reports an error.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// It cannot be written as MCAP.
    #[error("{0}")]
    File(McapError),
}

/// An error of the system is reported as such, whatever was being written.
impl From<McapError> for RecordError {
    fn from(e: McapError) -> Self {
        match e {
            McapError::Io(e) => Self::Io(e),
            e => Self::File(e),
        }
    }
}

/// Writes one file, or one segment of the ring.
pub struct Writer<W: Write> {
    mcap: mcap::Writer<NoSeek<W>>,
    channels: [u16; Topic::ALL.len()],
    sequences: [u32; Topic::ALL.len()],
}

impl<W: Write> Writer<W> {
    /// Begins with the definitions of all messages.
    ///
    /// # Errors
    /// `to` cannot be written.
    pub fn new(to: W, compression: Option<Compression>) -> Result<Self, McapError> {
        let mut mcap = WriteOptions::new()
            .profile("ros2")
            .library(format!("trifacet {VERSION}"))
            .compression(compression)
            .compression_level(1)
            .compression_threads(0)
            .chunk_size(Some(CHUNK))
            // Seeking back to fill in the size of a chunk would leave a chunk of size zero after a crash.
            .disable_seeking(true)
            .create(NoSeek::new(to))?;
        let mut channels = [0; _];
        for (channel, topic) in channels.iter_mut().zip(Topic::ALL) {
            let schema = mcap.add_schema(topic.schema(), "ros2msg", topic.definition().as_bytes())?;
            *channel = mcap.add_channel(schema, topic.name(), "cdr", &BTreeMap::new())?;
        }
        Ok(Self { mcap, channels, sequences: [0; _] })
    }

    /// Writes a message.
    ///
    /// # Errors
    /// The message cannot be written.
    pub fn put(&mut self, message: Encoded<'_>) -> Result<(), McapError> {
        let topic = message.topic as usize;
        let log_time = u64::try_from(message.time_ns).unwrap_or(0);
        let sequence = self.sequences[topic];
        self.sequences[topic] = sequence.wrapping_add(1);
        let header =
            MessageHeader { channel_id: self.channels[topic], sequence, log_time, publish_time: log_time };
        self.mcap.write_to_known_channel(&header, message.data)
    }

    /// Ends the chunk and writes it.
    ///
    /// # Errors
    /// The chunk cannot be written.
    pub fn flush(&mut self) -> Result<(), McapError> {
        self.mcap.flush()
    }

    /// Writes the last chunk and the index.
    ///
    /// # Errors
    /// They cannot be written.
    pub fn finish(mut self) -> Result<W, McapError> {
        self.mcap.finish()?;
        Ok(self.mcap.into_inner().into_inner())
    }
}
