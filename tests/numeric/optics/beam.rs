//! The split of a Gaussian beam compared with numerical integration in polar coordinates.

use std::f64::consts::{FRAC_PI_4, TAU};

use trifacet_optics::beam::Split;
use trifacet_optics::{Head, Model, Optics, Pose, TraceError, Vec2, Vec3};

use super::heads::{self, Draw};

/// Nodes and weights of the Gauss-Legendre rule on -1 to 1.
fn legendre<const N: usize>() -> [(f64, f64); N] {
    std::array::from_fn(|i| {
        let mut x = (TAU / 2.0 * (i as f64 + 0.75) / (N as f64 + 0.5)).cos();
        let mut slope = 1.0;
        for _ in 0..20 {
            let (mut p, mut before) = (x, 1.0);
            for k in 2..=N {
                let k = k as f64;
                (p, before) = (((2.0 * k - 1.0) * x * p - (k - 1.0) * before) / k, p);
            }
            slope = N as f64 * (x * p - before) / (x * x - 1.0);
            x -= p / slope;
        }
        (x, 2.0 / ((1.0 - x * x) * slope * slope))
    })
}

/// Integral of `f`, composed of `panels` equal parts.
fn integral(from: f64, to: f64, panels: usize, rule: &[(f64, f64)], mut f: impl FnMut(f64) -> Vec3) -> Vec3 {
    let half = (to - from) / (2.0 * panels as f64);
    let mut sum = Vec3::zeros();
    for panel in 0..panels {
        let middle = from + half * (2.0 * panel as f64 + 1.0);
        for (x, weight) in rule {
            sum += f(middle + half * x) * (weight * half);
        }
    }
    sum
}

/// Power and first moment about the beam's centre of the part of a beam at `d` between two directions.
fn quadrature(lo: Vec2, hi: Vec2, d: Vec2) -> (f64, Vec2) {
    let rule = legendre::<8>();
    let first = lo.y.atan2(lo.x);
    let last = first + (hi.y.atan2(hi.x) - first).rem_euclid(TAU);
    let sum = integral(first, last, 64, &rule, |angle| {
        let e = Vec2::new(angle.cos(), angle.sin());
        let peak = e.dot(&d);
        integral((peak - 9.0).max(0.0), (peak + 9.0).max(9.0), 40, &rule, |r| {
            let p = e * r - d;
            Vec3::new(1.0, p.x, p.y) * (r * (-0.5 * p.norm_squared()).exp() / TAU)
        })
    });
    (sum.x, Vec2::new(sum.y, sum.z))
}

/// The directions between which facet `i` is seen along the beam: where it is as low as a neighbour and
/// the third facet is higher.
fn borders(normals: &[Vec3; 3], i: usize) -> (Vec2, Vec2) {
    let k = normals.map(|n| -n.xy() / n.z);
    let border = |j: usize| {
        let across = k[i] - k[j];
        let e = Vec2::new(-across.y, across.x).normalize();
        if (k[3 - i - j] - k[i]).dot(&e) > 0.0 { e } else { -e }
    };
    (border((i + 2) % 3), border((i + 1) % 3))
}

fn normals(pose: &Pose, angle: f64) -> [Vec3; 3] {
    let head = Head::nominal(0.25, 0.013, angle, 0.46e-3).unwrap();
    head.facets.map(|n| pose.rotation() * n)
}

fn mirrors() -> Vec<[Vec3; 3]> {
    let tilted = |roll, pitch, yaw| Pose { roll, pitch, yaw, ..Pose::default() };
    vec![
        normals(&Pose::default(), FRAC_PI_4),
        normals(&tilted(0.01, -0.01, 0.5), FRAC_PI_4),
        normals(&tilted(0.3, 0.4, -2.0), FRAC_PI_4),
        normals(&tilted(-0.2, 0.5, 1.0), 0.6),
        normals(&tilted(0.05, 0.6, 0.1), FRAC_PI_4),
    ]
}

const SIGMA: f64 = 115e-6;

