//! Writes single keys into a configuration file and preserves the rest, including comments.

use std::path::Path;

use anyhow::Context as _;
pub use toml_edit::Value;
use toml_edit::{DocumentMut, Item, Table, TableLike};

use super::file::read_regular;
use super::load::{parse, text};
use super::rewrite;

/// A new value for a key, such as `dark_v` in the section `["channels", "a"]`.
#[derive(Clone, Debug)]
pub struct Edit {
    /// Path of the section.
    pub section: &'static [&'static str],
    /// Name of the key.
    pub key: &'static str,
    /// The new value: a number or a list of numbers.
    pub value: Value,
}

/// Ends the file while it is edited. New sections follow it, so that a comment at the end of the file stays in
/// front of them.
const END: &str = "[end-of-the-edited-file]\n";

/// Returns the text of a configuration with the new values. Its line ends are those of most of its lines.
///
/// # Errors
/// Fails if the text is not TOML, or if the path of a section leads to something else.
pub fn edited(text: &str, edits: &[Edit]) -> anyhow::Result<String> {
    let crlf = 2 * text.matches("\r\n").count() > text.matches('\n').count();
    let lf = text.replace("\r\n", "\n");
    let end = if lf.is_empty() || lf.ends_with('\n') { "" } else { "\n" };
    let mut document: DocumentMut = format!("{lf}{end}{END}").parse()?;
    for Edit { section, key, value } in edits {
        let table = subsection(document.as_table_mut(), section)?;
        let mut new = value.clone();
        if let Some(old) = table.get(key).and_then(Item::as_value) {
            *new.decor_mut() = old.decor().clone();
        }
        table.insert(key, Item::Value(new));
    }
    let new = document.to_string().replacen(END, "", 1);
    let new = if text.is_empty() { new.trim_start().to_owned() } else { new };
    Ok(if crlf { new.replace('\n', "\r\n") } else { new })
}

/// The table at the end of a path. Missing tables are created.
fn subsection<'a>(mut table: &'a mut dyn TableLike, path: &[&str]) -> anyhow::Result<&'a mut dyn TableLike> {
    for (depth, name) in (1..).zip(path) {
        let item = table.entry(name).or_insert_with(implicit_table);
        let name = || format!("{} is not a section", path[..depth].join("."));
        table = item.as_table_like_mut().with_context(name)?;
    }
    Ok(table)
}

/// A table that is written only if it has keys of its own.
fn implicit_table() -> Item {
    let mut table = Table::new();
    table.set_implicit(true);
    Item::Table(table)
}

/// Writes new values into a file. Everything else stays: the rest of the text with its line ends, owner, group
/// and permissions of the file, and links to it. Blocks.
///
/// # Errors
/// Fails if the file cannot be read or written, or if the result would not be a valid configuration. The
/// file is then unchanged.
pub fn write(file: &Path, edits: &[Edit]) -> anyhow::Result<()> {
    let bytes = read_regular(file)?;
    let old = text(&bytes, file)?;
    let new = edited(old, edits)?;
    parse(&new, Some(file))?;
    let mark = &bytes[..bytes.len() - old.len()]; // the byte order mark, if there is one
    rewrite::replace(file, &[mark, new.as_bytes()].concat())
}

/// Checks whether [`write()`] could change this file. Changes nothing. Blocks.
///
/// # Errors
/// Fails if the file is not a regular file, or if it cannot be written such that everything else stays.
pub fn check(file: &Path) -> anyhow::Result<()> {
    rewrite::check(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edit(section: &'static [&'static str], key: &'static str, values: [f64; 3]) -> Edit {
        Edit { section, key, value: values.into_iter().collect() }
    }

    #[test]
    fn only_the_values_change() {
        let edits = [
            edit(&["channels", "a"], "dark_v", [1e-3, -2e-3, 3e-3]),
            edit(&["channels", "c"], "dark_v", [0.25, 0.0, -1.235e-4]),
            edit(&["frames", "tare"], "translation_mm", [1e-7, 0.0, -250.0]),
        ];
        let text =
            "# mine\n[channels.a] # first\ngain = [1.0, 1.0, 1.0]\ndark_v = [0.0, 0.0, 0.0]  # old\n[log]\n";
        let new = edited(text, &edits).unwrap();
        assert!(new.starts_with("# mine\n[channels.a] # first\ngain = [1.0, 1.0, 1.0]\n"), "{new}");
        assert!(new.contains("dark_v = [0.001, -0.002, 0.003]  # old\n"), "{new}");
        let config = super::super::parse(&new, None).unwrap();
        assert_eq!(config.channels.c.dark_v, [0.25, 0.0, -1.235e-4]);
        assert_eq!(config.frames.tare.translation_mm, [1e-7, 0.0, -250.0]);
        assert_eq!(edited(&new, &edits).unwrap(), new);
        assert!(super::super::parse(&edited("", &edits).unwrap(), None).is_ok());
    }

    #[test]
    fn a_number_and_a_matrix_go_to_a_section_that_may_be_dotted() {
        let edits = [
            Edit { section: &["centering"], key: "lag_ms", value: 0.25.into() },
            Edit {
                section: &["steering"],
                key: "matrix",
                value: [[0.5, -1.0], [1.0, 0.5]]
                    .into_iter()
                    .map(|row| row.into_iter().collect::<Value>())
                    .collect(),
            },
        ];
        let new = edited("centering.lag_ms = 3 # slow\n", &edits).unwrap();
        let wanted = "centering.lag_ms = 0.25 # slow\n\n[steering]\nmatrix = [[0.5, -1.0], [1.0, 0.5]]\n";
        assert_eq!(new, wanted);
        super::super::parse(&new, None).unwrap();
    }

    #[test]
    fn line_ends_and_a_comment_at_the_end_stay() {
        let edits = [edit(&["frames", "tare"], "rotation_deg", [1.0, 2.0, 3.0])];
        let section = "[frames.tare]\nrotation_deg = [1.0, 2.0, 3.0]\n";
        for (old, new) in [
            ("# mine", format!("# mine\n\n{section}")),
            (
                "[log]\nlevel = 'warn'\n\n# later:\n# x",
                format!("[log]\nlevel = 'warn'\n\n# later:\n# x\n\n{section}"),
            ),
            ("[frames.tare]\nrotation_deg = [0, 0, 0]\n# end", format!("{section}# end\n")),
            ("", section.into()),
        ] {
            assert_eq!(edited(old, &edits).unwrap(), new);
            let crlf = |text: &str| text.replace('\n', "\r\n");
            let expected = if old.contains('\n') { crlf(&new) } else { new.clone() };
            assert_eq!(edited(&crlf(old), &edits).unwrap(), expected);
        }
    }

    #[test]
    fn a_key_that_is_not_a_section_is_reported() {
        let edits = [edit(&["frames", "tare"], "translation_mm", [0.0; 3])];
        let error = edited("frames = 3\n", &edits).unwrap_err().to_string();
        assert!(error.contains("frames is not a section"), "{error}");
    }
}
