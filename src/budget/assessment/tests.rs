use trifacet_optics::{Estimator, Noise, Signals, Vec2};

use super::*;
use crate::config::{Config, parse};

fn basis(text: &str) -> (Basis<'static>, Config) {
    let config = parse(text, None).unwrap();
    let instrument = config.instrument().unwrap();
    (
        Basis {
            instrument,
            components: Components::new(&config, 1, None),
            calibration: None,
            objection: Some("no record".into()),
        },
        config,
    )
}

fn pose(um_urad: [f64; 6]) -> Pose {
    Pose::from_array(um_urad.map(|value| value * 1e-6))
}

/// Root of the sum of squares of the sensitivities of a row.
fn sensitivity(assessment: &Assessment, name: &str) -> [f64; 6] {
    let (_, range) =
        assessment.rows().find(|(group, _)| group.name == name).unwrap_or_else(|| panic!("{name}"));
    std::array::from_fn(|j| {
        range.clone().map(|i| assessment.budget.sensitivity(j, i).powi(2)).sum::<f64>().sqrt()
    })
}

#[test]
fn the_noise_is_that_of_the_estimator() {
    let (basis, config) = basis("uncertainty.tare_readings = 1000000000");
    let at = pose([400.0, -300.0, 200.0, 1500.0, -2500.0, 800.0]);
    let assessment = basis.assess(&at).unwrap();
    let estimator = Estimator::new(config.optics().unwrap(), config.estimation.model.into());
    let reading = estimator.optics().trace(estimator.model(), &at, Vec2::zeros()).unwrap();
    let signals = Signals { spots: reading.spots, powers: reading.powers };
    let noise = Noise { spots: [1.08e-6; 6], powers: reading.powers.map(|power| 1e-3 * power) };
    let solution = estimator.solve(&signals, None).unwrap();
    let expected = estimator.sensitivity(&solution).unwrap().spread(&noise).pose_covariance();
    for (j, (name, _)) in MEASURANDS.iter().enumerate() {
        let noise: f64 = assessment
            .rows()
            .filter(|(group, _)| group.name.ends_with("noise, pose"))
            .flat_map(|(_, range)| range)
            .map(|i| assessment.budget.contribution(j, i).powi(2))
            .sum();
        // The covariance of the estimator is that of the sensor's pose, the budget that of the pose relative to
        // the tare at the origin: the same.
        assert!((noise / expected[(j, j)] - 1.0).abs() < 1e-5, "{name}: {noise} {}", expected[(j, j)]);
    }
}

#[test]
fn sensitivities_at_rest_are_those_of_the_geometry() {
    let (basis, _) = basis(
        "[uncertainty]\ntemperature_range_k = 1\npointing_urad = 1\nheight_difference_mm = 50\n\
         beam_offset_um = 20\nreference_scale_ppm = 10\nreference_squareness_urad = 5\n",
    );
    let (s, m) = (
        basis.assess(&Pose::default()).unwrap(),
        basis.assess(&pose([1000.0, 0.0, 0.0, 0.0, 5000.0, 0.0])).unwrap(),
    );
    // Rows: tx, ty, tz, roll, pitch, yaw. Distance of the PSDs R = 250 mm: R/2 and 1/2 of the beam's direction.
    let cases: [(&Assessment, &str, [f64; 6], f64); 8] = [
        (&s, "spot noise, pose", [0.913, 0.913, 0.577, 1.633e0, 1.633, 2.309], 1e-3),
        (&s, "power noise, pose", [37.8e-6, 37.8e-6, 0.0, 61.5e-6, 61.5e-6, 0.0], 2e-7),
        (&s, "beam direction since the tare", [0.125, 0.125, 0.0, 0.5, 0.5, 0.0], 1e-3),
        (&s, "beam offset by diameter, pose", [0.417, 0.417, 0.0, 0.679, 0.679, 0.0], 5e-3),
        (&s, "PSD zero drift", [0.913, 0.913, 0.577, 1.633, 1.633, 2.309], 1e-3),
        (&m, "PSD gain drift", [1e-3, 0.0, 0.12e-3, 0.0, 5e-3, 0.0], 3e-5),
        (&m, "PSD distance drift", [0.0, 0.0, 0.0, 0.0, 5e-3, 0.0], 3e-5),
        (&m, "height drift", [0.0, 0.0, 1.0, 0.0, 0.0, 0.0], 1e-9),
    ];
    for (assessment, name, expected, limit) in cases {
        let found = sensitivity(assessment, name);
        for j in 0..6 {
            // Rotations per metre, in urad/um, are 1 as they stand; the tolerance is in the unit of the table.
            assert!((found[j] - expected[j]).abs() < limit, "{name}, {}: {}", MEASURANDS[j].0, found[j]);
        }
    }
    let u = |name: &str| s.groups.iter().find(|group| group.name == name).unwrap().inputs[0].0.std;
    // 40 ppm/K of 13 mm, and 23 ppm/K of 50 mm, at a temperature that cycles within 1 K.
    assert!((u("PSD zero drift") - 0.52e-6 / 2.0_f64.sqrt()).abs() < 1e-12);
    assert!((u("height drift") - 1.15e-6 / 2.0_f64.sqrt()).abs() < 1e-12);
    // A step of 18 bits over +-10 V on 6.5 mm per 10 V, over the root of 12.
    assert!((u("converter, pose") - 13e-3 / 2.0_f64.powi(18) / 12.0_f64.sqrt()).abs() < 1e-14);
}

