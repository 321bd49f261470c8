//! The budget as a table: a line for each quantity and measurand, then correlations and results.

use super::super::assessment::MEASURANDS;
use super::Report;
use super::rows::dof_text;

const COLUMNS: [&str; 15] = [
    "measurand",
    "measurand_unit",
    "group",
    "quantity",
    "unit",
    "value",
    "u",
    "distribution",
    "type",
    "dof",
    "sensitivity",
    "contribution",
    "share",
    "k",
    "expanded",
];

pub fn csv(report: &Report) -> Result<String, ::csv::Error> {
    let mut out = ::csv::Writer::from_writer(Vec::new());
    out.write_record(COLUMNS)?;
    for (j, (name, unit)) in MEASURANDS.iter().enumerate() {
        quantities(&mut out, report, j)?;
        let budget = &report.assessment.budget;
        let mut record = vec![String::new(); COLUMNS.len()];
        (record[0], record[1]) = ((*name).to_owned(), unit.micro().to_owned());
        let mut correlations = record.clone();
        correlations[3] = "correlations".into();
        correlations[12] = budget.correlation_share(j).to_string();
        out.write_record(correlations)?;
        record[3] = "combined".into();
        record[4] = unit.micro().into();
        record[5] = (report.assessment.pose.to_array()[j] * 1e6).to_string();
        record[6] = (budget.standard_uncertainty(j) * 1e6).to_string();
        record[9] = dof_text(budget.effective_dof(j));
        record[12] = "1".into();
        record[13] = budget.coverage_factor(j, report.probability).to_string();
        record[14] = (budget.expanded(j, report.probability) * 1e6).to_string();
        out.write_record(record)?;
    }
    let bytes = out.into_inner().map_err(|error| ::csv::Error::from(error.into_error()))?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

fn quantities(out: &mut ::csv::Writer<Vec<u8>>, report: &Report, j: usize) -> Result<(), ::csv::Error> {
    let budget = &report.assessment.budget;
    let (name, unit) = MEASURANDS[j];
    for (group, range) in report.assessment.rows() {
        for i in range {
            let input = &budget.inputs()[i];
            out.write_record([
                name,
                unit.micro(),
                &group.name,
                &input.name,
                group.unit.micro(),
                &(input.value * 1e6).to_string(),
                &(input.std * 1e6).to_string(),
                input.distribution.name(),
                input.evaluation.name(),
                &dof_text(Some(input.dof)),
                &budget.sensitivity(j, i).to_string(),
                &(budget.contribution(j, i) * 1e6).to_string(),
                &budget.share(j, i).to_string(),
                "",
                "",
            ])?;
        }
    }
    Ok(())
}
