//! Finds the place of a key in the text of a TOML file, and the key at a place.

use std::ops::Range;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

pub use crate::text::Place;

/// The place of a byte offset in the text.
pub(super) fn place(text: &str, at: usize) -> Place {
    let before = text.get(..at).unwrap_or(text);
    let line_start = before.rfind('\n').map_or(0, |i| i + 1);
    Place { line: before.matches('\n').count() + 1, column: before[line_start..].chars().count() + 1 }
}

/// What the file contains at a dotted path such as `twin.motion[1].amount_um`.
#[derive(Debug, PartialEq)]
pub(super) enum Found {
    /// The byte range of the value.
    Value(Range<usize>),
    /// A section, with the byte range of its header. `whole`: the path is that of the section; otherwise it
    /// is that of a key that the section does not contain. `None`: the file does not contain the section
    /// either.
    Section { span: Option<Range<usize>>, whole: bool },
}

/// Follows a dotted path through the file.
pub(super) fn find(file: &DeValue<'_>, path: &str) -> Found {
    let mut value = file;
    let mut span = None;
    for step in path.split(['.', '[', ']']).filter(|step| !step.is_empty()) {
        let next = match step.parse::<usize>() {
            Ok(index) => value.get(index),
            Err(_) => value.get(step),
        };
        let Some(next) = next else { return Found::Section { span, whole: false } };
        span = Some(next.span());
        value = next.get_ref();
    }
    match (value, span) {
        (DeValue::Table(_), span) => Found::Section { span, whole: true },
        (_, Some(span)) => Found::Value(span),
        (_, None) => Found::Section { span: None, whole: false },
    }
}

/// The dotted path of the innermost key whose name or value covers a byte offset.
pub(super) fn path_at(file: &DeValue<'_>, at: usize) -> Option<String> {
    let inside = |name: String, child: &Spanned<DeValue<'_>>, named: bool| {
        if let Some(deeper) = path_at(child.get_ref(), at) {
            let dot = if deeper.starts_with('[') { "" } else { "." };
            return Some(format!("{name}{dot}{deeper}"));
        }
        (named || child.span().contains(&at)).then_some(name)
    };
    match file {
        DeValue::Table(table) => {
            table.iter().find_map(|(key, child)| inside(key.to_string(), child, key.span().contains(&at)))
        }
        DeValue::Array(array) => {
            array.iter().enumerate().find_map(|(i, child)| inside(format!("[{i}]"), child, false))
        }
        _ => None,
    }
}

/// Removes the innermost entry whose name or value covers a byte offset. Returns whether there is one.
pub(super) fn remove_at(table: &mut DeTable<'_>, at: usize) -> bool {
    if table.iter_mut().any(|(_, child)| remove_within(child.get_mut(), at)) {
        return true;
    }
    let covers =
        |(key, child): &(&Spanned<_>, &Spanned<_>)| key.span().contains(&at) || child.span().contains(&at);
    let name = table.iter().find(covers).map(|(key, _)| key.to_string());
    name.is_some_and(|name| table.remove(name.as_str()).is_some())
}

fn remove_within(value: &mut DeValue<'_>, at: usize) -> bool {
    match value {
        DeValue::Table(table) => remove_at(table, at),
        DeValue::Array(array) => array.iter_mut().any(|element| remove_within(element.get_mut(), at)),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use toml::de::DeTable;

    use super::*;

    const TEXT: &str =
        "[head]\nsize = 13 # ä\n[twin]\nx.y = [1, 2]\n[[twin.motion]]\na = 1\n[[twin.motion]]\na = 22\n";

    fn file() -> DeValue<'static> {
        DeValue::Table(DeTable::parse(TEXT).expect("valid TOML").into_inner())
    }

    #[test]
    fn a_path_leads_to_its_value_and_back() {
        for (path, value) in
            [("head.size", "13"), ("twin.x.y[1]", "2"), ("twin.motion[0].a", "1"), ("twin.motion[1].a", "22")]
        {
            let Found::Value(span) = find(&file(), path) else { panic!("{path} not found") };
            assert_eq!(&TEXT[span.clone()], value);
            assert_eq!(path_at(&file(), span.start).as_deref(), Some(path));
        }
    }

    #[test]
    fn an_absent_key_leads_to_its_section() {
        let Found::Section { span: Some(span), whole: false } = find(&file(), "twin.motion[1].b") else {
            panic!("a section")
        };
        assert_eq!(place(TEXT, span.start), Place { line: 7, column: 1 });
        assert_eq!(find(&file(), "steering.limit_um"), Found::Section { span: None, whole: false });
    }
}
