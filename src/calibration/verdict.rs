//! Whether points and their fit carry what was asked.

use serde::Serialize;
use trifacet_optics::FACETS;
use trifacet_optics::calibration::fit::{Dropped, Fitted};
use trifacet_optics::calibration::point::Point;
use trifacet_optics::calibration::pointing::Pointing;
use trifacet_optics::calibration::result::RangeUncertainty;

/// What a calibration must reach.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Wanted {
    /// Standard uncertainty of the translations over the range, micrometres; `None`: reported only.
    pub um: Option<f64>,
    /// Standard uncertainty of the angles over the range, microradians; `None`: reported only.
    pub urad: Option<f64>,
    /// Range of the translations to both sides, millimetres.
    pub range_mm: f64,
    /// Range of the angles to both sides, milliradians.
    pub range_mrad: f64,
}

/// What the tests of a fit found.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Verdict {
    /// Reasons to refuse the fit.
    pub refusals: Vec<String>,
    /// What to know when using it.
    pub warnings: Vec<String>,
}

/// Angles that move by less, rms in radians, say nothing about the scale of the angles.
const UNMOVED: f64 = 50e-6;

/// Refuses points that cannot carry what is wanted, whatever their noise. `points` without those of scans.
///
/// # Errors
/// What is missing, and which measurement would help.
pub fn before(points: &[Point], wanted: &Wanted, steering_scale: Option<f64>) -> Result<(), String> {
    let with_reference = |p: &&Point| p.reference.iter().any(Option::is_some);
    let measured: Vec<&Point> = points.iter().filter(with_reference).collect();
    if measured.is_empty() {
        if steering_scale.is_none() {
            return Err("free motion only: no point has a reference (ref_tx_m ... ref_yaw_rad), and without one \
                        the scale of all poses is that of the steering's readback, which is not known. Measure \
                        points with a reference, or state how well the scale of the readback is known with \
                        --steering-scale-percent"
                .to_owned());
        }
        return free_motion(steering_scale);
    }
    if wanted.urad.is_some() {
        let spread = |axis: usize| {
            let values = measured.iter().filter_map(|p| p.reference[axis]).map(|known| known.value);
            let (n, sum) = values.clone().fold((0.0, 0.0), |(n, sum), x| (n + 1.0, sum + x));
            if n == 0.0 { 0.0 } else { (values.map(|x| (x - sum / n).powi(2)).sum::<f64>() / n).sqrt() }
        };
        let largest = (3..6).map(spread).fold(0.0, f64::max);
        if largest < UNMOVED {
            return Err(format!(
                "translations only: the reference measured no rotation of more than {:.1} urad rms, so that the \
                 scale of the angles is not in the data, and --want-urad cannot be reached. Measure points that \
                 are also rotated, by up to {} mrad about each axis",
                largest * 1e6,
                wanted.range_mrad
            ));
        }
    }
    Ok(())
}

/// The tolerances of the PSDs alone tell the scale of the poses of a head to about 0.6 %. A readback that is known less
/// well than this, in percent, adds nothing to them.
const LOOSEST_SCALE: f64 = 1.0;

/// Points without a reference need a readback whose scale is known.
fn free_motion(steering_scale: Option<f64>) -> Result<(), String> {
    match steering_scale {
        Some(percent) if percent > LOOSEST_SCALE => Err(format!(
            "free motion only, with the scale of the steering's readback known to {percent} %: the tolerances of the \
             PSDs tell the scale to about 0.6 %, so that the poses would be no better than those of the nominal head. \
             Measure points with a reference, or the scale of the readback: {LOOSEST_SCALE} % is allowed, 0.1 % is \
             good"
        )),
        _ => Ok(()),
    }
}

/// More dropped points than this part mean that something else is wrong.
const MOST_DROPPED: f64 = 0.02;

/// Judges a fit.
pub fn verdict(
    fitted: &Fitted,
    points: &[Point],
    range: Option<&RangeUncertainty>,
    wanted: &Wanted,
) -> Verdict {
    let mut verdict = Verdict::default();
    let dropped = fitted.dropped.len();
    if dropped as f64 > MOST_DROPPED * points.len() as f64 {
        let unsolved = fitted.dropped.iter().filter(|(_, why)| *why == Dropped::Unsolved).count();
        verdict.refusals.push(format!(
            "{dropped} of {} points do not fit ({unsolved} have no solution), allowed are {:.0} %: the stated \
             standard uncertainties are too small, or the points do not belong to this head",
            points.len(),
            100.0 * MOST_DROPPED
        ));
    }
    if let Some(pointing) = &fitted.pointing {
        // Beside a refusal it is the likely cause of it.
        let list = if refused(&verdict, fitted) { &mut verdict.refusals } else { &mut verdict.warnings };
        list.push(pointing_advice(pointing));
    }
    cost(fitted, &mut verdict);
    held_out(fitted, &mut verdict);
    match range {
        Some(range) => {
            uncertainty(range, wanted, &mut verdict);
            reach(range, points, wanted, &mut verdict);
        }
        None => verdict.refusals.push("the zero of the reference is out of reach of the PSDs".to_owned()),
    }
    whiteness(fitted, &mut verdict);
    verdict
}

/// What a residual of the steering beyond the stated one means, and what helps.
pub fn pointing_advice(pointing: &Pointing) -> String {
    let (residual, stated) = (pointing.residual * 1e6, pointing.stated * 1e6);
    format!(
        "the beam is {residual:.2} um off the readback of the steering (one standard deviation), where {stated:.2} um \
         is stated: the direction of the laser drifted during the measurement, or the readback is noisier than \
         stated. State the drift with --readback-um {residual:.1}, or for each point in the columns std_stage_x_m and \
         std_stage_y_m"
    )
}

