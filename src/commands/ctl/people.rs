//! The answer of the daemon as lines for a person.

use serde_json::{Map, Value};

/// Units at the ends of keys, longest first, and as a person writes them.
const UNITS: [(&str, &str); 11] = [
    ("_um_per_s", "um/s"),
    ("_per_s", "1/s"),
    ("_bytes", "bytes"),
    ("_deg", "deg"),
    ("_rad", "rad"),
    ("_um", "um"),
    ("_mm", "mm"),
    ("_ms", "ms"),
    ("_hz", "Hz"),
    ("_m", "m"),
    ("_s", "s"),
];
/// Column at which values begin, after the indentation.
const VALUES: usize = 20;
/// Width of a terminal.
const WIDTH: usize = 79;

/// One line for each value; nested objects are indented. Unknown values and counters that are zero are omitted.
pub(super) fn lines(answer: &Value) -> String {
    let mut text = String::new();
    if let Value::Object(all) = answer {
        object(all, 0, &mut text);
    }
    if text.is_empty() { "done\n".into() } else { text }
}

fn object(all: &Map<String, Value>, depth: usize, text: &mut String) {
    let mut all: Vec<_> = all.iter().collect();
    // Values before sections, and the long list of counters at the end.
    all.sort_by_key(|(key, value)| (value.is_object(), key.as_str() == "counters"));
    for (key, value) in all {
        match value {
            Value::Object(inner) => section(key, depth, text, |text| object(inner, depth + 1, text)),
            Value::Array(items) if items.iter().any(Value::is_object) => section(key, depth, text, |text| {
                for item in items.iter().filter_map(Value::as_object) {
                    object(item, depth + 1, text);
                }
            }),
            value => {
                if let Some(shown) = plain(value).filter(|shown| key != "counters" && !shown.is_empty()) {
                    line(key, &shown, depth, text);
                }
            }
        }
    }
}

/// A title with its contents, if there are any. Of the counters only those that count something.
fn section(key: &str, depth: usize, text: &mut String, contents: impl FnOnce(&mut String)) {
    let mut inside = String::new();
    contents(&mut inside);
    if key == "counters" {
        inside = inside.split_inclusive('\n').filter(|line| !line.ends_with(" 0\n")).collect();
    }
    if !inside.is_empty() {
        text.extend([" ".repeat(2 * depth).as_str(), key, "\n", &inside]);
    }
}

fn line(key: &str, value: &str, depth: usize, text: &mut String) {
    let (name, unit) = UNITS
        .iter()
        .find_map(|(end, unit)| Some((key.strip_suffix(end)?, format!(" {unit}"))))
        .unwrap_or((key, String::new()));
    let (indent, start) = (2 * depth, VALUES + 2 * depth);
    let name = name.replace('_', " ");
    let mut row = format!("{:indent$}{name:<width$}", "", width = VALUES.max(name.len() + 1));
    let mut column = row.len();
    for word in format!("{value}{unit}").split(' ') {
        if column + word.len() > WIDTH && column > start {
            row = format!("{}\n{:start$}", row.trim_end(), "");
            column = start;
        }
        row += word;
        row.push(' ');
        column += word.len() + 1;
    }
    *text += row.trim_end();
    text.push('\n');
}

/// A value in a line; `None` if it is unknown.
fn plain(value: &Value) -> Option<String> {
    match value {
        Value::Null | Value::Object(_) => None,
        Value::Bool(yes) => Some(if *yes { "yes" } else { "no" }.into()),
        Value::Number(number) if number.is_f64() => number.as_f64().map(short),
        Value::Number(number) => Some(number.to_string()),
        Value::String(text) => Some(text.clone()),
        Value::Array(items) => Some(items.iter().filter_map(plain).collect::<Vec<_>>().join(", ")),
    }
}

/// Six significant digits.
fn short(x: f64) -> String {
    let rounded: f64 = format!("{x:.5e}").parse().unwrap_or(x);
    if rounded != 0.0 && !(1e-4..1e7).contains(&rounded.abs()) {
        format!("{rounded:e}")
    } else {
        rounded.to_string()
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn an_answer_fits_a_terminal_and_omits_what_is_unknown() {
        let answer = json!({
            "uptime_s": 12.345_678_9,
            "replay": null,
            "loop": { "mode": "on", "offset_um": [0.123_456_789, -1e-7], "shadow": null },
            "doubts": [{ "subject": "power", "text": "the total power differs from its reference by so much that it \
                is doubted, and this text is longer than one line of a terminal" }],
            "counters": { "samples": 1000, "lost": 0 },
            "receivers": [],
        });
        let text = lines(&answer);
        assert!(text.lines().all(|line| line.len() <= WIDTH && line == line.trim_end()), "{text}");
        for wanted in [
            "uptime              12.3457 s\n",
            "  mode                on\n",
            "  offset              0.123457, -1e-7 um\n",
            "counters\n  samples             1000\n",
            "  text                the total power",
        ] {
            assert!(text.contains(wanted), "{wanted:?}: {text}");
        }
        assert!(
            !["replay", "shadow", "lost", "receivers"].iter().any(|absent| text.contains(absent)),
            "{text}"
        );
        assert_eq!(lines(&json!({})), "done\n");
    }
}
