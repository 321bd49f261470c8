//! `trifacet simulate`: the twin as fast as it can, as a table for `trifacet solve` and for tests.
//!
//! The same configuration gives the same bytes.

use std::io::{self, Write};

use trifacet::{
    exit::{self, Failure},
    twin::{Fate, Twin, TwinScan},
};

use super::table::digits;
use super::{ConfigArg, written};

/// Arguments of `simulate`.
#[derive(Debug, clap::Args)]
pub(crate) struct SimulateArgs {
    #[command(flatten)]
    config: ConfigArg,
    /// How many samples the twin takes; lost ones are not printed, and `sample` shows the gap
    #[arg(long, value_name = "N", default_value_t = 1000)]
    samples: u64,
}

/// Prints samples of the twin and the truth behind them to standard output.
pub(crate) fn simulate(args: &SimulateArgs) -> anyhow::Result<()> {
    let config = args.config.load()?;
    let mut twin = Twin::new(&config).map_err(|e| Failure::new(exit::CONFIG, e.to_string()))?;
    written(table(&mut twin, args.samples, io::stdout().lock()))
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
        write!(out, ",{}", digits(*value))?;
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
