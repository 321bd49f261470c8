//! Writes XML: elements, texts, indentation.

use super::super::report::escaped;

/// A document while it is written.
pub(super) struct Xml {
    text: String,
    depth: usize,
}

impl Xml {
    /// A document without a root.
    pub(super) fn new() -> Self {
        Self { text: "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n".to_owned(), depth: 0 }
    }

    /// The document.
    pub(super) fn finish(self) -> String {
        self.text
    }

    /// An element with attributes, which are written as they are.
    pub(super) fn with(&mut self, name: &str, attributes: &str, content: impl FnOnce(&mut Self)) {
        let space = if attributes.is_empty() { "" } else { " " };
        self.line(&format!("<{name}{space}{attributes}>"));
        self.depth += 1;
        content(self);
        self.depth -= 1;
        self.line(&format!("</{name}>"));
    }

    /// An element.
    pub(super) fn element(&mut self, name: &str, content: impl FnOnce(&mut Self)) {
        self.with(name, "", content);
    }

    /// An element that contains text only.
    pub(super) fn leaf(&mut self, name: &str, text: &str) {
        self.leaf_with(name, "", text);
    }

    /// An element with attributes, which are written as they are, that contains text only.
    pub(super) fn leaf_with(&mut self, name: &str, attributes: &str, text: &str) {
        let space = if attributes.is_empty() { "" } else { " " };
        self.line(&format!("<{name}{space}{attributes}>{}</{name}>", escaped(text)));
    }

    fn line(&mut self, line: &str) {
        self.text.extend(std::iter::repeat_n("  ", self.depth));
        self.text.push_str(line);
        self.text.push('\n');
    }
}
