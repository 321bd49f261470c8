//! The rows of the table: quantities of one kind together.

use std::ops::Range;

use trifacet_budget::{Budget, Input};

use super::super::assessment::Assessment;
use crate::config::{Group, Unit};

/// A row of the table. Numbers in SI units.
#[derive(Clone, Debug)]
pub struct Row {
    /// The quantity.
    pub name: String,
    /// Where its numbers come from.
    pub source: String,
    /// Its unit.
    pub unit: Unit,
    /// Number of quantities in the row.
    pub count: usize,
    /// The estimate, if it is the same for all of them.
    pub value: Option<f64>,
    /// The standard uncertainty, if it is the same for all of them.
    pub std: Option<f64>,
    /// Name of the distribution.
    pub distribution: &'static str,
    /// "A" or "B".
    pub evaluation: &'static str,
    /// Degrees of freedom of each.
    pub dof: f64,
    /// Sensitivity of each measurand: the root of the sum of squares. `None` if the uncertainties differ.
    pub sensitivity: [Option<f64>; 6],
    /// Contribution to each measurand: the root of the sum of squares.
    pub contribution: [f64; 6],
    /// Part of the variance of each measurand, without correlations.
    pub share: [f64; 6],
}

/// The rows of a budget.
pub fn rows(assessment: &Assessment) -> Vec<Row> {
    let budget = &assessment.budget;
    let row = |(group, range): (&Group, Range<usize>)| {
        let inputs = &budget.inputs()[range.clone()];
        let same = |of: fn(&Input) -> f64| {
            inputs.first().map(of).filter(|first| inputs.iter().all(|input| of(input) == *first))
        };
        let root = |of: &dyn Fn(usize) -> f64| range.clone().map(|i| of(i).powi(2)).sum::<f64>().sqrt();
        let std = same(|input| input.std);
        Row {
            name: group.name.clone(),
            source: group.source.clone(),
            unit: group.unit,
            count: inputs.len(),
            value: same(|input| input.value),
            std,
            distribution: inputs.first().map_or("", |input| input.distribution.name()),
            evaluation: inputs.first().map_or("", |input| input.evaluation.name()),
            dof: inputs.first().map_or(f64::NAN, |input| input.dof),
            sensitivity: std::array::from_fn(|j| std.map(|_| root(&|i| budget.sensitivity(j, i)))),
            contribution: std::array::from_fn(|j| root(&|i| budget.contribution(j, i))),
            share: std::array::from_fn(|j| range.clone().map(|i| budget.share(j, i)).sum()),
        }
    };
    assessment.rows().map(row).collect()
}

/// Whether a row contributes less than a millionth to a measurand: rounding of the model.
pub fn negligible(budget: &Budget, row: &Row, measurand: usize) -> bool {
    row.contribution[measurand] < 1e-6 * budget.standard_uncertainty(measurand)
}

/// "not defined", "inf", or the number with one decimal.
pub fn dof_text(dof: Option<f64>) -> String {
    match dof {
        None => "not defined".into(),
        Some(dof) if dof > 1e6 => "inf".into(),
        Some(dof) => format!("{dof:.1}"),
    }
}
