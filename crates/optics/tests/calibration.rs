//! Calibrations of simulated heads, whose points and true poses an independent program has computed. The fit of the mild
//! head is in `tests/system/calibrate_fit.rs`, through the program.

#![allow(clippy::unwrap_used, reason = "a test")]

use std::collections::HashMap;
use std::fs;
use std::path::Path;

use nalgebra::Matrix6;
use trifacet_optics::calibration::fit::{self, Fitted, Job, fit};
use trifacet_optics::calibration::mistakes;
use trifacet_optics::calibration::parameters::{Nominal, Tolerances};
use trifacet_optics::calibration::point::{Known, Point};
use trifacet_optics::calibration::result::{Calibration, Raw};
use trifacet_optics::calibration::revisits::correct;
use trifacet_optics::calibration::spread::Spread;
use trifacet_optics::{Estimator, Head, Model, Optics, Pose, Rigid, Signals};

type Table = Vec<HashMap<String, f64>>;

fn table(name: &str) -> Table {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/reference/calibration");
    let text = fs::read_to_string(folder.join(name)).unwrap();
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let number = |text: &str| text.parse::<f64>().unwrap();
    lines
        .map(|line| header.iter().map(|h| (*h).to_owned()).zip(line.split(',').map(number)).collect())
        .collect()
}

const SPOTS: [&str; 6] = ["u_a_m", "v_a_m", "u_b_m", "v_b_m", "u_c_m", "v_c_m"];
const POWERS: [&str; 3] = ["power_a", "power_b", "power_c"];
const POSE: [&str; 6] = ["tx_m", "ty_m", "tz_m", "roll_rad", "pitch_rad", "yaw_rad"];

fn points(head: &str) -> Vec<Point> {
    let point = |row: &HashMap<String, f64>| {
        let known = |value: String, deviation: String| {
            let value = row.get(&value).copied().filter(|x| x.is_finite())?;
            Some(Known { value, deviation: row[&deviation] })
        };
        Point {
            spots: SPOTS.map(|name| row[name]),
            spot_deviations: SPOTS.map(|name| row[&format!("std_{name}")]),
            powers: POWERS.map(|name| row[name]),
            power_deviations: POWERS.map(|name| row[&format!("std_{name}")]),
            reference: POSE.map(|name| known(format!("ref_{name}"), format!("ref_std_{name}"))),
            steering: Some(
                ["stage_x_m", "stage_y_m"].map(|name| Known { value: row[name], deviation: 0.1e-6 }),
            ),
            run: None,
        }
    };
    let mut points: Vec<Point> = table(&format!("{head}.points.csv")).iter().map(point).collect();
    points.extend(table(&format!("{head}.scan.csv")).iter().map(|row| point(row).of_scan(0)));
    points
}

fn nominal() -> Nominal {
    Nominal {
        head: Head::default(),
        steering_matrix: nalgebra::Matrix2::identity(),
        steering_origin: nalgebra::Vector2::zeros(),
        stage: Rigid::identity(),
        table: Rigid::identity(),
    }
}

