//! Checks values against their allowed ranges.
//!
//! Every check goes through a [`Checker`]. It has the dotted path of its section, and it collects all
//! problems.

use std::collections::BTreeMap;
use std::fmt::{Debug, Display};
use std::ops::{Bound, RangeBounds};

/// A value that is not allowed, not yet located in the file.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Finding {
    /// Dotted paths of keys: first the wrong key, then the keys that it conflicts with.
    pub keys: Vec<String>,
    /// The value after parsing.
    pub found: String,
    /// The values that are allowed instead.
    pub allowed: String,
}

/// Results of all checks.
#[derive(Default)]
pub(super) struct Report {
    pub findings: Vec<Finding>,
    /// Some values could not be read, and have their defaults.
    pub incomplete: bool,
    /// Allowed values by dotted path, with `[]` for any index.
    pub rules: BTreeMap<String, String>,
}

/// Checks the values of one section.
pub(super) struct Checker<'a> {
    path: String,
    report: &'a mut Report,
}

impl<'a> Checker<'a> {
    /// The checker for the whole file.
    pub(super) fn root(report: &'a mut Report) -> Self {
        Self { path: String::new(), report }
    }

    /// A checker for a subsection, such as `head` or `motion[1]`.
    pub(super) fn section(&mut self, name: &str) -> Checker<'_> {
        Checker { path: self.join(name), report: self.report }
    }

    /// Checks that a number is finite and within a range.
    pub(super) fn number<T>(&mut self, key: &str, value: T, allowed: impl RangeBounds<f64>)
    where
        T: Into<f64> + Debug,
    {
        self.optional(key, Some(value), allowed);
    }

    /// Like [`Checker::number`], for a key that may be absent.
    pub(super) fn optional<T>(&mut self, key: &str, value: Option<T>, allowed: impl RangeBounds<f64>)
    where
        T: Into<f64> + Debug,
    {
        let rule = range_text(&allowed);
        if let Some(value) = value {
            let found = format!("{value:?}");
            // NaN is outside every range. An infinity is outside every bounded range.
            if !allowed.contains(&value.into()) {
                self.wrong(key, found, &rule);
            }
        }
        self.rule(key, rule);
    }

    /// Checks that every number of an array is finite and within a range.
    pub(super) fn numbers(&mut self, key: &str, values: &[f64], allowed: impl RangeBounds<f64> + Clone) {
        self.rule(key, format!("{}, each", range_text(&allowed)));
        for (i, value) in values.iter().enumerate() {
            self.number(&format!("{key}[{i}]"), *value, allowed.clone());
        }
    }

    /// Like [`Checker::numbers`], for a key that may be absent.
    pub(super) fn optional_numbers<R>(&mut self, key: &str, values: Option<&[f64]>, allowed: R)
    where
        R: RangeBounds<f64> + Clone,
    {
        self.numbers(key, values.unwrap_or_default(), allowed);
    }

    /// Checks a vector of which only the direction is used.
    pub(super) fn direction(&mut self, key: &str, value: Option<[f64; 3]>) {
        let rule = "three finite numbers, not all zero; only their direction counts";
        self.rule(key, rule);
        if let Some(v) = value {
            let norm = v[0].hypot(v[1]).hypot(v[2]);
            if !(norm.is_finite() && norm > 1e-9) {
                self.wrong(key, format!("{v:?}"), rule);
            }
        }
    }

    /// Checks a condition that is not a range: reports `found` and `allowed` unless `fine`.
    pub(super) fn demand(&mut self, fine: bool, key: &str, found: impl Display, allowed: impl Display) {
        if !fine {
            self.wrong(key, found, allowed);
        }
    }

    /// Like [`Checker::demand`], for a conflict between keys: if `key` is not in the file, the message
    /// points to the first of `others` that is.
    pub(super) fn agree(
        &mut self,
        fine: bool,
        key: &str,
        others: &[&str],
        found: impl Display,
        allowed: impl Display,
    ) {
        if !fine {
            let keys = std::iter::once(&key).chain(others).map(|key| self.join(key)).collect();
            let finding = Finding { keys, found: found.to_string(), allowed: allowed.to_string() };
            self.report.findings.push(finding);
        }
    }

    /// Whether all values could be read and no check has failed so far. Otherwise follow-up checks on several
    /// values are skipped.
    pub(super) fn clean(&self) -> bool {
        self.report.findings.is_empty() && !self.report.incomplete
    }

    fn wrong(&mut self, key: &str, found: impl Display, allowed: impl Display) {
        self.agree(false, key, &[], found, allowed);
    }

    fn rule(&mut self, key: &str, rule: impl Into<String>) {
        self.report.rules.insert(without_index(&self.join(key)), rule.into());
    }

    fn join(&self, key: &str) -> String {
        match (self.path.as_str(), key) {
            ("", key) => key.into(),
            (path, "") => path.into(),
            (path, key) => format!("{path}.{key}"),
        }
    }
}

/// The range above zero, up to and including `most`.
pub(super) fn above_zero(most: f64) -> (Bound<f64>, Bound<f64>) {
    (Bound::Excluded(0.0), Bound::Included(most))
}

/// Removes indices: `twin.motion[1].amount_um` becomes `twin.motion[].amount_um`.
pub(super) fn without_index(path: &str) -> String {
    let mut out = String::new();
    let mut inside = false;
    for c in path.chars() {
        inside = inside && c != ']';
        if !inside {
            out.push(c);
        }
        inside = inside || c == '[';
    }
    out
}

fn range_text(range: &impl RangeBounds<f64>) -> String {
    match (range.start_bound(), range.end_bound()) {
        (Bound::Included(lo), Bound::Included(hi)) => format!("{lo} to {hi}"),
        (Bound::Excluded(lo), Bound::Included(hi)) => format!("more than {lo}, at most {hi}"),
        (lo, hi) => format!("{lo:?} to {hi:?}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nan_and_infinity_are_refused_by_every_range() {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -1.0, 0.0, 2.5] {
            let mut report = Report::default();
            Checker::root(&mut report).section("a").number("b", bad, above_zero(2.0));
            assert_eq!(report.findings.len(), 1, "{bad}");
            assert_eq!(report.findings[0].keys, ["a.b"]);
            assert_eq!(report.findings[0].allowed, "more than 0, at most 2");
        }
    }

    #[test]
    fn a_rule_holds_for_every_index() {
        assert_eq!(without_index("twin.motion[12].amount_um[0]"), "twin.motion[].amount_um[]");
    }
}
