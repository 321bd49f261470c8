//! `trifacet solve`: poses from a table of signals, in the frames and with the uncertainties that are asked for.

mod calibrated;
mod reading;
mod uncertainty;

use std::io::{self, Write};

use calibrated::CalibrationShare;
use nalgebra::Matrix6;
use reading::{Reading, Readings};
use trifacet::config::CalibrationContext;
use trifacet_core::estimation::Frames;
use trifacet_optics::calibration::result::Raw;
use trifacet_optics::covariance::sigmas;
use trifacet_optics::{Estimator, Model, Pose, Relative, Rigid, Solution, Vec2};
use trifacet_wire::layout::POSE;
use uncertainty::{CAL_STD, Covariances, STD, SYS_STD};

use super::table::{Conversion, Numbers, Row, convert_with, digits};
use super::trace::{OFFSET, TableArgs};

/// Options of `solve`.
#[derive(Debug, clap::Args)]
pub(crate) struct SolveArgs {
    #[command(flatten)]
    table: TableArgs,
    /// Take the spots as read, before the correction tables of the configuration, and the powers in watts before its
    /// power gains
    #[arg(long)]
    readings: bool,
    /// Give the poses in the user's frames, `[frames]` of the configuration, instead of in the sensor's world frame
    #[arg(long)]
    frames: bool,
    /// Give the poses relative to that of a data row, counted from 1, and their uncertainties as those of the
    /// difference
    #[arg(long, value_name = "N", value_parser = super::within(1..=u64::MAX))]
    tare_row: Option<u64>,
    /// Add standard uncertainties: total (std_tx_m ... std_yaw_rad), the part of it that is systematic (sys_std_...), and
    /// the share of the calibration in it (cal_std_...: needs a calibration record, --readings, --frames and --tare-row)
    #[arg(long)]
    sigma: bool,
}

/// The tare row, solved.
struct Tare {
    row: u64,
    solved: Option<Solved>,
}

/// Computes poses from signals.
pub(crate) fn solve(args: &SolveArgs) -> anyhow::Result<()> {
    let config = args.table.config.load_any_beam()?;
    let model: Model = args.table.model.unwrap_or(config.estimation.model).into();
    let readings = Readings::new(&config, args.readings, model)?;
    let columns = readings.columns(args.sigma);
    let mut header = POSE.to_vec();
    if model == Model::Gaussian {
        header.extend(OFFSET);
    }
    let mut calibration = None;
    if args.sigma {
        header.extend(STD.iter().chain(&SYS_STD));
        match CalibrationShare::open(&CalibrationContext::read(config.clone())?, args)? {
            Ok(share) => {
                header.extend(CAL_STD);
                calibration = Some(share);
            }
            Err(why) => no_calibration_share(&why),
        }
    }
    header.extend(["iterations", "status"]);
    let solving = Solving {
        readings,
        estimator: Estimator::new(config.optics()?, model),
        frames: if args.frames { config.frames.build() } else { Frames::default() },
        systematic: config.systematic(calibration.is_some()),
        sigma: args.sigma,
        calibration,
        tare: args.tare_row.map(|row| Tare { row, solved: None }),
    };
    convert_with(args.table.input.as_deref(), &columns, &header, solving)
}

/// Says why the uncertainties do not include what a calibration leaves unknown. The columns for it are absent, not
/// zero.
fn no_calibration_share(why: &str) {
    // Standard error may be closed.
    let _ = writeln!(io::stderr(), "trifacet: no columns {} to {}: {why}", CAL_STD[0], CAL_STD[5]);
}

/// How rows become poses.
struct Solving {
    readings: Readings,
    estimator: Estimator,
    frames: Frames,
    /// Standard uncertainties that averaging does not reduce, in the sensor's world frame.
    systematic: [f64; 6],
    sigma: bool,
    calibration: Option<CalibrationShare>,
    tare: Option<Tare>,
}

/// A pose in the frames that are asked for.
struct Solved {
    pose: Pose,
    covariances: Covariances,
    raw: Raw,
    offset: Vec2,
    iterations: u8,
    /// It is the tare row, relative to itself.
    itself: bool,
    /// Why the uncertainties do not hold.
    warning: Option<String>,
}

/// A row without a pose: the reason, and the iterations of the solver.
type Unsolved = (String, u8);

impl Conversion for Solving {
    fn needs(&self) -> Option<u64> {
        self.tare.as_ref().map(|tare| tare.row)
    }

    fn prepare(&mut self, numbers: &Numbers) -> Result<(), String> {
        let solved = self.solved(numbers);
        if let Some(tare) = &mut self.tare {
            let solved = solved.map_err(|(why, _)| format!("the tare row has no pose: {why}"))?;
            if let Some(calibration) = &mut self.calibration {
                calibration.set_tare(solved.raw);
            }
            tare.solved = Some(solved);
        }
        Ok(())
    }

    fn batch(&self) -> usize {
        if self.calibration.is_some() { BATCH } else { 1 }
    }

