//! `trifacet calibrate plan`: chooses the poses of a calibration.

use std::fmt::Write as _;
use std::io::{self, BufWriter, Write};
use std::path::PathBuf;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use trifacet::calibration::expectation::expectation;
use trifacet::calibration::pose_list;
use trifacet::calibration::scan_pattern::POINTS as SCAN_POINTS;
use trifacet::config::Config;
use trifacet::exit::{self, Failure};
use trifacet_core::steering::BeamPoint;
use trifacet_optics::calibration::plan::{Plan, Request, choose};
use trifacet_optics::{FACETS, Optics, Pose};

use super::{ReferenceArgs, number};
use crate::commands::new_file::{NewFile, cannot_write};
use crate::commands::{ConfigArg, whole, written};

/// What the steering keeps for the loop at each end of its range, metres.
const STEERING_RESERVE: f64 = 20e-6;
/// Number of steering scans of a run.
const SCANS: f64 = 2.0;

/// Options of `calibrate plan`.
#[derive(Debug, clap::Args)]
pub(crate) struct PlanArgs {
    /// Number of points, without the visits of the tare pose
    #[arg(long, value_name = "N", value_parser = whole(10_usize..=5000))]
    points: usize,
    /// Range of the translations, plus and minus, millimetres
    #[arg(long, value_name = "MM", default_value_t = 1.0, value_parser = millimetres)]
    range_mm: f64,
    /// Range of the rotations, plus and minus, milliradians
    #[arg(long, value_name = "MRAD", default_value_t = 5.0, value_parser = milliradians)]
    range_mrad: f64,
    /// File for the poses: columns kind, tx_m, ty_m, tz_m, roll_rad, pitch_rad, yaw_rad
    #[arg(long, value_name = "FILE.csv")]
    out: PathBuf,
    /// Seed of the choice: the same seed gives the same poses
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Time of a move until the mirror is at rest, seconds: for the duration only
    #[arg(long, value_name = "S", default_value_t = 10.0, value_parser = seconds)]
    seconds_per_move: f64,
    #[command(flatten)]
    reference: ReferenceArgs,
    /// With it, the plan stays within the range of the steering; without it, the nominal head counts
    #[command(flatten)]
    config: ConfigArg,
}

fn millimetres(text: &str) -> Result<f64, &'static str> {
    number(text, 0.001, 10.0).ok_or("allowed is 0.001 to 10")
}

fn milliradians(text: &str) -> Result<f64, &'static str> {
    number(text, 0.001, 100.0).ok_or("allowed is 0.001 to 100")
}

fn seconds(text: &str) -> Result<f64, &'static str> {
    number(text, 0.0, 3600.0).ok_or("allowed is 0 to 3600")
}

/// Chooses the poses, writes them, and states coverage and duration.
pub(crate) fn plan(args: &PlanArgs) -> anyhow::Result<()> {
    let config = args.config.load()?;
    let file = NewFile::create(&args.out, None)?;
    let plan = chosen(args, &config)?;
    cannot_write(pose_list::write(&plan.poses, BufWriter::new(file.writer()?)), &args.out)?;
    file.keep()?;
    let [summary, expected] = [summary(args, &config, &plan), expected(args, &config, &plan)];
    written(writeln!(io::stdout(), "{summary}{expected}written to {}", args.out.display()))
}

