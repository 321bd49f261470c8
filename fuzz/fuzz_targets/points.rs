//! Files of points and of scans of a calibration: read or refused with a message; what is read is in its range.

#![no_main]

use std::io::Write;
use std::path::PathBuf;

use libfuzzer_sys::fuzz_target;
use trifacet::calibration::{Defaults, Measured};

fuzz_target!(|bytes: &[u8]| {
    let mut file = tempfile::NamedTempFile::new().expect("a file");
    file.write_all(bytes).expect("room");
    let files = [file.path().to_owned()];
    let own_zero = bytes.len() % 2 == 0;
    read(&files, &[], own_zero);
    read(&[], &files, own_zero);
    read(&files, &files, own_zero);
});

fn read(points: &[PathBuf], scans: &[PathBuf], own_zero: bool) {
    let defaults = Defaults { spot: 1e-7, power: 1e-4, readback: 1e-7, own_zero };
    match Measured::read(points, scans, defaults) {
        Ok(measured) => valid(&measured),
        Err(failure) => assert!(!failure.to_string().is_empty()),
    }
}

fn valid(measured: &Measured) {
    let number = measured.points.len();
    assert!(number > 0 && measured.scans <= number);
    assert_eq!((measured.lines.len(), measured.times.len()), (number, number));
    assert!(measured.times.iter().flatten().all(|time| time.is_finite()));
    for (k, point) in measured.points.iter().enumerate() {
        assert!(!measured.place(k).is_empty());
        assert!(point.spots.iter().all(|x| x.is_nan() || x.abs() <= 10.0));
        assert!(point.powers.iter().all(|power| !power.is_infinite()));
        assert!(point.spot_deviations.iter().all(|x| x.is_finite() && *x > 0.0));
        let known = point.reference.iter().flatten().chain(point.steering.iter().flatten());
        for known in known {
            assert!(known.value.abs() <= 10.0 && known.deviation.is_finite() && known.deviation > 0.0);
        }
    }
}
