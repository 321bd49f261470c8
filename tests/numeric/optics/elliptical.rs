//! The elliptical beam against a sum of rays that shares no code with the model.

use trifacet_optics::{Ellipse, Head, Model, Optics, Pose, Psd, Vec2, Vec3};

/// Rays per axis across six standard deviations to each side.
const RAYS: i32 = 600;

/// Sums rays over the beam: each one is reflected by the facet that it meets first.
fn sum_of_rays(head: &Head, [c, s]: [f64; 2], pose: &Pose, offset: Vec2) -> ([[f64; 2]; 3], [f64; 3]) {
    // The light travels straight down here. The covariance is the matrix exponential as a power series.
    let shape = nalgebra::Matrix2::new(c, s, s, -c);
    let covariance =
        (1..20).fold((nalgebra::Matrix2::identity(), nalgebra::Matrix2::identity()), |(sum, term), k| {
            let term = term * shape / f64::from(k);
            (sum + term, term)
        });
    let sigma = head.beam_diameter / 4.0;
    let inverse = (covariance.0 * (sigma * sigma)).try_inverse().unwrap();
    let normals = head.facets.map(|n| pose.rotation() * n);
    let (mut spots, mut powers, step) = ([[0.0; 2]; 3], [0.0; 3], 6.0 * sigma / f64::from(RAYS));
    for i in -RAYS..RAYS {
        for j in -RAYS..RAYS {
            let from_centre = Vec2::new((f64::from(i) + 0.5) * step, (f64::from(j) + 0.5) * step);
            let weight = (-0.5 * from_centre.dot(&(inverse * from_centre))).exp();
            let at = from_centre + offset; // from the apex
            let height = |n: &Vec3| -(n.x * at.x + n.y * at.y) / n.z;
            // A convex pyramid: its surface is the lowest of the three planes.
            let facet = (0..3).min_by(|a, b| height(&normals[*a]).total_cmp(&height(&normals[*b]))).unwrap();
            let n = normals[facet];
            let on_mirror = pose.t + Vec3::new(at.x, at.y, height(&n));
            let light = -Vec3::z();
            let [u, v] = on_psd(&head.psds[facet], on_mirror, light - n * (2.0 * n.dot(&light)));
            spots[facet][0] += weight * u;
            spots[facet][1] += weight * v;
            powers[facet] += weight;
        }
    }
    let total: f64 = powers.iter().sum();
    ([0, 1, 2].map(|i| spots[i].map(|sum| sum / powers[i])), powers.map(|power| power / total))
}

fn on_psd(psd: &Psd, from: Vec3, along: Vec3) -> [f64; 2] {
    let way = (psd.origin - from).dot(&psd.x) / along.dot(&psd.x);
    let at = from + along * way - psd.origin;
    [at.dot(&psd.y), at.dot(&psd.z)]
}

#[test]
fn powers_and_centroids_are_those_of_a_sum_of_rays() {
    let head = Head::default();
    let optics = Optics::new(&head);
    let cases = [
        ([0.03, -0.02], [1e-4, -2e-4, 1.5e-4, 2e-3, -3e-3, 4e-3], [12e-6, -7e-6]),
        ([-0.4, 0.25], [-3e-4, 1e-4, 0.0, -1e-3, 1e-3, 5e-3], [-60e-6, 90e-6]),
    ];
    for (shape, pose, offset) in cases {
        let (pose, offset) = (Pose::from_array(pose), Vec2::from(offset));
        let (expected, fractions) = sum_of_rays(&head, shape, &pose, offset);
        let (spots, powers) = optics.trace_elliptical(&Ellipse::new(shape[0], shape[1]), &pose, offset);
        let (round, _) = optics.trace_each(Model::Gaussian, &pose, offset);
        let mut far = 0.0_f64;
        for i in 0..3 {
            assert!((powers[i] - fractions[i]).abs() < 2e-4, "{i}: {} {}", powers[i], fractions[i]);
            let (found, round) = (spots[i].unwrap(), round[i].unwrap());
            for k in 0..2 {
                assert!((found[k] - expected[i][k]).abs() < 1.2e-7, "{i} {k}: {found:?} {:?}", expected[i]);
                far = far.max((round[k] - expected[i][k]).abs());
            }
        }
        assert!(far > 1e-6, "the ellipse matters here: {far:e}");
    }
}

#[test]
fn a_round_ellipse_is_the_round_beam() {
    let optics = Optics::new(&Head::default());
    let pose = Pose::from_array([1e-4, -2e-4, 1.5e-4, 2e-3, -3e-3, 4e-3]);
    let (spots, powers) = optics.trace_elliptical(&Ellipse::new(0.0, 0.0), &pose, Vec2::new(1e-5, 2e-5));
    let (round, fractions) = optics.trace_each(Model::Gaussian, &pose, Vec2::new(1e-5, 2e-5));
    assert_eq!((spots, powers), (round, fractions));
    let beside = optics.trace_elliptical(&Ellipse::new(0.1, 0.0), &pose, Vec2::new(5e-3, 0.0));
    assert!(beside.0[1].is_err() && beside.0[0].is_ok(), "{beside:?}");
}