/// Errors of the poses relative to the first row, and their covariances by the calibration.
fn errors(head: &str, calibration: &Calibration) -> Vec<([f64; 6], Matrix6<f64>)> {
    let rows = table(&format!("{head}.test.csv"));
    let estimator = Estimator::new(Optics::new(&calibration.head()), Model::Gaussian);
    let [base, tool] = calibration.base_and_tool();
    let gains = calibration.power_gains();
    let raw =
        |row: &HashMap<String, f64>| Raw { spots: SPOTS.map(|n| row[n]), powers: POWERS.map(|n| row[n]) };
    let pose = |raw: &Raw| {
        let mut spots = raw.spots;
        for i in 0..3 {
            let [du, dv] = calibration.correction(i, [raw.spots[2 * i], raw.spots[2 * i + 1]]);
            spots[2 * i] += du;
            spots[2 * i + 1] += dv;
        }
        let powers = [0, 1, 2].map(|i| raw.powers[i] / gains[i]);
        let solution = estimator.solve(&Signals { spots, powers }, None).unwrap();
        base * Rigid::from(&solution.pose) * tool
    };
    let raws: Vec<Raw> = rows.iter().map(raw).collect();
    let tare = pose(&raws[0]).inverse();
    let covariances = calibration.relative_covariances(&raws[1..], &raws[0]).unwrap();
    rows[1..]
        .iter()
        .zip(&raws[1..])
        .zip(covariances)
        .map(|((row, raw), covariance)| {
            let found = Pose::from(&(tare * pose(raw))).to_array();
            let mut error = [0.0; 6];
            for (i, name) in POSE.iter().enumerate() {
                error[i] = found[i] - row[*name];
            }
            (error, covariance.unwrap())
        })
        .collect()
}

/// Rms and largest error of translations and angles.
fn rms(errors: &[([f64; 6], Matrix6<f64>)]) -> [f64; 4] {
    let all = |range: std::ops::Range<usize>| errors.iter().flat_map(move |(e, _)| e[range.clone()].to_vec());
    let rms = |range: std::ops::Range<usize>| {
        (all(range.clone()).map(|x| x * x).sum::<f64>() / all(range).count() as f64).sqrt()
    };
    let largest = |range| all(range).fold(0.0_f64, |a, b| a.max(b.abs()));
    [rms(0..3), rms(3..6), largest(0..3), largest(3..6)]
}

fn assert_figures(head: &str, fitted: &Fitted, rms_limits: (f64, f64)) {
    let errors = errors(head, &fitted.calibration);
    let near = rms(&errors[..100]);
    let far = rms(&errors[100..]);
    let held = errors[100..].iter().flat_map(|(e, c)| (0..6).map(|i| e[i].abs() <= 1.96 * c[(i, i)].sqrt()));
    let held = held.filter(|held| *held).count() as f64 / (6 * (errors.len() - 100)) as f64;
    println!(
        "{head}: near {near:?}, far {far:?}, intervals hold {held:.4}, cost per row {}, field {:?}",
        fitted.cost_per_row(),
        fitted.calibration.field
    );
    assert!(near[0] <= 0.04e-6 && near[1] <= 0.10e-6, "{near:?}");
    assert!(far[0] <= rms_limits.0 && far[1] <= rms_limits.1, "{far:?}");
    assert!(far[2] <= 0.7e-6 && far[3] <= 1.7e-6, "{far:?}");
    assert!((0.93..=0.995).contains(&held), "{held}");
    assert!((0.7..=1.1).contains(&fitted.cost_per_row()), "{}", fitted.cost_per_row());
}

fn calibrated(head: &str) -> Fitted {
    let (points, nominal, tolerances) = (points(head), nominal(), Tolerances::default());
    let fields = fit::fields();
    let job = Job { nominal: &nominal, tolerances: &tolerances, points: &points, fields: &fields };
    fit(job, |progress| println!("{progress:?}")).unwrap()
}

#[test]
fn the_rough_head_is_calibrated_and_its_false_references_are_found() {
    let fitted = calibrated("rough");
    let lines: Vec<usize> = fitted.dropped.iter().map(|(k, _)| k + 2).collect();
    assert_eq!(lines, [174, 219, 639]);
    assert_figures("rough", &fitted, (0.10e-6, 0.25e-6));
}

#[test]
fn a_fit_repeats_to_the_last_digit() {
    let (points, nominal, tolerances) = (points("mild"), nominal(), Tolerances::default());
    let fields = [fit::FIRST_FIELD];
    let job = Job { nominal: &nominal, tolerances: &tolerances, points: &points[..60], fields: &fields };
    let [a, b] = [0, 1].map(|_| fit(job, |_| ()).unwrap().calibration.theta);
    assert_eq!(a, b);
}

