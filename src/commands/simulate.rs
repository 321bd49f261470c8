//! `trifacet simulate`: the twin as fast as it can, as a table for `trifacet solve` and for tests.

use std::io::{self, Write};
use std::path::PathBuf;

use trifacet::{
    config,
    exit::{self, Failure},
    twin::{Fate, Twin, TwinScan},
};

/// Computes samples of the digital twin and prints them as CSV, with the truth behind them.
///
/// The same configuration and seed give the same bytes. Scans that a fault drops, damages or holds back
/// are not printed: the column `sample` shows the gap.
#[derive(Clone, Debug, clap::Args)]
pub struct SimulateArgs {
    /// Configuration file; without one, the defaults.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// How many samples the twin takes.
    #[arg(long, value_name = "N", default_value_t = 1000)]
    pub samples: u64,
}

/// Prints the table to standard output. A reader that has seen enough may close it early.
pub fn simulate(args: &SimulateArgs) -> anyhow::Result<()> {
    let wrong = |message: String| Failure::new(exit::CONFIG, message);
    let config = config::load(args.config.as_deref()).map_err(|e| wrong(e.to_string()))?;
    let mut twin = Twin::new(&config).map_err(|e| wrong(e.to_string()))?;
    match table(&mut twin, args.samples, io::stdout().lock()) {
        Err(e) if e.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        Err(e) => Err(Failure::new(exit::IO, format!("cannot write the table: {e}")).into()),
        Ok(()) => Ok(()),
    }
}

const TRUTH: [&str; 8] = [
    "true_tx_m",
    "true_ty_m",
    "true_tz_m",
    "true_roll_rad",
    "true_pitch_rad",
    "true_yaw_rad",
    "true_beam_dx_m",
    "true_beam_dy_m",
];

fn table(twin: &mut Twin, samples: u64, out: impl Write) -> io::Result<()> {
    let mut out = io::BufWriter::new(out);
    writeln!(out, "sample,time_s,{}", TRUTH.join(","))?;
    for _ in 0..samples {
        let scan = twin.next_scan();
        if scan.fate == Fate::Sent {
            row(&scan, &mut out)?;
        }
    }
    out.flush()
}

fn row(scan: &TwinScan, out: &mut impl Write) -> io::Result<()> {
    write!(out, "{},{}", scan.index, scan.t_s)?;
    let truth = &scan.truth;
    for value in truth.pose.to_array().iter().chain(truth.offset.iter()) {
        write!(out, ",{value:.16e}")?;
    }
    writeln!(out)
}

#[cfg(test)]
mod tests {
    use trifacet::config::{Config, Fault, FaultKind};

    use super::*;

    fn text(config: &Config, samples: u64) -> String {
        let mut out = Vec::new();
        table(&mut Twin::new(config).unwrap(), samples, &mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn the_same_seed_gives_the_same_bytes() {
        assert_eq!(text(&Config::default(), 100), text(&Config::default(), 100));
    }

    #[test]
    fn rows_fit_the_header_and_carry_the_truth_exactly() {
        let table = text(&Config::default(), 50);
        let mut rows = table.lines().map(|line| line.split(',').collect::<Vec<_>>());
        let columns = rows.next().unwrap();
        let place = |name: &str| columns.iter().position(|c| *c == name).unwrap();
        let mut twin = Twin::new(&Config::default()).unwrap();
        for row in rows {
            let scan = twin.next_scan();
            let value = |name: &str| row[place(name)].parse::<f64>().unwrap();
            assert_eq!(row.len(), columns.len());
            assert_eq!((value("sample"), value("time_s")), (scan.index as f64, scan.t_s));
            assert_eq!(value("true_yaw_rad"), scan.truth.pose.yaw);
            assert_eq!(value("true_beam_dy_m"), scan.truth.offset.y);
        }
        assert_eq!(twin.next_index(), 50);
    }

    #[test]
    fn scans_that_never_arrive_are_gaps() {
        let mut config = Config::default();
        config.twin.fault = vec![Fault { at_s: 0.01, for_s: Some(0.02), kind: FaultKind::Stalled }];
        let samples: Vec<u64> = text(&config, 50)
            .lines()
            .skip(1)
            .map(|line| line.split(',').next().unwrap().parse().unwrap())
            .collect();
        assert_eq!(samples, (0..10).chain(30..50).collect::<Vec<_>>());
    }
}
