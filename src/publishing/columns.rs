//! A frame as named values in SI units, for JSON and CSV.

use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};
use trifacet_wire::frame::{CLOCK_UNKNOWN, PoseFrame};
use trifacet_wire::layout::{BEAM, DEVIATIONS, POSE, POWERS, SPOTS, STEERING, SYSTEMATIC};

/// The value of a column.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// A number; NaN if unknown.
    Number(f64),
    /// A signed integer, such as a time.
    Integer(i64),
    /// An unsigned integer, such as a count.
    Count(u64),
    /// A text.
    Text(String),
    /// A list of names.
    Names(Vec<&'static str>),
}

/// The values of a frame with their names, in order.
#[derive(Clone, Debug, PartialEq)]
pub struct Columns(pub Vec<(&'static str, Value)>);

impl Columns {
    /// All values of a frame.
    pub fn of(frame: &PoseFrame) -> Self {
        let clock_sigma = match frame.clock_quality {
            CLOCK_UNKNOWN => f64::NAN,
            tenths_us => f64::from(tenths_us) * 1e-7,
        };
        let mut columns = vec![
            ("sequence", Value::Count(frame.sequence)),
            ("sample_index", Value::Count(frame.sample_index)),
            ("time", Value::Text(rfc3339(frame.time_ns))),
            ("time_ns", Value::Integer(frame.time_ns)),
            ("lock", Value::Text(frame.lock.name().into())),
            ("status", Value::Names(frame.status.names().collect())),
            ("status_bits", Value::Count(frame.status.0.into())),
        ];
        columns.extend(named(POSE, frame.pose));
        columns.extend(singles(DEVIATIONS, frame.deviations));
        columns.extend(singles(BEAM, frame.beam_offset));
        columns.extend(singles(["steering_residual_m"], [frame.steering_residual]));
        columns.extend(singles(SPOTS, frame.spots));
        columns.extend(singles(POWERS, frame.powers));
        columns.extend(singles(STEERING, frame.steering));
        columns.extend([
            ("averaged", Value::Count(frame.averaged.into())),
            ("lost", Value::Count(frame.lost.into())),
            ("iterations", Value::Count(frame.iterations.into())),
            ("solve_delay_ns", Value::Count(frame.solve_delay_ns.into())),
            ("send_delay_ns", Value::Count(frame.send_delay_ns.into())),
            ("clock_sigma_s", Value::Number(clock_sigma)),
            ("session", Value::Count(frame.session.into())),
            ("config", Value::Count(frame.config.into())),
        ]);
        columns.extend(singles(SYSTEMATIC, frame.systematic.unwrap_or([f32::NAN; 6])));
        Self(columns)
    }

    /// The named columns in the order of `names`; all columns if `names` is `None`.
    #[must_use]
    pub fn select(self, names: Option<&[&'static str]>) -> Self {
        let Some(names) = names else { return self };
        let of = |name: &&str| self.0.iter().find(|(n, _)| n == name).cloned();
        Self(names.iter().filter_map(of).collect())
    }

    /// The names, as the header line of a CSV file.
    pub fn csv_header(&self) -> String {
        self.0.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(",")
    }

    /// The values, as a line of a CSV file, each as [`Value::csv`] writes it.
    pub fn csv_line(&self) -> String {
        self.0.iter().map(|(_, value)| value.csv()).collect::<Vec<_>>().join(",")
    }
}

impl Value {
    /// The value as a CSV field: numbers with 17 digits, unknown values empty, names separated by spaces.
    pub fn csv(&self) -> String {
        match self {
            Self::Number(x) if x.is_nan() => String::new(),
            Self::Number(x) => format!("{x:.16e}"),
            Self::Integer(x) => x.to_string(),
            Self::Count(x) => x.to_string(),
            Self::Text(word) => word.clone(),
            Self::Names(words) => words.join(" "),
        }
    }
}

/// The column that many readers of JSON cannot represent: they read numbers as 64-bit floating point, which
/// holds integers up to 2^53 exactly.
const LARGE: &str = "time_ns";
/// The same value as a text.
const LARGE_AS_TEXT: &str = "time_ns_text";

/// A JSON object. Unknown and infinite values are `null`, since JSON cannot represent them. `time_ns` is
/// followed by the same value as a text, `time_ns_text`.
impl Serialize for Columns {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        for (name, value) in &self.0 {
            match value {
                Value::Number(x) => map.serialize_entry(name, x)?,
                Value::Integer(x) => map.serialize_entry(name, x)?,
                Value::Count(x) => map.serialize_entry(name, x)?,
                Value::Text(word) => map.serialize_entry(name, word)?,
                Value::Names(words) => map.serialize_entry(name, words)?,
            }
            if *name == LARGE {
                map.serialize_entry(LARGE_AS_TEXT, &value.csv())?;
            }
        }
        map.end()
    }
}

fn named<const N: usize>(
    names: [&'static str; N],
    values: [f64; N],
) -> impl Iterator<Item = (&'static str, Value)> {
    names.into_iter().zip(values.map(Value::Number))
}

fn singles<const N: usize>(
    names: [&'static str; N],
    values: [f32; N],
) -> impl Iterator<Item = (&'static str, Value)> {
    named(names, values.map(f64::from))
}

/// A time in nanoseconds since 1970 (UTC) in RFC 3339 format: "2026-11-21T12:00:00.000000001Z".
pub fn rfc3339(ns: i64) -> String {
    // Always within range: 64 bits of nanoseconds cover the years 1677 to 2262.
    jiff::Timestamp::from_nanosecond(ns.into()).map(|t| format!("{t:.9}")).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use trifacet_core::estimation::PoseReport;
    use trifacet_core::stamp::Stamp;
    use trifacet_core::time::Mono;
    use trifacet_wire::layout::COLUMNS;

    use super::*;

    fn frame() -> PoseFrame {
        let time_ns = 1_795_262_400_000_000_001;
        let stamp =
            Stamp { session: 1, config: 2, sequence: 3, time_ns, synced: true, sent: Mono(1_090_000) };
        PoseFrame { beam_offset: [f32::NAN, 1e-6], ..PoseReport::example().frame(stamp) }
    }

    #[test]
    fn json_has_null_for_unknown_numbers() {
        let json: serde_json::Value = serde_json::to_value(Columns::of(&frame())).unwrap();
        assert_eq!(json["time"], "2026-11-21T12:00:00.000000001Z");
        assert_eq!(json["time_ns"], 1_795_262_400_000_000_001_i64);
        assert_eq!(json["time_ns_text"], "1795262400000000001");
        assert_eq!(json["tx_m"], 1e-6);
        assert!(json["beam_dx_m"].is_null());
        assert_eq!(json["status"], serde_json::json!(["POSE_VALID", "SIMULATED"]));
        assert_eq!(json["lock"], "locked");
    }

    #[test]
    fn the_list_of_names_is_that_of_the_columns() {
        let columns = Columns::of(&frame());
        assert_eq!(columns.0.iter().map(|(name, _)| *name).collect::<Vec<_>>(), COLUMNS);
        let few = columns.select(Some(&["tz_m", "sequence"]));
        assert_eq!(few.csv_header(), "tz_m,sequence");
    }

    #[test]
    fn csv_keeps_all_digits_and_leaves_unknown_numbers_empty() {
        let columns = Columns::of(&frame());
        let header = columns.csv_header();
        let line = columns.csv_line();
        let row: std::collections::HashMap<&str, &str> = header.split(',').zip(line.split(',')).collect();
        assert_eq!(row.len(), columns.0.len());
        assert_eq!(row["yaw_rad"].parse::<f64>().unwrap(), 6e-6);
        assert_eq!(row["power_a_w"].parse::<f32>().unwrap(), (0.8e-3_f64 / 3.0) as f32);
        assert_eq!(row["beam_dx_m"], "");
        assert_eq!(row["status"], "POSE_VALID SIMULATED");
    }
}
