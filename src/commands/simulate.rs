//! `trifacet simulate`: runs the twin as fast as possible.
//!
//! The output is a table for `trifacet solve`, for trying out gains, and for tests. The same configuration
//! gives the same bytes. A spot that the channel map does not accept is NaN.

use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use trifacet::closed_loop_sim::{ClosedLoopSim, SimStep};
use trifacet::config::Config;
use trifacet::exit::{self, Failure};
use trifacet::recording::codec::{Encoded, Encoder};
use trifacet::recording::writer::Writer;
use trifacet::twin::{Twin, TwinScan};
use trifacet_core::channels::ChannelMap;
use trifacet_core::signals::Sample;
use trifacet_core::time::{Mono, NS_PER_S};
use trifacet_optics::Pose;
use trifacet_wire::layout::{POSE, SPOTS};

use super::new_file::{NewFile, cannot_write};
use super::table::digits;
use super::trace::POWERS;
use super::{ConfigArg, written};

/// Options of `simulate`.
#[derive(Debug, clap::Args)]
pub(crate) struct SimulateArgs {
    #[command(flatten)]
    config: ConfigArg,
    /// Number of samples of the twin; lost samples are not printed, and `sample` shows the gap
    #[arg(long, value_name = "N", default_value_t = 1000)]
    samples: u64,
    /// Include centering and estimation, as in the daemon; a command takes effect after the delay of the
    /// twin's stage, and computation takes no time
    #[arg(long)]
    closed_loop: bool,
    /// Print spots and powers as read, before correction tables and power gains, for a calibration
    #[arg(long, conflicts_with = "record")]
    readings: bool,
    /// Write a recording instead, as the daemon would; the time of the twin begins in 1970
    #[arg(long, value_name = "FILE", requires = "closed_loop")]
    record: Option<PathBuf>,
}

/// Prints samples of the twin and the true values to standard output.
pub(crate) fn simulate(args: &SimulateArgs) -> anyhow::Result<()> {
    let config = args.config.load()?;
    if let Some(file) = &args.record {
        return record(&config, args.samples, file);
    }
    let wrong = |message: String| Failure::new(exit::CONFIG, message);
    let mut twin = Twin::new(&config).map_err(|e| wrong(e.to_string()))?;
    let channels = config.read_channels()?;
    let channels = if args.readings { channels.as_read() } else { channels };
    let mut map = channels.map(twin.identity()).map_err(Failure::from)?;
    if args.closed_loop {
        let sim = ClosedLoopSim::new(&config)?;
        return written(closed_loop(sim, &mut map, args.samples, io::stdout().lock()));
    }
    written(table(&mut twin, &mut map, args.samples, io::stdout().lock()))
}

/// Records the results of the twin's scans.
fn record(config: &Config, samples: u64, file: &Path) -> anyhow::Result<()> {
    let (mut sim, mut receiver) = ClosedLoopSim::recorded(config)?;
    let new = NewFile::create(file, None)?;
    let to = BufWriter::new(new.writer()?);
    let mut writer = cannot_write(Writer::new(to, Some(mcap::Compression::Zstd)), file)?;
    let mut encoder = Encoder::new((Mono(0), 0));
    for _ in 0..samples {
        sim.step();
        while let Ok(entry) = receiver.entries.try_recv() {
            let put = |message: Encoded<'_>| writer.put(message).map_err(anyhow::Error::from);
            cannot_write(encoder.encode(&entry, put), file)?;
        }
    }
    let mut to = cannot_write(writer.finish(), file)?;
    cannot_write(to.flush(), file)?;
    new.keep()
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

fn table(twin: &mut Twin, map: &mut ChannelMap, samples: u64, out: impl Write) -> io::Result<()> {
    let mut out = io::BufWriter::new(out);
    writeln!(out, "sample,time_s,{},{},{}", TRUTH.join(","), SPOTS.join(","), POWERS.join(","))?;
    let mut lost = 0;
    for _ in 0..samples {
        let scan = twin.next_scan();
        if let Some(arrived) = scan.arrived(at(&scan), lost) {
            row(&scan, &map.sample(&arrived), &mut out)?;
            writeln!(out)?;
            lost = 0;
        } else {
            lost += 1;
        }
    }
    out.flush()
}

/// The time of a scan.
fn at(scan: &TwinScan) -> Mono {
    Mono((scan.t_s * NS_PER_S as f64).round() as i64)
}

fn row(scan: &TwinScan, sample: &Sample, out: &mut impl Write) -> io::Result<()> {
    write!(out, "{},{}", scan.index, scan.t_s)?;
    let truth = scan.truth.pose.to_array();
    let offset = scan.truth.offset.iter();
    for value in truth.iter().chain(offset).chain(&sample.spots).chain(&sample.powers) {
        write!(out, ",{}", digits(*value))?;
    }
    Ok(())
}

/// Columns that loop and estimation add. Unknown values are NaN.
const LOOP: [&str; 2] = ["stage_x_m", "stage_y_m"];

fn closed_loop(
    mut sim: ClosedLoopSim,
    map: &mut ChannelMap,
    samples: u64,
    out: impl Write,
) -> io::Result<()> {
    let mut out = io::BufWriter::new(out);
    let columns = [&TRUTH[..], &SPOTS, &POWERS, &LOOP, &POSE].concat();
    writeln!(out, "sample,time_s,{},lock,status", columns.join(","))?;
    for _ in 0..samples {
        let SimStep { scan, command, report, state, .. } = sim.step();
        let Some(arrived) = scan.arrived(at(&scan), 0) else { continue };
        row(&scan, &map.sample(&arrived), &mut out)?;
        let stage = command.map_or([f64::NAN; 2], |command| command.position.0);
        let pose = report.and_then(|report| report.pose).map_or([f64::NAN; 6], Pose::to_array);
        for value in stage.iter().chain(&pose) {
            write!(out, ",{}", digits(*value))?;
        }
        let status: Vec<_> = report.iter().flat_map(|report| report.status.names()).collect();
        writeln!(out, ",{},{}", state.lock.name(), status.join(" "))?;
    }
    out.flush()
}

#[cfg(test)]
mod tests {
    use trifacet::config::{Fault, FaultKind};

    use super::*;

    fn text(config: &Config, samples: u64) -> String {
        let (mut out, mut twin) = (Vec::new(), Twin::new(config).unwrap());
        let mut map = config.read_channels().unwrap().map(twin.identity()).unwrap();
        table(&mut twin, &mut map, samples, &mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn the_same_seed_gives_the_same_bytes() {
        assert_eq!(text(&Config::default(), 100), text(&Config::default(), 100));
    }

    #[test]
    fn rows_agree_with_the_header_and_contain_the_exact_truth() {
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
            let spots = scan.truth.spots.map(Option::unwrap);
            assert!((value("v_b_m") - spots[1].at[1]).abs() < 6e-6);
            assert!((value("power_c") / twin.laser_w() - spots[2].power).abs() < 2e-3);
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
