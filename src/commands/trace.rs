//! `trifacet trace` and `trifacet solve`: apply the sensor model to tables, forward and inverse.

use std::path::PathBuf;

use trifacet::config;
use trifacet_optics::{Estimator, Model, Optics, Pose, Signals, Vec2};
use trifacet_wire::layout::{self, POSE, SPOTS};

use super::ConfigArg;
use super::table::{Column, Row, convert, digits};

/// Options of `trace` and `solve`.
#[derive(Debug, clap::Args)]
pub(crate) struct TableArgs {
    #[command(flatten)]
    config: ConfigArg,
    /// Model of the beam, instead of that of the configuration
    #[arg(long)]
    model: Option<config::Model>,
    /// CSV file with a header, columns by name; by default, or with `-`, standard input
    #[arg(value_name = "IN.csv")]
    input: Option<PathBuf>,
}

const OFFSET: [&str; 2] = ["beam_dx_m", "beam_dy_m"];
pub(super) const POWERS: [&str; 3] = ["power_a", "power_b", "power_c"];

fn needed(names: &[&'static str]) -> impl Iterator<Item = Column> {
    names.iter().map(|name| Column { name, alias: None, default: None })
}

/// The powers, in any unit. `watch` and `export` write them in watts.
fn powers() -> impl Iterator<Item = Column> {
    needed(&POWERS).zip(layout::POWERS).map(|(column, watts)| Column { alias: Some(watts), ..column })
}

/// The optics and the model for these options.
fn optics(args: &TableArgs) -> anyhow::Result<(Optics, Model)> {
    let config = args.config.load()?;
    let model = args.model.unwrap_or(config.estimation.model).into();
    Ok((Optics::new(&config.head.build()?), model))
}

/// Computes signals from poses.
pub(crate) fn trace(args: &TableArgs) -> anyhow::Result<()> {
    let (optics, model) = optics(args)?;
    let columns: Vec<_> =
        needed(&POSE).chain(OFFSET.map(|name| Column { name, alias: None, default: Some(0.0) })).collect();
    let with_powers: &[&str] = if model == Model::Gaussian { &POWERS } else { &[] };
    let header = [&SPOTS, with_powers].concat();
    convert(args.input.as_deref(), &columns, &header, |numbers| {
        let signals = numbers.map_err(|e| e.to_string()).and_then(|n| {
            let pose = Pose::from_array([n[0], n[1], n[2], n[3], n[4], n[5]]);
            optics.trace(model, &pose, Vec2::new(n[6], n[7])).map_err(|e| e.to_string())
        });
        let (numbers, problem) = match signals {
            Ok(reading) => ([&reading.spots[..], &reading.powers].concat(), None),
            Err(reason) => (vec![f64::NAN; header.len()], Some(reason)),
        };
        Row { cells: numbers.into_iter().take(header.len()).map(digits).collect(), problem }
    })
}

/// Computes poses from signals.
pub(crate) fn solve(args: &TableArgs) -> anyhow::Result<()> {
    let (optics, model) = optics(args)?;
    let estimator = Estimator::new(optics, model);
    let gaussian = model == Model::Gaussian;
    let offset: &[&str] = if gaussian { &OFFSET } else { &[] };
    let columns: Vec<_> = needed(&SPOTS).chain(powers().filter(|_| gaussian)).collect();
    let header = [&POSE, offset, &["iterations", "status"]].concat();
    let count = POSE.len() + offset.len();
    convert(args.input.as_deref(), &columns, &header, |numbers| {
        let solution = numbers.map_err(|e| (e.to_string(), 0)).and_then(|n| {
            let power = |i: usize| n.get(6 + i).copied().unwrap_or(f64::NAN);
            let spots = [n[0], n[1], n[2], n[3], n[4], n[5]];
            // Rows are independent: a result does not depend on the neighbouring rows.
            let signals = Signals { spots, powers: [power(0), power(1), power(2)] };
            estimator.solve(&signals, None).map_err(|e| (e.to_string(), e.iterations()))
        });
        let (numbers, iterations, problem) = match solution {
            Ok(s) => ([&s.pose.to_array()[..], s.offset.as_slice()].concat(), s.iterations, None),
            Err((reason, iterations)) => (vec![f64::NAN; count], iterations, Some(reason)),
        };
        let mut cells: Vec<_> = numbers.into_iter().take(count).map(digits).collect();
        cells.push(iterations.to_string());
        cells.push(problem.clone().unwrap_or_else(|| "ok".into()));
        Row { cells, problem }
    })
}
