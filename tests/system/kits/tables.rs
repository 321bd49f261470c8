//! The tables of the stream in the kits agree with the code.

use serde_json::{Value, json};
use trifacet_wire::layout::{FIELDS, FRAME_SIZE};
use trifacet_wire::{LockState, Status};

use super::fixture::datagrams;
use super::tools::{python_with_packages, read, succeeded};

#[test]
fn python_knows_every_status_bit_lock_state_and_field() {
    let script = "import json, numpy, sys, trifacet\n\
                  layout = trifacet.dtype()\n\
                  fields = [[n, layout.fields[n][1], layout[n].base.str, int(numpy.prod(layout[n].shape))] for n in layout.names]\n\
                  print(json.dumps([trifacet.STATUS_BITS, trifacet.LOCK_STATES, fields]))";
    let output = succeeded(python_with_packages().args(["-c", script]), "the tables of Python");
    let told: Value = serde_json::from_slice(&output.stdout).unwrap();
    let bits: Vec<_> = Status::NAMES.iter().map(|(_, name)| *name).collect();
    let locks: Vec<_> = LockState::ALL.iter().map(|l| l.name()).collect();
    let fields: Vec<_> = FIELDS.iter().map(|f| numpy(f.name, f.offset, f.kind, f.count)).collect();
    assert_eq!(told, json!([bits, locks, fields]));
}

/// A field in the notation of NumPy.
fn numpy(name: &str, offset: u16, kind: &str, count: u16) -> Value {
    let (class, bits) = kind.split_at(1);
    let bytes = bits.parse::<u16>().unwrap() / 8;
    match (name, bytes) {
        ("magic", _) => json!([name, offset, "|S4", 1]),
        (_, 1) => json!([name, offset, format!("|{class}1"), count]),
        _ => json!([name, offset, format!("<{class}{bytes}"), count]),
    }
}

#[test]
fn numpy_views_of_frames_agree_with_the_decoder_of_the_module() {
    let script = "import numpy, sys, trifacet\n\
                  data = open(sys.argv[1], 'rb').read()\n\
                  array = numpy.frombuffer(data, trifacet.dtype())\n\
                  frames = [trifacet.Frame.decode(data[i:i + 192]) for i in range(0, len(data), 192)]\n\
                  for name in trifacet.Frame._fields:\n    \
                      numpy.testing.assert_array_equal(array[name], numpy.array([getattr(f, name) for f in frames]), name)\n\
                  invalid = array[array['status'] & trifacet.POSE_VALID == 0]\n\
                  assert len(array) == 600 and 0 < len(invalid) < 600 and numpy.isnan(invalid['position']).all()\n";
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), datagrams().concat()).unwrap();
    assert!(datagrams().iter().all(|d| d.len() == FRAME_SIZE));
    succeeded(python_with_packages().args(["-c", script]).arg(file.path()), "the view of NumPy");
}

#[test]
fn c_knows_every_status_bit_and_lock_state() {
    let header = read("clients/c/trifacet.h");
    let bits: Vec<_> = header
        .lines()
        .filter_map(|line| line.strip_prefix("#define TRIFACET_")?.split_once("(UINT32_C(1) << "))
        .map(|(name, bit)| (name.trim().to_owned(), bit.trim_end_matches(')').parse::<u32>().unwrap()))
        .collect();
    let coded: Vec<_> =
        Status::NAMES.iter().map(|(bit, name)| ((*name).to_owned(), bit.0.trailing_zeros())).collect();
    assert_eq!(bits, coded);
    let locks: Vec<_> = header
        .lines()
        .filter_map(|line| {
            line.trim().strip_prefix("TRIFACET_LOCK_")?.trim_end_matches(',').split_once(" = ")
        })
        .map(|(name, number)| (name.to_lowercase(), number.parse::<u8>().unwrap()))
        .collect();
    let coded: Vec<_> = LockState::ALL.iter().map(|l| (l.name().to_owned(), *l as u8)).collect();
    assert_eq!(locks, coded);
}
