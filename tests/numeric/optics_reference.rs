//! The optics compared with reference cases that an independent program computed from the law of reflection.

use trifacet_optics::{Estimator, Head, Model, Optics, Pose, Signals, Vec2};

fn cases(file: &str) -> Vec<Vec<f64>> {
    let path = format!("{}/tests/reference/{file}", env!("CARGO_MANIFEST_DIR"));
    let mut reader = csv::Reader::from_path(path).expect("a reference file");
    reader.deserialize().map(|row| row.expect("a row of numbers")).collect()
}

fn optics(distance: f64, diameter: f64) -> Optics {
    let head = Head::nominal(distance, 0.013, std::f64::consts::FRAC_PI_4, diameter);
    Optics::new(&head.expect("the nominal head"))
}

#[test]
fn ray_model_agrees_to_a_picometre() {
    for (file, distance) in [("ray.csv", 0.25), ("ray_r180.csv", 0.18)] {
        let optics = optics(distance, 0.46e-3);
        for row in cases(file) {
            let pose = Pose::from_array(row[..6].try_into().unwrap());
            let reading = optics.trace(Model::Ray, &pose, Vec2::zeros()).unwrap();
            for (ours, theirs) in reading.spots.iter().zip(&row[6..]) {
                assert!((ours - theirs).abs() < 1e-12, "{file}: {ours} against {theirs}");
            }
        }
    }
}

#[test]
fn gaussian_model_agrees_to_ten_picometres() {
    for (file, distance, diameter) in [("gaussian.csv", 0.25, 0.46e-3), ("gaussian_r400_w500.csv", 0.4, 1e-3)]
    {
        let optics = optics(distance, diameter);
        for row in cases(file) {
            let pose = Pose::from_array(row[..6].try_into().unwrap());
            let reading = optics.trace(Model::Gaussian, &pose, Vec2::new(row[6], row[7])).unwrap();
            for (ours, theirs) in reading.spots.iter().zip(&row[8..14]) {
                assert!((ours - theirs).abs() < 1e-11, "{file}: {ours} against {theirs}");
            }
            for (ours, theirs) in reading.powers.iter().zip(&row[14..]) {
                assert!((ours - theirs).abs() < 1e-10, "{file}: {ours} against {theirs}");
            }
        }
    }
}

fn assert_pose(pose: &Pose, row: &[f64], file: &str) {
    for (ours, theirs) in pose.to_array().iter().zip(row) {
        assert!((ours - theirs).abs() < 1e-10, "{file}: {ours} against {theirs}");
    }
}

#[test]
fn the_ray_solver_finds_the_reference_poses() {
    for (file, distance) in [("ray.csv", 0.25), ("ray_r180.csv", 0.18)] {
        let estimator = Estimator::new(optics(distance, 0.46e-3), Model::Ray);
        for row in cases(file) {
            let signals = Signals { spots: row[6..12].try_into().unwrap(), powers: [f64::NAN; 3] };
            let solution = estimator.solve(&signals, None).unwrap();
            assert_pose(&solution.pose, &row, file);
        }
    }
}

#[test]
fn the_gaussian_solver_finds_the_reference_poses_and_offsets() {
    for (file, distance, diameter) in [("gaussian.csv", 0.25, 0.46e-3), ("gaussian_r400_w500.csv", 0.4, 1e-3)]
    {
        let estimator = Estimator::new(optics(distance, diameter), Model::Gaussian);
        for row in cases(file) {
            let powers = [row[14], row[15], row[16]].map(|p| p * 0.8e-3);
            let signals = Signals { spots: row[8..14].try_into().unwrap(), powers };
            let solution = estimator.solve(&signals, None).unwrap();
            assert_pose(&solution.pose, &row, file);
            assert!((solution.offset - Vec2::new(row[6], row[7])).amax() < 1e-10, "{file}");
            assert!((solution.total_power - 0.8e-3).abs() < 1e-12, "{file}");
        }
    }
}
