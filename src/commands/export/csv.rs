//! As text.

use std::io::{self, Write};

use trifacet::publishing::columns::Columns;

use super::{Row, Table};

/// Lines of text, the first with the names.
pub(super) struct Csv<W> {
    to: W,
    begun: bool,
}

impl<W: Write> Csv<W> {
    pub(super) fn new(to: W) -> Self {
        Self { to, begun: false }
    }
}

impl<W: Write> Table for Csv<W> {
    fn row(&mut self, row: Row) -> io::Result<()> {
        let row = Columns(row);
        if !std::mem::replace(&mut self.begun, true) {
            writeln!(self.to, "{}", row.csv_header())?;
        }
        writeln!(self.to, "{}", row.csv_line())
    }

    fn finish(mut self: Box<Self>) -> io::Result<()> {
        self.to.flush()
    }
}