/// The covariance for every frame agrees with that of all parameters: within the range of the run and somewhat beyond,
/// for several zeros.
#[test]
fn the_covariance_for_every_frame_is_that_of_the_calibration() {
    let (points, nominal, tolerances) = (points("rough"), nominal(), Tolerances::default());
    let fields = [fit::FIRST_FIELD];
    let job = Job { nominal: &nominal, tolerances: &tolerances, points: &points[..300], fields: &fields };
    let calibration = fit(job, |_| ()).unwrap().calibration;
    let spread = calibration.spread([1e-3, 5e-3]).unwrap();
    let spread = Spread::new(spread.data().clone()).unwrap();
    let [base, tool] = calibration.base_and_tool();
    let seen = |k: u32, scale: f64| {
        let unit = |axis: u32| (f64::from(k) * 0.618_034 * f64::from(axis + 1).sqrt()).fract() * 2.0 - 1.0;
        let pose = std::array::from_fn(|i| unit(i as u32) * scale * if i < 3 { 1e-3 } else { 5e-3 });
        let reference = Pose::from_array(pose);
        let raw = calibration.reading(&reference)?;
        let mut spots = raw.spots;
        for i in 0..3 {
            let [du, dv] = calibration.correction(i, [raw.spots[2 * i], raw.spots[2 * i + 1]]);
            spots[2 * i] += du;
            spots[2 * i + 1] += dv;
        }
        let sensor = Pose::from(&(base.inverse() * Rigid::from(&reference) * tool.inverse()));
        Some((reference, raw, sensor, spots))
    };
    for (zero, near, scale, most) in
        [(0, 0.0, 1.0, 0.05), (0, 0.0, 0.1, 0.05), (7, 1.0, 1.0, 0.05), (0, 0.0, 1.3, 0.1)]
    {
        let zero = seen(zero, near).unwrap();
        let prepared = spread.zero(&zero.2, &zero.3);
        let all: Vec<_> = (1..=100).filter_map(|k| seen(k, scale)).collect();
        let raws: Vec<_> = all.iter().map(|(_, raw, ..)| *raw).collect();
        let exact = calibration.relative_covariances(&raws, &zero.1).unwrap();
        let (mut ratios, mut forms) = (Vec::new(), Vec::new());
        for ((reference, _, sensor, spots), exact) in all.iter().zip(exact) {
            let exact = exact.unwrap();
            let found = spread.relative(&prepared, sensor, spots);
            let at = Pose::from(&(Rigid::from(&zero.0).inverse() * Rigid::from(reference)));
            let axes = zero.0.rotation().transpose() * base.rotation;
            let mut turn = Matrix6::zeros();
            turn.fixed_view_mut::<3, 3>(0, 0).copy_from(&axes);
            turn.fixed_view_mut::<3, 3>(3, 3).copy_from(&(at.euler_rates() * axes));
            let found = turn * found.covariance * turn.transpose();
            let deviation = |c: &Matrix6<f64>, i: usize| c[(i, i)].sqrt();
            ratios.extend((0..6).map(|i| deviation(&found, i) / deviation(&exact, i)));
            forms.push((exact.cholesky().unwrap().inverse() * found).trace() / 6.0);
        }
        ratios.sort_by(f64::total_cmp);
        forms.sort_by(f64::total_cmp);
        let ends = |x: &[f64]| [x[0], x[x.len() / 2], x[x.len() - 1]];
        assert!(ratios.iter().all(|ratio| (ratio - 1.0).abs() < most), "{:?}", ends(&ratios));
        assert!(forms.iter().all(|form| (form - 1.0).abs() < 2.0 * most), "{:?}", ends(&forms));
    }
}

/// What the check before a fit says about the points of the mild head, changed.
fn mistake(change: impl Fn(&mut Point)) -> String {
    let mut points = points("mild");
    points.iter_mut().filter(|point| point.run.is_none()).for_each(change);
    mistakes::check(&nominal(), &points).unwrap_err()
}

