//! The budget as JSON. Lengths in um, angles in urad, ratios in ppm.

use serde_json::{Value, json};

use super::super::assessment::{Geometry, MEASURANDS};
use super::Report;
use super::text::verdict;

pub fn json(report: &Report) -> String {
    let value = json!({
        "format": 1,
        "version": env!("CARGO_PKG_VERSION"),
        "configuration": report.configuration,
        "pose": report.assessment.pose.to_array().map(|x| x * 1e6),
        "tared": report.tared,
        "average": report.average,
        "probability": report.probability,
        "geometry": match report.assessment.geometry {
            Geometry::Calibrated => "calibrated",
            Geometry::Configured => "configured",
            Geometry::NotCovered => "not covered",
        },
        "measurands": (0..6).map(|j| measurand(report, j)).collect::<Vec<_>>(),
        "correlation": (0..6).map(|i| (0..6).map(|j| report.assessment.budget.correlation(i, j)).collect::<Vec<_>>()).collect::<Vec<_>>(),
        "inputs": inputs(report),
        "input_correlations": input_correlations(report),
        "range": report.range.as_ref().map(|range| json!({
            "mm": range.metres * 1e3,
            "mrad": range.radians * 1e3,
            "largest": range.largest.iter().zip(MEASURANDS).map(|((u, pose), (name, unit))| json!({
                "measurand": name, "unit": unit.micro(), "u_c": u * 1e6, "pose": pose.to_array().map(|x| x * 1e6),
            })).collect::<Vec<_>>(),
        })),
        "not_covered": report.assessment.not_covered.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "notes": report.assessment.notes,
        "verdict": report.assessment.verdict(),
    });
    format!("{value:#}\n")
}

/// A number of degrees of freedom; JSON has no infinity.
fn dof(dof: Option<f64>) -> Value {
    match dof {
        None => "not defined".into(),
        Some(dof) if dof.is_infinite() => "infinite".into(),
        Some(dof) => dof.into(),
    }
}

fn measurand(report: &Report, j: usize) -> Value {
    let (assessment, p) = (&report.assessment, report.probability);
    let (name, unit) = MEASURANDS[j];
    let monte_carlo = report.trials.as_ref().map(|trials| {
        let (symmetric, shortest) = (trials.symmetric(j), trials.shortest(j));
        let check = assessment.validation(j, trials);
        json!({
            "trials": trials.trials(),
            "failed": trials.failed(),
            "mean": trials.estimate(j) * 1e6,
            "u": trials.standard_uncertainty(j) * 1e6,
            "interval": [symmetric.low * 1e6, symmetric.high * 1e6],
            "shortest_interval": [shortest.low * 1e6, shortest.high * 1e6],
            "difference": [check.low * 1e6, check.high * 1e6],
            "limit": check.tolerance * 1e6,
            "scatter": check.scatter * 1e6,
            "validated": verdict(check.verdict),
        })
    });
    json!({
        "name": name,
        "unit": unit.micro(),
        "value": assessment.pose.to_array()[j] * 1e6,
        "u_c": assessment.budget.standard_uncertainty(j) * 1e6,
        "nu_eff": dof(assessment.budget.effective_dof(j)),
        "k": assessment.budget.coverage_factor(j, p),
        "U": assessment.budget.expanded(j, p) * 1e6,
        "correlation_share": assessment.budget.correlation_share(j),
        "monte_carlo": monte_carlo,
    })
}

fn inputs(report: &Report) -> Vec<Value> {
    let budget = &report.assessment.budget;
    let each = |of: &dyn Fn(usize) -> f64| (0..6).map(of).collect::<Vec<_>>();
    let mut all = Vec::new();
    for (group, range) in report.assessment.rows() {
        for i in range {
            let input = &budget.inputs()[i];
            all.push(json!({
                "group": group.name,
                "name": input.name,
                "source": group.source,
                "unit": group.unit.micro(),
                "value": input.value * 1e6,
                "u": input.std * 1e6,
                "distribution": input.distribution.name(),
                "type": input.evaluation.name(),
                "dof": dof(Some(input.dof)),
                "sensitivity": each(&|j| budget.sensitivity(j, i)),
                "contribution": each(&|j| budget.contribution(j, i) * 1e6),
                "share": each(&|j| budget.share(j, i)),
            }));
        }
    }
    all
}

fn input_correlations(report: &Report) -> Vec<Value> {
    let budget = &report.assessment.budget;
    let inputs = budget.inputs();
    let pairs = (0..inputs.len()).flat_map(|a| (0..a).map(move |b| (b, a)));
    pairs
        .map(|(a, b)| (a, b, budget.input_correlation(a, b)))
        .filter(|(.., r)| *r != 0.0)
        .map(|(a, b, r)| json!({"a": inputs[a].name, "b": inputs[b].name, "r": r}))
        .collect()
}
