//! Chunks: compressed messages with a checksum.

use std::io::{self, Read};

use super::bytes::Bytes;

/// Largest chunk accepted, bytes. This program writes 2 MiB, other programs about 10 MiB at most.
pub(super) const MOST: u64 = 64 << 20;

/// The header of a chunk.
#[derive(Debug)]
pub(super) struct Header {
    pub(super) uncompressed: u64,
    pub(super) compressed: u64,
    crc: u32,
    compression: Compression,
}

#[derive(Clone, Copy, Debug)]
enum Compression {
    None,
    Lz4,
    Zstd,
}

impl Compression {
    const fn name(self) -> &'static str {
        match self {
            Self::None => "",
            Self::Lz4 => "lz4",
            Self::Zstd => "zstd",
        }
    }
}

impl Header {
    /// Size of the longest header, bytes.
    pub(super) const LONGEST: u64 = 44;

    pub(super) fn read(bytes: &mut Bytes<'_>) -> Option<Self> {
        let (_start, _end) = (bytes.u64()?, bytes.u64()?);
        let (uncompressed, crc) = (bytes.u64()?, bytes.u32()?);
        let name = bytes.text()?;
        let known = [Compression::None, Compression::Lz4, Compression::Zstd];
        let compression = known.into_iter().find(|compression| compression.name() == name)?;
        Some(Self { uncompressed, compressed: bytes.u64()?, crc, compression })
    }

    /// Size of this header, bytes.
    pub(super) fn size(&self) -> u64 {
        40 + self.compression.name().len() as u64
    }
}

/// Why the records of a chunk cannot be read.
#[derive(Debug, thiserror::Error)]
pub(super) enum ChunkError {
    /// The compressed data are invalid.
    #[error("a chunk cannot be decompressed: {0}")]
    Decompression(#[from] io::Error),
    /// The size differs from that in the header, bytes.
    #[error("a chunk has {found} bytes instead of {stated}")]
    Size { found: usize, stated: usize },
    /// The header contains no checksum.
    #[error("a chunk has no checksum")]
    NoChecksum,
    /// The checksum differs from that in the header.
    #[error("the checksum of a chunk is {found:08x} instead of {stated:08x}")]
    Checksum { found: u32, stated: u32 },
}

/// The decompressed records of a chunk.
#[derive(Debug)]
pub struct Chunk(Vec<u8>);

impl Chunk {
    /// Decompresses a chunk. Uses no more memory than the header states; the caller has checked that it is at
    /// most [`MOST`].
    pub(super) fn unpack(header: &Header, compressed: Vec<u8>) -> Result<Self, ChunkError> {
        let size = header.uncompressed as usize;
        let bytes = match header.compression {
            Compression::None => compressed,
            Compression::Lz4 => lz4(&compressed, size)?,
            Compression::Zstd => zstd::bulk::decompress(&compressed, size)?,
        };
        if bytes.len() != size {
            return Err(ChunkError::Size { found: bytes.len(), stated: size });
        }
        let crc = crc32fast::hash(&bytes);
        if header.crc == 0 {
            return Err(ChunkError::NoChecksum);
        }
        if crc != header.crc {
            return Err(ChunkError::Checksum { found: crc, stated: header.crc });
        }
        Ok(Self(bytes))
    }

    pub(super) fn size(&self) -> usize {
        self.0.len()
    }

    /// The records from byte `from` on.
    pub(super) fn records(&self, from: usize) -> Bytes<'_> {
        Bytes(self.0.get(from..).unwrap_or_default())
    }
}

fn lz4(compressed: &[u8], size: usize) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::with_capacity(size);
    // One byte more, so that a chunk that is too long is detected.
    let decoder = lz4::Decoder::new(compressed)?;
    decoder.take(size as u64 + 1).read_to_end(&mut bytes)?;
    Ok(bytes)
}
