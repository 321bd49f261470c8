//! Chunks: compressed messages with a checksum.

use std::io::Read;

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

/// The decompressed records of a chunk.
#[derive(Debug)]
pub struct Chunk(Vec<u8>);

impl Chunk {
    /// Decompresses a chunk. Uses no more memory than the header states; the caller has checked that it is at
    /// most [`MOST`].
    pub(super) fn unpack(header: &Header, compressed: Vec<u8>) -> Result<Self, String> {
        let size = header.uncompressed as usize;
        let bytes = match header.compression {
            Compression::None => compressed,
            Compression::Lz4 => lz4(&compressed, size)?,
            Compression::Zstd => zstd::bulk::decompress(&compressed, size)
                .map_err(|e| format!("a chunk cannot be decompressed: {e}"))?,
        };
        if bytes.len() != size {
            return Err(format!("a chunk has {} bytes instead of {size}", bytes.len()));
        }
        let crc = crc32fast::hash(&bytes);
        if header.crc == 0 {
            return Err("a chunk has no checksum".into());
        }
        if crc != header.crc {
            return Err(format!("the checksum of a chunk is {crc:08x} instead of {:08x}", header.crc));
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

fn lz4(compressed: &[u8], size: usize) -> Result<Vec<u8>, String> {
    let wrong = |e: std::io::Error| format!("a chunk cannot be decompressed: {e}");
    let mut bytes = Vec::with_capacity(size);
    // One byte more, so that a chunk that is too long is detected.
    let decoder = lz4::Decoder::new(compressed).map_err(wrong)?;
    decoder.take(size as u64 + 1).read_to_end(&mut bytes).map_err(wrong)?;
    Ok(bytes)
}