    fn rows(&mut self, rows: Vec<(u64, Numbers)>) -> Vec<Row> {
        let mut solved: Vec<_> = rows
            .into_iter()
            .map(|(number, numbers)| {
                self.solved(&numbers).and_then(|solved| match &self.tare {
                    Some(Tare { row, solved: Some(zero) }) => relative(solved, zero, *row == number),
                    _ => Ok(solved),
                })
            })
            .collect();
        if let Some(calibration) = &self.calibration {
            add_calibration(&mut solved, calibration);
        }
        solved.into_iter().map(|solved| self.written(solved)).collect()
    }
}

/// Rows whose shares of the calibration are computed together, which takes a tenth of the time.
const BATCH: usize = 64;

/// Adds the share of the calibration to rows with a pose. Where it is not known, neither are the uncertainties.
fn add_calibration(rows: &mut [Result<Solved, Unsolved>], calibration: &CalibrationShare) {
    let mut solved: Vec<_> = rows.iter_mut().flatten().filter(|solved| !solved.itself).collect();
    let raws: Vec<_> = solved.iter().map(|solved| solved.raw).collect();
    for (solved, share) in solved.iter_mut().zip(calibration.of(&raws)) {
        let unknown = "warning: the share of the calibration is not known";
        if share.is_none() {
            solved.warning.get_or_insert_with(|| unknown.into());
        }
        solved.covariances.add_calibration(&share.unwrap_or(Matrix6::repeat(f64::NAN)));
    }
}

impl Solving {
    /// The pose of a row, before the tare. A result does not depend on the rows before.
    fn solved(&self, numbers: &Numbers) -> Result<Solved, Unsolved> {
        let numbers = numbers.as_ref().map_err(|e| (e.to_string(), 0))?;
        let Reading { signals, noise, slopes, raw, warning } =
            self.readings.read(numbers).map_err(|e| (e, 0))?;
        let solution = self.estimator.solve(&signals, None).map_err(|e| (e.to_string(), e.iterations()))?;
        let unsolved = |why: &str| (why.to_owned(), solution.iterations);
        let sensor = solution.pose;
        let pose = self.frames.pose(&sensor).ok_or_else(|| unsolved(NO_ANGLES))?;
        let mut covariances = Covariances::default();
        if self.sigma {
            let sensitivity =
                self.estimator.sensitivity(&solution).map_err(|e| (e.to_string(), solution.iterations))?;
            let random = reading::before_tables(&sensitivity, &slopes).spread(&noise).pose_covariance();
            let systematic = Matrix6::from_diagonal(&self.systematic.map(|sigma| sigma * sigma).into());
            let [random, systematic] =
                [random, systematic].map(|of| self.frames.covariance(&sensor, &pose, &of));
            covariances = Covariances { random, systematic, ..Covariances::default() };
        }
        let Solution { offset, iterations, .. } = solution;
        Ok(Solved { pose, covariances, raw, offset, iterations, itself: false, warning })
    }

    fn written(&self, solved: Result<Solved, Unsolved>) -> Row {
        let shares = if self.calibration.is_some() { CAL_STD.len() } else { 0 };
        let deviations = if self.sigma { STD.len() + SYS_STD.len() + shares } else { 0 };
        let offset = if self.readings.model() == Model::Gaussian { OFFSET.len() } else { 0 };
        let (mut numbers, iterations, status, problem) = match solved {
            Ok(Solved { pose, covariances, offset: beam, iterations, warning, .. }) => {
                let mut numbers = pose.to_array().to_vec();
                numbers.extend(beam.iter().take(offset));
                let Covariances { systematic, calibration, .. } = covariances;
                let parts = [covariances.total(), systematic, calibration].map(|of| sigmas(&of));
                numbers.extend(parts.iter().flatten().take(deviations));
                (numbers, iterations, warning.unwrap_or_else(|| "ok".into()), None)
            }
            Err((why, iterations)) => (Vec::new(), iterations, why.clone(), Some(why)),
        };
        numbers.resize(POSE.len() + offset + deviations, f64::NAN);
        let mut cells: Vec<_> = numbers.into_iter().map(digits).collect();
        cells.extend([iterations.to_string(), status]);
        Row { cells, problem }
    }
}

/// Why a pose has no angles.
const NO_ANGLES: &str =
    "the pitch is within a degree of 90 degrees in these frames: roll and yaw are not defined";

/// A pose relative to that of the tare row. `itself`: it is the tare row, whose difference to itself is exactly zero.
fn relative(solved: Solved, zero: &Solved, itself: bool) -> Result<Solved, Unsolved> {
    let Relative { pose, by_pose, by_zero } = Relative::new(&solved.pose, &zero.pose);
    if itself {
        let (pose, covariances) = <_>::default();
        return Ok(Solved { pose, covariances, itself, ..solved });
    }
    let plain = Rigid::identity();
    if Frames::new(&plain, &plain, &plain).pose(&pose).is_none() {
        return Err((NO_ANGLES.into(), solved.iterations));
    }
    let covariances = solved.covariances.of_difference(&zero.covariances, &by_pose, &by_zero);
    Ok(Solved { pose, covariances, ..solved })
}
