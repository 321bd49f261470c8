//! The budget as a project of `suncal` (Sandia PSL Uncertainty Calculator), YAML: a problem for each measurand, in um,
//! urad and ppm.
//!
//! Suncal computes with symbols, which takes minutes for sixty quantities. Independent quantities of a row that have
//! the same uncertainty are therefore one quantity, whose sensitivity is the root of the sum of squares and whose
//! degrees of freedom are those of the sum.

use std::fmt::Write as _;

use trifacet_budget::{Distribution, Input};

use super::super::assessment::MEASURANDS;
use super::Report;
use super::numbers::plain;

/// A quantity of a problem.
struct Quantity {
    name: String,
    unit: &'static str,
    /// Place of its first input in the budget.
    first: usize,
    input: Input,
    sensitivity: f64,
}

pub fn suncal(report: &Report) -> String {
    let mut out = String::from(
        "# Made by trifacet budget; um, urad, ppm. Open it with suncal, or in Python:\n\
         # from suncal.project import Project; print(Project.from_configfile('FILE').calculate())\n",
    );
    for (j, (name, unit)) in MEASURANDS.iter().enumerate() {
        let quantities = quantities(report, j);
        let mut expression = plain(report.assessment.pose.to_array()[j] * 1e6);
        for (i, quantity) in quantities.iter().enumerate() {
            // Writing into a String does not fail.
            let _ = write!(expression, " + ({})*x{i}", plain(quantity.sensitivity));
        }
        let _ = writeln!(out, "- name: {name}\n  mode: uncertainty\n  samples: 100000\n  functions:");
        let _ =
            writeln!(out, "  - name: {name}\n    desc: {unit}\n    expr: {expression}", unit = unit.micro());
        out.push_str("  inputs:\n");
        for (i, quantity) in quantities.iter().enumerate() {
            let (name, unit, input) = (quoted(&quantity.name), quantity.unit, &quantity.input);
            let _ = writeln!(out, "  - name: x{i}\n    desc: {name}\n    mean: 0.0\n    uncerts:");
            let _ = writeln!(out, "    - name: {}\n      {}", quoted(unit), shape(input));
            let dof = if input.dof.is_finite() { plain(input.dof) } else { ".inf".into() };
            let _ = writeln!(out, "      degf: {dof}");
        }
        correlations(&mut out, report, &quantities);
    }
    out
}

/// The quantities that contribute to a measurand.
fn quantities(report: &Report, j: usize) -> Vec<Quantity> {
    let budget = &report.assessment.budget;
    let inputs = budget.inputs();
    let mut all = Vec::new();
    for (group, range) in report.assessment.rows() {
        let independent =
            |i: usize| (0..inputs.len()).all(|k| k == i || budget.input_correlation(i, k) == 0.0);
        let std = inputs[range.start].std;
        let unit = group.unit.micro();
        if range.clone().all(|i| independent(i) && inputs[i].std == std) {
            let power = |n: i32| range.clone().map(|i| budget.sensitivity(j, i).powi(n)).sum::<f64>();
            let input = inputs[range.start].clone();
            let input = Input { dof: input.dof * power(2).powi(2) / power(4), ..input };
            let (name, sensitivity) = (group.name.clone(), power(2).sqrt());
            all.push(Quantity { name, unit, first: range.start, input, sensitivity });
        } else {
            all.extend(range.map(|i| Quantity {
                name: inputs[i].name.clone(),
                unit,
                first: i,
                input: inputs[i].clone(),
                sensitivity: budget.sensitivity(j, i),
            }));
        }
    }
    let least = 1e-9 * budget.standard_uncertainty(j);
    all.retain(|quantity| (quantity.sensitivity * quantity.input.std).abs() > least);
    all
}

/// The distribution with its parameters. Of a t-distribution suncal takes the standard deviation, which is larger
/// than the standard uncertainty of JCGM 100; for the law of propagation a normal one has the same effect.
fn shape(input: &Input) -> String {
    let std = input.std * 1e6;
    let half = input.distribution.half_width().map(|half| plain(half * std));
    let name = match input.distribution {
        Distribution::Rectangular => "uniform",
        Distribution::Triangular => "triangular",
        Distribution::Arcsine => "arcsine",
        Distribution::Normal | Distribution::StudentT | Distribution::CurvilinearTrapezoid { .. } => "normal",
    };
    match half {
        Some(half) if name != "normal" => format!("dist: {name}\n      a: {half}"),
        _ => format!("dist: normal\n      std: {}", plain(std)),
    }
}

fn correlations(out: &mut String, report: &Report, quantities: &[Quantity]) {
    let mut first = true;
    for (a, b) in (0..quantities.len()).flat_map(|b| (0..b).map(move |a| (a, b))) {
        let r = report.assessment.budget.input_correlation(quantities[a].first, quantities[b].first);
        if r != 0.0 {
            if std::mem::take(&mut first) {
                out.push_str("  correlations:\n");
            }
            let _ = writeln!(out, "  - {{var1: x{a}, var2: x{b}, cor: {}}}", plain(r));
        }
    }
}

fn quoted(text: &str) -> String {
    format!("'{}'", text.replace('\'', "''"))
}
