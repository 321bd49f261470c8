//! A sample as a row of a table.

use trifacet::publishing::columns::Value;
use trifacet_core::centering::LoopState;
use trifacet_core::signals::{PsdState, Sample, Scan};
use trifacet_wire::layout::{POWERS, SPOTS};

use super::Row;

const CODES: [&str; 16] = [
    "code_0", "code_1", "code_2", "code_3", "code_4", "code_5", "code_6", "code_7", "code_8", "code_9",
    "code_10", "code_11", "code_12", "code_13", "code_14", "code_15",
];
const PSDS: [&str; 3] = ["psd_a", "psd_b", "psd_c"];
const STEERING: [&str; 2] = ["steering_x_m", "steering_y_m"];
const COMMANDED: [&str; 2] = ["commanded_x_m", "commanded_y_m"];

pub(super) fn row(scan: &Scan, sample: &Sample, steering: &LoopState) -> Row {
    let numbers = |names: &[&'static str], values: &[f64]| -> Row {
        names.iter().copied().zip(values.iter().map(|x| Value::Number(*x))).collect()
    };
    let known = |pair: Option<[f64; 2]>| pair.unwrap_or([f64::NAN; 2]);
    let mut row = vec![
        ("sample_index", Value::Count(scan.index)),
        ("monotonic_ns", Value::Integer(scan.time.0)),
        ("time_sigma_s", Value::Number(scan.time_sigma_ns.map_or(f64::NAN, |ns| ns * 1e-9))),
        ("lost", Value::Count(sample.lost.into())),
        ("lock", Value::Text(steering.lock.name().into())),
        ("output_railed", Value::Count(scan.output_railed.into())),
    ];
    row.extend(CODES.into_iter().zip(scan.codes.map(|code| Value::Integer(code.into()))));
    row.extend(numbers(&SPOTS, &sample.spots));
    row.extend(numbers(&POWERS, &sample.powers));
    row.extend(PSDS.into_iter().zip(sample.psds.map(|psd| Value::Text(name(psd).into()))));
    row.extend(numbers(&STEERING, &known(sample.steering)));
    row.extend(numbers(&COMMANDED, &known(steering.position.map(Into::into))));
    row
}

fn name(psd: PsdState) -> &'static str {
    match psd {
        PsdState::Good => "good",
        PsdState::Low => "low",
        PsdState::Clipped => "clipped",
        PsdState::Frozen => "frozen",
    }
}
