//! Writes single keys into a configuration file and preserves the rest, including comments.

use std::fs;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use anyhow::Context as _;
pub use toml_edit::Value;
use toml_edit::{DocumentMut, Item, Table, TableLike};

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

/// Returns the text of a configuration with the new values.
///
/// # Errors
/// Fails if the text is not TOML, or if the path of a section leads to something else.
pub fn edited(text: &str, edits: &[Edit]) -> anyhow::Result<String> {
    let mut document: DocumentMut = text.parse()?;
    for Edit { section, key, value } in edits {
        let table = subsection(document.as_table_mut(), section)?;
        let mut new = value.clone();
        if let Some(old) = table.get(key).and_then(Item::as_value) {
            *new.decor_mut() = old.decor().clone();
        }
        table.insert(key, Item::Value(new));
    }
    Ok(document.to_string())
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

/// Writes new values into a file. The file is replaced atomically: a crash leaves the old or the new
/// content.
///
/// # Errors
/// Fails if the file cannot be read or written, or if the result would not be a valid configuration. The
/// file is then unchanged.
pub fn write(file: &Path, edits: &[Edit]) -> anyhow::Result<()> {
    let text = edited(&fs::read_to_string(file)?, edits)?;
    super::parse(&text, Some(file))?;
    let (target, new) = places(file)?;
    let mut out = fs::File::create(&new)?;
    out.write_all(text.as_bytes())?;
    out.set_permissions(fs::metadata(&target)?.permissions())?;
    out.sync_all()?;
    Ok(fs::rename(&new, &target)?)
}

/// Checks whether [`write()`] could replace this file. Changes nothing.
///
/// # Errors
/// Fails if the file does not exist, or if no new file can be created beside it.
pub fn check(file: &Path) -> io::Result<()> {
    let (_, new) = places(file)?;
    fs::File::create(&new)?;
    fs::remove_file(new)
}

/// Path of the file with links resolved, so that a link stays a link, and path of the new file beside it.
fn places(file: &Path) -> io::Result<(PathBuf, PathBuf)> {
    let target = fs::canonicalize(file)?;
    let new = target.with_added_extension("new");
    Ok((target, new))
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
    fn a_key_that_is_not_a_section_is_reported() {
        let edits = [edit(&["frames", "tare"], "translation_mm", [0.0; 3])];
        let error = edited("frames = 3\n", &edits).unwrap_err().to_string();
        assert!(error.contains("frames is not a section"), "{error}");
    }
}