/// Whether too many points do not fit, or those that remain do not fit well.
fn refused(verdict: &Verdict, fitted: &Fitted) -> bool {
    !verdict.refusals.is_empty() || fitted.cost_per_row() > HIGHEST_COST
}

/// Largest cost per row of a fit that is not refused.
const HIGHEST_COST: f64 = 1.2;

fn cost(fitted: &Fitted, verdict: &mut Verdict) {
    let per_row = fitted.cost_per_row();
    if per_row > HIGHEST_COST {
        verdict.refusals.push(format!(
            "chi-square per row is {per_row:.2}, allowed is up to 1.2: the stated standard uncertainties of the \
             points are too small, the reference drifted, or the error of a PSD has ripple finer than {:.2} mm. \
             Check ref_std_ and std_ columns; measure more readings per point",
            fitted.calibration.field.knots * 1e3
        ));
    } else if per_row < 0.6 {
        verdict.warnings.push(format!(
            "chi-square per row is {per_row:.2}, expected is 0.6 to 1.2: the stated standard uncertainties of the \
             points are larger than their scatter"
        ));
    }
}

fn held_out(fitted: &Fitted, verdict: &mut Verdict) {
    let held_out = &fitted.held_out;
    if held_out.rows == 0 {
        return;
    }
    let per_row = held_out.per_row();
    let scatter = 4.0 * (2.0 / held_out.rows as f64).sqrt();
    let limit = 1.4_f64.max(1.0 + scatter);
    if per_row > limit {
        verdict.refusals.push(format!(
            "chi-square per row of the points held out is {per_row:.2}, allowed is up to {limit:.2}: the fit does \
             not predict new points as well as it states. Measure more points over the range"
        ));
    } else if per_row < 0.7_f64.min(1.0 - scatter) {
        verdict.warnings.push(format!(
            "chi-square per row of the points held out is {per_row:.2}: the fit is better than it states"
        ));
    }
}

fn uncertainty(range: &RangeUncertainty, wanted: &Wanted, verdict: &mut Verdict) {
    for (kind, axes, limit, unit, help) in [
        (
            0,
            ["tx", "ty", "tz"],
            wanted.um,
            "um",
            "more points with a reference in all six coordinates, over the range and a tenth beyond",
        ),
        (
            3,
            ["roll", "pitch", "yaw"],
            wanted.urad,
            "urad",
            "more points that are rotated about all axes, with a reference of the angles, over the range and a \
             tenth beyond",
        ),
    ] {
        let Some(limit) = limit else { continue };
        let stated = |i: usize| range.deviation[kind + i] * 1e6;
        let over: Vec<String> = (0..3)
            .filter(|i| stated(*i) > limit)
            .map(|i| format!("{} {:.2} {unit}", axes[i], stated(i)))
            .collect();
        if !over.is_empty() {
            verdict.refusals.push(format!(
                "the standard uncertainty over the range of +-{} mm and +-{} mrad is {}, wanted is {limit} {unit}. \
                 What helps: {help}",
                wanted.range_mm,
                wanted.range_mrad,
                over.join(", "),
            ));
        }
    }
    for (psd, covered) in FACETS.into_iter().zip(range.covered) {
        if covered < 0.98 {
            verdict.warnings.push(format!(
                "{:.0} % of the range of +-{} mm and +-{} mrad leads to places of PSD {psd} without readings: \
                 poses there are flagged, and their uncertainty is larger",
                100.0 * (1.0 - covered),
                wanted.range_mm,
                wanted.range_mrad
            ));
        }
    }
}

/// Without a reference, only motion of the mirror tells the errors of the PSDs apart from the pose.
fn reach(range: &RangeUncertainty, points: &[Point], wanted: &Wanted, verdict: &mut Verdict) {
    let referenced = points.iter().any(|p| p.reference.iter().any(Option::is_some));
    let least = range.covered.into_iter().fold(1.0, f64::min);
    if !referenced && least < LEAST_COVERED {
        verdict.refusals.push(format!(
            "the points reach only {:.0} % of the spots of the range of +-{} mm and +-{} mrad: a scan of the steering \
             with the mirror at rest does not calibrate poses. Add free motion: some hundred points with the mirror \
             at rest at poses over the whole range, the steering following; or state a smaller range with --range-mm \
             and --range-mrad",
            100.0 * least,
            wanted.range_mm,
            wanted.range_mrad
        ));
    }
}

/// Least part of the spots of the range that points without a reference must reach on each PSD.
const LEAST_COVERED: f64 = 0.5;

/// Consecutive residuals of the steering that resemble each other show that the laser's direction drifts.
fn whiteness(fitted: &Fitted, verdict: &mut Verdict) {
    let residuals: Vec<[f64; 2]> = fitted.steering.iter().flatten().copied().collect();
    let n = residuals.len();
    if n < 20 {
        return;
    }
    for (axis, name) in ["x", "y"].into_iter().enumerate() {
        let mean = residuals.iter().map(|r| r[axis]).sum::<f64>() / n as f64;
        let product = |a: &[f64; 2], b: &[f64; 2]| (a[axis] - mean) * (b[axis] - mean);
        let own: f64 = residuals.iter().map(|r| product(r, r)).sum();
        let next: f64 = residuals.windows(2).map(|w| product(&w[0], &w[1])).sum();
        let correlation = next / own;
        if correlation > 5.0 / (n as f64).sqrt() {
            verdict.warnings.push(format!(
                "the residuals of the steering along {name} follow each other (correlation {correlation:.2} from \
                 point to point): the direction of the laser drifted during the measurement"
            ));
        }
    }
}