fn scale(known: &mut Option<Known>, by: f64) {
    *known = known.map(|k| Known { value: k.value * by, deviation: k.deviation * by.abs() });
}

#[test]
fn the_reference_heads_have_no_plain_mistake() {
    for head in ["mild", "rough"] {
        let found = mistakes::check(&nominal(), &points(head)).unwrap().unwrap();
        assert_eq!(found.moved, [true; 6]);
        assert!(found.rms[0] > 1e-6 && found.rms[0] < 60e-6, "{found:?}");
    }
}

#[test]
fn reversed_signs_are_named() {
    for (i, axis) in ["tx", "ty", "tz", "roll", "pitch", "yaw"].into_iter().enumerate() {
        let said = mistake(|point| scale(&mut point.reference[i], -1.0));
        assert_eq!(said, format!("the sign of ref_{axis} is reversed"));
    }
    for (i, axis) in ["u of PSD A", "v of PSD A", "u of PSD B", "v of PSD B", "u of PSD C", "v of PSD C"]
        .into_iter()
        .enumerate()
    {
        let said = mistake(|point| point.spots[i] = -point.spots[i]);
        assert_eq!(said, format!("the sign of {axis} is reversed"));
    }
}

#[test]
fn exchanged_axes_and_psds_are_named() {
    assert_eq!(mistake(|point| point.reference.swap(0, 1)), "ref_tx and ref_ty are exchanged");
    assert_eq!(mistake(|point| point.reference.swap(3, 5)), "ref_roll and ref_yaw are exchanged");
    for (i, j, names) in [(0, 1, "A and B"), (0, 2, "A and C"), (1, 2, "B and C")] {
        let said = mistake(|point| {
            point.powers.swap(i, j);
            for k in 0..2 {
                point.spots.swap(2 * i + k, 2 * j + k);
            }
        });
        assert_eq!(said, format!("PSDs {names} are exchanged"));
    }
}

#[test]
fn wrong_units_are_named() {
    let translations = |by: f64| mistake(|p| p.reference[..3].iter_mut().for_each(|k| scale(k, by)));
    let angles = |by: f64| mistake(|p| p.reference[3..].iter_mut().for_each(|k| scale(k, by)));
    assert!(translations(1.0 / 25.4).contains("inches where millimetres"));
    assert!(translations(25.4).contains("millimetres where inches"));
    assert!(angles(180.0 / std::f64::consts::PI).contains("degrees instead of radians"));
    assert!(angles(std::f64::consts::PI / 180.0).contains("57.3"));
    assert!(angles(1.0 / 4.848_136_811).contains("seconds of arc where microradians"));
    let both = mistake(|p| p.reference[..3].iter_mut().for_each(|k| scale(k, -1.0 / 25.4)));
    assert!(both.contains("inches") && both.contains("the sign of ref_tz is reversed"), "{both}");
}

#[test]
fn a_readback_that_does_not_follow_the_beam_is_named() {
    let said = mistake(|point| {
        if let Some([x, _]) = &mut point.steering {
            x.value = -x.value;
        }
    });
    assert!(said.contains("the readback of the steering does not follow the beam"), "{said}");
}

