//! A calibration record: as JSON, as fields that replace those of a complete record, and the bytes of its covariance.
//! What is accepted gives uncertainties without a panic.

#![no_main]

use std::io::Write;
use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use serde_json::Value;
use trifacet::calibration::{Record, nominal};
use trifacet::config::{Config, RecordHeader, SharedSpread};
use trifacet::optics::Pose;
use trifacet::optics::calibration::cholesky::Factor;
use trifacet::optics::calibration::linearised::Layout;
use trifacet::optics::calibration::map::{Field, Lattice};
use trifacet::optics::calibration::parameters::Tolerances;
use trifacet::optics::calibration::result::{Calibration, RangeUncertainty};

/// A complete record without splines: a fuzzer does not find its hundreds of kilobytes.
static COMPLETE: LazyLock<Value> = LazyLock::new(|| {
    let record = complete();
    read(record.to_string().as_bytes()).expect("the complete record is accepted and has a range");
    record
});

fuzz_target!(|bytes: &[u8]| {
    if let Some(spread) = SharedSpread::from_bytes(bytes) {
        spread.0.zero(&Pose::default(), &[0.0; 6]);
    }
    read(bytes);
    let Ok(fields @ Value::Object(_)) = serde_json::from_slice(bytes) else { return };
    let mut record = COMPLETE.clone();
    replace(&mut record, fields);
    read(record.to_string().as_bytes());
});

/// Replaces fields at any depth.
fn replace(old: &mut Value, new: Value) {
    match (old, new) {
        (Value::Object(old), Value::Object(new)) => {
            for (name, value) in new {
                replace(old.entry(name).or_insert(Value::Null), value);
            }
        }
        (old, new) => *old = new,
    }
}

/// What the record says of its range, if it is accepted.
fn read(text: &[u8]) -> Option<RangeUncertainty> {
    let mut file = tempfile::NamedTempFile::new().expect("a file");
    file.write_all(text).expect("room");
    let _ = RecordHeader::open(file.path());
    let _ = SharedSpread::open(file.path());
    let record = Record::open(file.path()).ok()?;
    let calibration = record.calibration().ok()?;
    let _ = (calibration.base_and_tool(), calibration.deviations());
    let _ = calibration.correction(0, [1e-3, -1e-3]);
    let range = [record.header.range_mm * 1e-3, record.header.range_mrad * 1e-3];
    calibration.range_uncertainty(range[0], range[1], 2)
}

fn complete() -> Value {
    let nominal = nominal(&Config::default()).expect("the default is a head");
    let field = Field { knots: 1e-3, rms: 1e-6, length: 1e-3 };
    let lattices = [0, 1, 2].map(|_| Lattice::of_cells(field.knots, 5e-3, Vec::new()));
    let layout = Layout { runs: 0, lattices, half_sizes: [5e-3; 3] };
    let n = layout.parameters();
    let identity: Vec<f64> = (0..n).flat_map(|j| (j..n).map(move |i| f64::from(i == j))).collect();
    let factor = Factor::from_parts(&identity, vec![1e6; n]).expect("of the right size");
    let theta = vec![0.0; n];
    let calibration =
        Calibration { nominal, tolerances: Tolerances::default(), layout, field, theta, factor };
    let header = RecordHeader {
        format: trifacet::config::FORMAT,
        version: "0.1.0".into(),
        date: "2026-05-04T12:00:00Z".into(),
        method: "six-axis stage".into(),
        fits: "00".into(),
        range_mm: 1.0,
        range_mrad: 5.0,
        std_um: [0.1; 3],
        std_urad: [0.3; 3],
        expires: None,
        at_calibration: None,
    };
    serde_json::to_value(Record::new(header, &calibration, Value::Null)).expect("a record can be written")
}
