//! The equations of the paper as printed, compared with the law of reflection: the print is wrong where
//! docs/sensor-model.md states it, and the model of this project is right.

use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_4};

use trifacet_optics::{Head, Model, Optics, Pose, Vec2, Vec3};

const R_PSD: f64 = 0.25;

fn pose() -> Pose {
    Pose { t: Vec3::new(1e-3, -2e-3, 0.5e-3), roll: 0.011, pitch: -0.007, yaw: 0.02 }
}

fn head() -> Head {
    Head::nominal(R_PSD, 0.013, FRAC_PI_4, 0.46e-3).unwrap()
}

/// The normals of the facets by plain rotation.
fn normals(pose: &Pose) -> [Vec3; 3] {
    head().facets.map(|n| pose.rotation() * n)
}

#[test]
fn equation_5_has_the_wrong_sign_in_n_a() {
    let pose = pose();
    let ((sb, cb), cg) = (pose.pitch.sin_cos(), pose.roll.cos());
    let true_n_a = normals(&pose)[0].z;
    let printed = -FRAC_1_SQRT_2 * (sb + cb * cg);
    let corrected = FRAC_1_SQRT_2 * (-sb + cb * cg);
    assert!((corrected - true_n_a).abs() < 1e-15);
    assert!((printed - true_n_a).abs() > 1.0, "the printed normal of facet A points downwards");
}

#[test]
fn equations_6_and_7_have_a_wrong_sine_in_l_b_and_l_c() {
    let pose = pose();
    let ((sa, ca), (sb, cb), (sg, cg)) = (pose.yaw.sin_cos(), pose.pitch.sin_cos(), pose.roll.sin_cos());
    for (facet, sign) in [(1, 1.0), (2, -1.0)] {
        let l = |gamma_of_second_term: f64| {
            FRAC_1_SQRT_2
                * (-0.5 * ca * cb
                    + sign * 0.75_f64.sqrt() * (ca * sb * sg - sa * gamma_of_second_term)
                    + (ca * sb * cg + sa * sg))
        };
        let truth = normals(&pose)[facet].x;
        assert!((l(cg) - truth).abs() < 1e-15);
        assert!((l(sg) - truth).abs() > 0.01, "facet {facet}");
    }
}

#[test]
fn equation_12_places_the_spot_of_b_far_outside_its_psd_at_rest() {
    // At zero pose the sub-beam runs straight to PSD B, whose middle it must hit.
    let v = Vec3::new(-0.5, 0.75_f64.sqrt(), 0.0);
    let root3 = 3.0_f64.sqrt();
    // Eq. 12, row B, at t = 0 and x_B = 0 (Eq. 13), solved for y_B.
    let printed_u = root3 * R_PSD + R_PSD * (-root3 * v.x + v.y) / (v.x + root3 * v.y);
    assert!((printed_u - 0.866).abs() < 1e-3, "866 mm from the middle of a PSD of 13 mm");

    let rest = Optics::new(&head()).trace(Model::Ray, &Pose::default(), Vec2::zeros()).unwrap();
    assert!(rest.spots[2].abs() < 1e-15);

    // The inverse of T_B (Eq. 11) transforms a point of the world into the frame of PSD B, as the model does.
    let p = Vec3::new(-0.12, 0.21, 0.003);
    let psd = head().psds[1];
    let local = |axis: Vec3| (p - psd.origin).dot(&axis);
    let corrected_x = p.x / 2.0 - root3 / 2.0 * p.y + R_PSD;
    let corrected_y = root3 / 2.0 * p.x + p.y / 2.0;
    assert!((local(psd.x) - corrected_x).abs() < 1e-15);
    assert!((local(psd.y) - corrected_y).abs() < 1e-15);
}

#[test]
fn equation_11_names_its_third_matrix_wrongly() {
    // Its translation is the place of PSD C.
    let third = Vec3::new(-R_PSD / 2.0, -3.0_f64.sqrt() / 2.0 * R_PSD, 0.0);
    assert!((head().psds[2].origin - third).norm() < 1e-15);
    assert!((head().psds[1].origin - third).norm() > R_PSD);
}