#[test]
fn powers_and_moments_agree_with_quadrature() {
    let (mut power_off, mut moment_off) = (0.0_f64, 0.0_f64);
    for (k, normals) in mirrors().iter().enumerate() {
        for (step, d_um) in [0.0, 1.0, 20.0, 100.0, 200.0, 300.0, 304.0, 305.0, 400.0, 600.0, 1000.0, 3000.0]
            .iter()
            .enumerate()
        {
            let angle = (3 * k + 5 * step) as f64;
            let d = Vec2::new(angle.cos(), angle.sin()) * (d_um * 1e-6 / SIGMA);
            let split = Split::new(normals, d);
            for i in 0..3 {
                let (lo, hi) = borders(normals, i);
                let (power, moment) = quadrature(lo, hi, d);
                let wedge = split.wedge(i);
                power_off = power_off.max((wedge.power - power).abs());
                moment_off = moment_off.max((wedge.moment - moment).amax());
            }
            let sum: f64 = (0..3).map(|i| split.wedge(i).power).sum();
            assert!((sum - 1.0).abs() < 4e-16, "mirror {k}, {d_um} um: the powers add up to {sum}");
        }
    }
    println!("powers off by {power_off:.1e}, moments by {moment_off:.1e} sigma at most");
    assert!(power_off < 1e-14 && moment_off < 1e-14, "{power_off:e} {moment_off:e}");
}

/// The centroid of a dim facet is accurate to the rounding error of its power.
#[test]
fn centroids_of_lit_facets_agree_with_quadrature() {
    let normals = &mirrors()[1];
    let mut faintest = 1.0_f64;
    for k in 0..40 {
        let d = Vec2::new(-1.0, 0.02) * (0.15 * f64::from(k)); // away from facet A
        let (lo, hi) = borders(normals, 0);
        let (power, moment) = quadrature(lo, hi, d);
        let wedge = Split::new(normals, d).wedge(0);
        let off = (wedge.moment / wedge.power - moment / power).norm();
        assert!(off < 1e-14 + 1e-15 / power, "{k}: {off:e} sigma at a power of {power:e}");
        faintest = faintest.min(power);
    }
    assert!(faintest < 1e-8, "{faintest:e}");
}

#[test]
fn there_is_no_step_between_the_series_and_owens_t() {
    let mut draw = Draw::new(5);
    let mut worst = 0.0_f64;
    for normals in &mirrors() {
        for _ in 0..2000 {
            let d = draw.direction(7.0_f64.sqrt());
            let [inside, outside] = [1.0 - 1e-15, 1.0 + 1e-15].map(|r| Split::new(normals, d * r));
            for i in 0..3 {
                worst = worst.max((inside.wedge(i).power - outside.wedge(i).power).abs());
            }
        }
    }
    println!("step at the switch: {worst:.1e}");
    assert!(worst < 4e-15, "{worst:e}");
}

#[test]
fn a_dark_facet_has_no_spot_and_the_others_keep_theirs() {
    let optics = Optics::new(&heads::nominal());
    let mut lit = Vec::new();
    for r in [0.3e-3, 0.7e-3, 1e-3, 2e-3, 3e-3] {
        let offset = Vec2::new(-0.5, 0.75_f64.sqrt()) * r; // onto facet B
        let (spots, powers) = optics.trace_each(Model::Gaussian, &Pose::default(), offset);
        assert!((powers.iter().sum::<f64>() - 1.0).abs() < 1e-15);
        assert!(powers.iter().all(|p| (0.0..=1.0).contains(p)));
        assert!(spots[1].is_ok());
        for i in [0, 2] {
            let dark = spots[i] == Err(TraceError::Dark(['A', 'B', 'C'][i]));
            assert_eq!(dark, powers[i] <= 1e-12, "{r} {:?} {}", spots[i], powers[i]);
        }
        lit.push(spots.iter().filter(|spot| spot.is_ok()).count());
    }
    assert_eq!(lit, [3, 3, 1, 1, 1]);
    // All light on B: the centroid is the beam's centre.
    let (spots, _) = optics.trace_each(Model::Gaussian, &Pose::default(), Vec2::new(0.0, 3e-3));
    assert!((spots[1].unwrap()[0] - 1.5e-3).abs() < 1e-9, "{spots:?}");
}
