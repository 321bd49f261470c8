//! Tables as CSV text.

use std::io::{self, Write};

use trifacet::publishing::columns::Columns;

use super::{Row, Table};

/// A CSV writer. The first line contains the names of the columns.
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
