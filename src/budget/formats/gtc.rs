//! The budget as a Python script that uses the package `GTC` (GUM Tree Calculator).

use std::fmt::Write as _;

use super::super::assessment::MEASURANDS;
use super::Report;
use super::numbers::plain;

const HEAD: &str = r#"#!/usr/bin/env python3
"""The uncertainty budget of a pose, computed by GTC (pip install GTC); um, urad, ppm. Made by trifacet budget.

Prints a line for each measurand: u_c, nu_eff, k and U by GTC, and U by trifacet. Then the correlation matrix.
"""
from GTC import dof, get_correlation, inf, reporting, set_correlation, uncertainty, ureal

"#;

const TAIL: &str = r#"
print("measurand unit u_c nu_eff k U U_trifacet")
for (name, unit, expanded), y in zip(MEASURANDS, poses):
    nu = dof(y)
    # Degrees of freedom are truncated to a whole number (JCGM 100, G.6.4).
    k = reporting.k_factor(inf if nu > 1e6 or nu != nu else max(1, int(nu)), p=100 * P)
    print(name, unit, repr(uncertainty(y)), repr(nu), repr(k), repr(k * uncertainty(y)), expanded)
print("correlation")
for a in poses:
    print(*(repr(1.0 if a is b else get_correlation(a, b)) for b in poses))
"#;

pub fn gtc(report: &Report) -> String {
    let budget = &report.assessment.budget;
    let inputs = budget.inputs();
    let mut out = String::from(HEAD);
    // Writing into a String does not fail.
    let _ = writeln!(out, "P = {}\nMEASURANDS = [", plain(report.probability));
    for (j, (name, unit)) in MEASURANDS.iter().enumerate() {
        let expanded = plain(budget.expanded(j, report.probability) * 1e6);
        let _ = writeln!(out, "    ({name:?}, {:?}, {expanded}),", unit.micro());
    }
    out.push_str("]\n# Deviations of the quantities from their estimates.\nx = [\n");
    for (i, input) in inputs.iter().enumerate() {
        let independent = (0..inputs.len()).all(|k| k == i || budget.input_correlation(i, k) == 0.0);
        let dof = if input.dof.is_finite() { plain(input.dof) } else { "inf".into() };
        let independent = if independent { "True" } else { "False" };
        let std = plain(input.std * 1e6);
        let _ = writeln!(out, "    ureal(0.0, {std}, {dof}, {:?}, independent={independent}),", input.name);
    }
    out.push_str("]\n");
    for (a, b) in (0..inputs.len()).flat_map(|a| (0..a).map(move |b| (b, a))) {
        let r = budget.input_correlation(a, b);
        if r != 0.0 && inputs[a].std > 0.0 && inputs[b].std > 0.0 {
            let _ = writeln!(out, "set_correlation({}, x[{a}], x[{b}])", plain(r));
        }
    }
    out.push_str("C = [\n");
    for j in 0..MEASURANDS.len() {
        let row: Vec<_> = (0..inputs.len()).map(|i| plain(budget.sensitivity(j, i))).collect();
        let _ = writeln!(out, "    [{}],", row.join(", "));
    }
    let pose = report.assessment.pose.to_array().map(|value| plain(value * 1e6));
    let _ = writeln!(out, "]\nvalues = [{}]", pose.join(", "));
    out.push_str("poses = [value + sum(c * xi for c, xi in zip(row, x)) for value, row in zip(values, C)]\n");
    out.push_str(TAIL);
    out
}
