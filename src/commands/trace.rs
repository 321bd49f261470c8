//! `trifacet trace`: applies the sensor model to a table of poses.

use std::path::PathBuf;

use trifacet::config;
use trifacet_optics::{Model, Pose, Vec2};
use trifacet_wire::layout::{POSE, SPOTS};

use super::ConfigArg;
use super::table::{Column, Row, convert, digits};

/// Options of `trace` and `solve`.
#[derive(Debug, clap::Args)]
pub(crate) struct TableArgs {
    #[command(flatten)]
    pub(super) config: ConfigArg,
    /// Model of the beam, instead of that of the configuration
    #[arg(long)]
    pub(super) model: Option<config::Model>,
    /// CSV file with a header, columns by name; by default, or with `-`, standard input
    #[arg(value_name = "IN.csv")]
    pub(super) input: Option<PathBuf>,
}

pub(super) const OFFSET: [&str; 2] = ["beam_dx_m", "beam_dy_m"];
pub(super) const POWERS: [&str; 3] = ["power_a", "power_b", "power_c"];

/// Columns that the input must have.
pub(super) fn needed(names: &[&'static str]) -> impl Iterator<Item = Column> {
    names.iter().map(|name| Column { name, alias: None, default: None })
}

/// Computes signals from poses.
pub(crate) fn trace(args: &TableArgs) -> anyhow::Result<()> {
    let config = args.config.load_any_beam()?;
    let model = args.model.unwrap_or(config.estimation.model).into();
    let optics = config.optics()?;
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
