//! Table 2 next to that of the paper: as CSV and as text.

use std::fmt;

use super::statistics::Measured;
use super::three;

/// The table as CSV, in um and urad.
pub fn csv(measured: &[Measured]) -> String {
    let mut csv = String::from("axis,unit,measured_std,paper_std,predicted_std\n");
    for m in measured {
        let (axis, [ours, predicted]) = (m.axis, [m.std, m.predicted].map(|x| x * 1e6));
        let row = format!("{},{},{ours},{},{predicted}\n", axis.name(), axis.micro_unit(), m.printed().std);
        csv.push_str(&row);
    }
    csv
}

/// The table as text for a terminal.
pub struct Table<'m>(pub &'m [Measured]);

impl fmt::Display for Table<'_> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        writeln!(
            f,
            "{:<6}{:<5}{:>9}{:>10}{:>10}{:>8}{:>11}{:>15}{:>8}",
            "axis", "unit", "range", "interval", "measured", "paper", "predicted", "rel. uncert.", "paper"
        )?;
        for m in self.0 {
            let paper = m.printed();
            writeln!(
                f,
                "{:<6}{:<5}{:>9}{:>10}{:>10}{:>8.2}{:>11}{:>13} %{:>6} %",
                m.axis.name(),
                m.axis.micro_unit(),
                three(m.range * 1e6),
                three(m.interval * 1e6),
                three(m.std * 1e6),
                paper.std,
                three(m.predicted * 1e6),
                three(m.relative * 1e2),
                paper.relative
            )?;
        }
        Ok(())
    }
}
