//! Contents of a recording: the reader ends without a panic and within its memory limit, and so does a
//! replay of the decoded entries.

#![no_main]

use std::io::Write;

use libfuzzer_sys::fuzz_target;
use trifacet::recording::reader::{Read, Reader};
use trifacet::replay::{Comparison, Engine};

fuzz_target!(|bytes: &[u8]| {
    // The bytes as they are, and as an uncompressed chunk with a correct checksum, which the fuzzer cannot
    // guess.
    for file in [bytes.to_vec(), chunk(bytes)] {
        let mut place = tempfile::NamedTempFile::new().expect("a file");
        place.write_all(&file).expect("room");
        let Ok(mut reader) = Reader::open(place.path(), Reader::REPLAY) else { continue };
        let (mut engine, mut comparison) = (Engine::new(), Comparison::default());
        while let Some(read) = reader.read().expect("the file is there") {
            let Read::Entry(entry) = read else { continue };
            let Ok(()) = engine.take(&entry) else { break };
            comparison.take(&entry, engine.report());
        }
    }
});

fn chunk(records: &[u8]) -> Vec<u8> {
    let mut file = b"\x89MCAP0\r\n".to_vec();
    let size = records.len() as u64;
    file.push(6);
    file.extend((40 + size).to_le_bytes());
    file.extend([0; 16]);
    file.extend(size.to_le_bytes());
    file.extend(crc32fast::hash(records).to_le_bytes());
    file.extend(0_u32.to_le_bytes());
    file.extend(size.to_le_bytes());
    file.extend(records);
    file
}