#[test]
fn at_the_tare_what_is_common_to_pose_and_tare_has_no_effect() {
    let text = "laser.power_uw = 600\nuncertainty.dark_mv = 10\nuncertainty.lever_arm_um = 100\n\
        channels.a.amplifier = 'difference'\nuncertainty.reference_scale_ppm = 100";
    let (basis, _) = basis(text);
    let assessment = basis.assess(&Pose::default()).unwrap();
    for name in ["dark offset of the sum", "lever arm", "reference scale"] {
        assert!(sensitivity(&assessment, name).iter().all(|c| c.abs() < 1e-6), "{name}");
    }
    let far = basis.assess(&pose([1000.0, 0.0, 0.0, 0.0, 0.0, 5000.0])).unwrap();
    // A turn of 5 mrad moves a point on an arm by 5 mrad of the arm's length.
    assert!((sensitivity(&far, "lever arm")[1] - 5e-3).abs() < 1e-5);
    assert!(sensitivity(&far, "dark offset of the sum").iter().any(|c| *c > 1e-4));
}

/// A record that knows the pose relative to the tare to 0.1 um and 0.3 urad at 1 mm, with a correlation.
struct Record;

impl PoseCovariance for Record {
    fn relative_to(&self, tare: &Pose, poses: &[Pose]) -> Option<Vec<Matrix6<f64>>> {
        let one = |pose: &Pose| {
            let way = ((pose.t - tare.t).norm() * 1e3).min(1.0);
            let mut covariance =
                Matrix6::from_diagonal(&[0.1e-6, 0.1e-6, 0.1e-6, 0.3e-6, 0.3e-6, 0.3e-6].into());
            covariance *= covariance;
            (covariance[(0, 4)], covariance[(4, 0)]) = (-0.5 * 0.1e-6 * 0.3e-6, -0.5 * 0.1e-6 * 0.3e-6);
            covariance * way.powi(2)
        };
        Some(poses.iter().map(one).collect())
    }

    fn uncovered(&self, _: &Pose) -> Vec<char> {
        Vec::new()
    }

    fn table(&self) -> Rigid {
        Rigid::identity()
    }

    fn source(&self) -> String {
        "calibration.json".into()
    }
}

#[test]
fn a_calibration_record_enters_with_its_correlations() {
    let config =
        parse("frames.tool.translation_mm = [0, 0, -100]\nuncertainty.lever_arm_um = 0", None).unwrap();
    let basis = Basis {
        instrument: config.instrument().unwrap(),
        components: Components::new(&config, 1_000_000, Some(&Rigid::identity())),
        calibration: Some(&Record),
        objection: None,
    };
    let far = basis.assess(&pose([1000.0, 0.0, 0.0, 0.0, 0.0, 0.0])).unwrap();
    assert_eq!(far.geometry, Geometry::Calibrated);
    // On an arm of -100 mm: tx - 0.1 m * pitch; u^2 = 0.1^2 + 0.03^2 + 2 * 0.5 * 0.1 * 0.03 um^2.
    let (_, range) = far.rows().find(|(group, _)| group.name == "calibration, position").unwrap();
    let rotation = range.start + 4;
    let cross = 2.0
        * far.budget.contribution(0, range.start)
        * far.budget.contribution(0, rotation)
        * far.budget.input_correlation(range.start, rotation);
    assert!((cross / 0.003e-12 - 1.0).abs() < 0.01, "{cross}");
    let u2 = far.budget.covariance()[(0, 0)];
    assert!((far.budget.correlation_share(0) - cross / u2).abs() < 1e-9);
    // The Monte Carlo method draws them with the same correlation.
    let trials = basis.monte_carlo(&far, 0.9545, 20_000, 1).unwrap();
    let ratio = trials.standard_uncertainty(0) / far.budget.standard_uncertainty(0);
    assert!((ratio - 1.0).abs() < 0.03, "{ratio}");
    // At the tare the record states nothing, and the drawing works all the same.
    let tare = basis.assess(&Pose::default()).unwrap();
    assert_eq!(sensitivity(&tare, "calibration, position")[0].round(), 1.0);
    assert!(basis.monte_carlo(&tare, 0.95, 1000, 1).unwrap().failed() == 0);
}

#[test]
fn poses_are_relative_to_the_tare_of_the_configuration() {
    let text = "[frames.base]\ntranslation_mm = [1000, 200, 0]\nrotation_deg = [0, 0, 90]\n\
        [frames.tool]\ntranslation_mm = [0, 0, -50]\n[frames.tare]\ntranslation_mm = [999.7, 200.4, -50]\nrotation_deg = [0, 0, 90]\n";
    let (basis, config) = basis(text);
    assert!(basis.instrument.tared());
    let user = pose([100.0, -200.0, 300.0, 400.0, 500.0, -600.0]);
    let measurement = basis.instrument.measure(&user).unwrap();
    // The frames of the daemon publish the same pose.
    let published = config.frames.build().pose(&measurement.sensor_pose(Moment::Pose)).unwrap();
    for (a, b) in published.to_array().into_iter().zip(user.to_array()) {
        assert!((a - b).abs() < 1e-12, "{a} {b}");
    }
    let undisturbed = measurement.pose(std::iter::empty()).unwrap();
    for (a, b) in undisturbed.into_iter().zip(user.to_array()) {
        assert!((a - b).abs() < 1e-11, "{a} {b}");
    }
    let off = parse("frames.tare.translation_mm = [500, 0, 0]", None).unwrap();
    let error = off.instrument().unwrap().measure(&user).unwrap_err().to_string();
    assert!(error.starts_with("the tare pose is outside the range"), "{error}");
}
