//! Values against what is allowed. Every check goes through a [`Checker`], which knows the dotted path
//! of the section it stands in and collects all problems, not just the first.

use std::collections::BTreeMap;
use std::fmt::{Debug, Display};
use std::ops::{Bound, RangeBounds};

/// A value that is not allowed: not yet located in the file.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Finding {
    /// Dotted path of the key; the first one is the culprit, the others are those it clashes with.
    pub keys: Vec<String>,
    /// The value, as the program sees it.
    pub found: String,
    /// What is allowed instead.
    pub allowed: String,
}

/// What the checks found, and what they allow.
#[derive(Default)]
pub(super) struct Report {
    pub findings: Vec<Finding>,
    /// What is allowed, by dotted path with `[]` for any index.
    pub rules: BTreeMap<String, String>,
}

/// Checks the values of one section.
pub(super) struct Checker<'a> {
    path: String,
    report: &'a mut Report,
}

impl<'a> Checker<'a> {
    /// The checker of the whole file.
    pub(super) fn root(report: &'a mut Report) -> Self {
        Self { path: String::new(), report }
    }

    /// The checker of a section of this one: `head`, or `motion[1]`.
    pub(super) fn section(&mut self, name: &str) -> Checker<'_> {
        Checker { path: self.join(name), report: self.report }
    }

    /// A number must be finite and within a range.
    pub(super) fn number<T>(&mut self, key: &str, value: T, allowed: impl RangeBounds<f64>)
    where
        T: Into<f64> + Debug,
    {
        self.optional(key, Some(value), allowed);
    }

    /// As [`Checker::number`], for a key that may be absent.
    pub(super) fn optional<T>(&mut self, key: &str, value: Option<T>, allowed: impl RangeBounds<f64>)
    where
        T: Into<f64> + Debug,
    {
        let rule = range_text(&allowed);
        if let Some(value) = value {
            let found = format!("{value:?}");
            // NaN is in no range, and infinities are beyond every bound.
            if !allowed.contains(&value.into()) {
                self.wrong(key, found, &rule);
            }
        }
        self.rule(key, rule);
    }

    /// Every number of an array must be finite and within a range.
    pub(super) fn numbers(&mut self, key: &str, values: &[f64], allowed: impl RangeBounds<f64> + Clone) {
        self.rule(key, format!("{}, each", range_text(&allowed)));
        for (i, value) in values.iter().enumerate() {
            self.number(&format!("{key}[{i}]"), *value, allowed.clone());
        }
    }

    /// As [`Checker::numbers`], for a key that may be absent.
    pub(super) fn optional_numbers<R>(&mut self, key: &str, values: Option<&[f64]>, allowed: R)
    where
        R: RangeBounds<f64> + Clone,
    {
        self.numbers(key, values.unwrap_or_default(), allowed);
    }

    /// A vector that only gives a direction.
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

    /// Something that is no range: demanded to be `fine`.
    pub(super) fn demand(&mut self, fine: bool, key: &str, found: impl Display, allowed: impl Display) {
        if !fine {
            self.wrong(key, found, allowed);
        }
    }

    /// As [`Checker::demand`], for a clash: if `key` is not in the file, the first of `others` that is
    /// there is shown instead.
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

    /// Whether no check has failed so far: what rests on several values need not be said twice.
    pub(super) fn clean(&self) -> bool {
        self.report.findings.is_empty()
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

/// More than nothing, up to and including `most`.
pub(super) fn above_zero(most: f64) -> (Bound<f64>, Bound<f64>) {
    (Bound::Excluded(0.0), Bound::Included(most))
}

/// `twin.motion[1].amount_um` becomes `twin.motion[].amount_um`.
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
    fn numbers_that_are_none_are_refused_by_every_range() {
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