fn chosen(args: &PlanArgs, config: &Config) -> anyhow::Result<Plan> {
    let optics = config.optics().map_err(|e| Failure::new(exit::CONFIG, e.to_string()))?;
    let (map, limit) = (config.steering.beam_map(), config.steering.limit_um * 1e-6 - STEERING_RESERVE);
    let steered = args.config.path().is_some();
    let follows = |pose: &Pose| {
        let beam: [f64; 2] = optics.across(pose.t).into();
        !steered || map.stage(BeamPoint(beam)).iter().all(|x| x.abs() <= limit)
    };
    let [mm, mrad] = [args.range_mm * 1e-3, args.range_mrad * 1e-3];
    let margin = config.estimation.edge_margin_mm * 1e-3;
    let request = Request {
        optics: &optics,
        points: args.points,
        range: [mm, mm, mm, mrad, mrad, mrad],
        reach: smallest_half(&optics) - margin,
        followed: &follows,
    };
    let mut rng = Pcg64::seed_from_u64(args.seed);
    let plan = choose(&request, &mut || rng.random()).map_err(|error| {
        let steering = if steered { ", and the steering must follow the apex (steering.limit_um)" } else { "" };
        let remedy = format!(
            "every spot must be at least {} mm from the edge of its PSD (estimation.edge_margin_mm){steering}: \
             reduce --range-mm or --range-mrad",
            margin * 1e3
        );
        Failure::new(exit::DATA, format!("{error}; {remedy}"))
    })?;
    Ok(plan)
}

fn smallest_half(optics: &Optics) -> f64 {
    optics.half_sizes().into_iter().fold(f64::INFINITY, f64::min)
}

/// What the plan covers, and how long it takes.
fn summary(args: &PlanArgs, config: &Config, plan: &Plan) -> String {
    let (poses, samples) = (plan.poses.len(), args.reference.noise().samples(config));
    let visits = poses - args.points;
    let mut text = format!("{} points and {visits} visits of the tare pose\n", args.points);
    let reached = |axis: usize| plan.poses.iter().map(|p| p.pose.to_array()[axis].abs()).fold(0.0, f64::max);
    for (axis, name) in ["tx", "ty", "tz", "roll", "pitch", "yaw"].into_iter().enumerate() {
        let (asked, unit) = if axis < 3 { (args.range_mm, "mm") } else { (args.range_mrad, "mrad") };
        let reached = reached(axis) * 1e3;
        if reached < 0.9 * asked {
            // Writing to a string cannot fail.
            let _ = writeln!(
                text,
                "{name} reaches only {reached:.3} of {asked} {unit}: beyond it a spot is too near the edge of its PSD, \
                 or the steering is at its limit"
            );
        }
    }
    for (psd, coverage) in FACETS.into_iter().zip(plan.coverage) {
        let (hit, of) = (coverage.hit, coverage.within_range);
        let _ =
            writeln!(text, "PSD {psd}: spots in {hit} of the {of} cells of 0.4 mm that the range reaches");
    }
    let at_psd = args.reference.noise().at_psd(config) * 1e6;
    let _ = writeln!(
        text,
        "{samples} samples per point: then their noise is below that of the reference, {at_psd:.3} um at a PSD"
    );
    let reading_s = f64::from(samples) / config.acquisition.rate_hz;
    let scans_s = SCANS * SCAN_POINTS as f64 * (reading_s + 0.1);
    let total_s = poses as f64 * (args.seconds_per_move + reading_s) + scans_s;
    let _ = writeln!(
        text,
        "duration: about {:.0} min, with {} s per move and two scans of the steering",
        (total_s / 60.0).ceil(),
        args.seconds_per_move
    );
    text
}

/// The uncertainty to expect after the fit.
fn expected(args: &PlanArgs, config: &Config, plan: &Plan) -> String {
    let range = [args.range_mm * 1e-3, args.range_mrad * 1e-3];
    match expectation(config, &plan.poses, args.reference.noise(), range) {
        Ok(uncertainty) => {
            let [tx, ty, tz, roll, pitch, yaw] = uncertainty.deviation.map(|x| x * 1e6);
            format!(
                "expected after the fit, over +-{} mm and +-{} mrad: standard uncertainty of tx {tx:.3}, ty {ty:.3}, \
                 tz {tz:.3} um, roll {roll:.3}, pitch {pitch:.3}, yaw {yaw:.3} urad (by the calibration, relative to the \
                 tare pose)\n",
                args.range_mm, args.range_mrad
            )
        }
        Err(why) => format!("no uncertainty can be expected: {why}\n"),
    }
}