/// The points of a stage of the mild head, with its first pose visited again every 20 points; without drift, and with one of
/// the spots that grows to `size` and a drift of the beam that grows as much.
fn drifting(size: f64) -> (Vec<Point>, Vec<Point>) {
    let all: Vec<Point> = points("mild").into_iter().filter(Point::has_pose).take(300).collect();
    // Numbers around zero with a deviation of one, which do not repeat.
    let noise = |k: usize, i: usize| {
        let x = (k as f64 * 12.989_8 + i as f64 * 78.233).sin() * 43_758.545_3;
        (x - x.floor() - 0.5) * 12.0_f64.sqrt()
    };
    let mut still = Vec::new();
    for (k, point) in all.iter().enumerate() {
        if k % 20 == 0 {
            let mut visit = all[0].clone();
            for i in 0..6 {
                visit.spots[i] += noise(k, i) * visit.spot_deviations[i];
                if let Some(known) = &mut visit.reference[i] {
                    known.value += noise(k, 6 + i) * known.deviation;
                }
            }
            still.push(visit);
        }
        still.push(point.clone());
    }
    let mut moved = still.clone();
    let n = still.len() as f64;
    for (k, point) in moved.iter_mut().enumerate() {
        let part = size * k as f64 / n;
        point
            .spots
            .iter_mut()
            .zip([1.0, -0.5, 0.7, 1.0, -1.0, 0.3])
            .for_each(|(spot, by)| *spot += by * part);
        if let Some(readback) = &mut point.steering {
            for axis in readback {
                axis.value += part;
            }
        }
    }
    (still, moved)
}

/// The drift of the pose that the nominal head shows for that of the spots is nearly the same at all poses.
#[test]
fn revisits_show_a_drift_and_it_is_taken_off_all_points() {
    let (still, mut moved) = drifting(5e-6);
    let times: Vec<f64> = (0..still.len()).map(|k| k as f64).collect();
    let estimator = Estimator::new(Optics::new(&Head::default()), Model::Gaussian);
    let pose = |p: &Point| {
        let solution = estimator.solve(&Signals { spots: p.spots, powers: p.powers }, None).unwrap();
        solution.pose.to_array()
    };
    let drifts: Vec<[f64; 6]> = still
        .iter()
        .zip(&moved)
        .map(|(still, moved)| std::array::from_fn(|i| pose(moved)[i] - pose(still)[i]))
        .collect();
    let found = correct(&nominal(), &mut moved, &times);
    assert_eq!(found.visits.len(), 16, "15 visits, and the point itself: {:?}", found.visits);
    let drifted: Vec<usize> = found.drifted.iter().map(|(i, _)| *i).collect();
    assert!([0, 1, 3, 4, 6, 7].iter().all(|i| drifted.contains(i)), "{:?}", found.drifted);
    for i in drifted.into_iter().filter(|i| *i < 6) {
        // What was added to the references, less the drift of the readings; up to a constant.
        let left: Vec<(f64, f64)> = (0..still.len())
            .map(|k| {
                let (before, after) = (still[k].reference[i].unwrap(), moved[k].reference[i].unwrap());
                assert!(after.deviation > before.deviation, "the uncertainty of the drift is added");
                let added = (after.deviation.powi(2) - before.deviation.powi(2)).sqrt();
                (after.value - before.value - drifts[k][i], added)
            })
            .collect();
        let mean = left.iter().map(|(x, _)| x).sum::<f64>() / left.len() as f64;
        let worst = left.iter().map(|(x, added)| (x - mean).abs() / added).fold(0.0, f64::max);
        assert!(worst < 4.0, "{i}: {worst}");
    }
    // Nothing is left.
    assert!(correct(&nominal(), &mut moved, &times).drifted.is_empty());
}

#[test]
fn revisits_that_differ_by_noise_or_by_one_false_reading_change_nothing() {
    let (still, mut same) = drifting(0.0);
    let times: Vec<f64> = (0..still.len()).map(|k| k as f64).collect();
    let found = correct(&nominal(), &mut same, &times);
    assert!(found.visits.len() == 16 && found.drifted.is_empty(), "{found:?}");
    assert_eq!(same, still);
    let mut wrong = still.clone();
    for spot in &mut wrong[found.visits[7]].spots {
        *spot += 40e-6;
    }
    let before = wrong.clone();
    let found = correct(&nominal(), &mut wrong, &times);
    assert!(found.drifted.is_empty(), "{found:?}");
    assert_eq!(wrong, before);
}
