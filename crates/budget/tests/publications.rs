//! Published examples: JCGM 100:2008 (GUM), annex H.1, and JCGM 101:2008, clauses 9.2 and 9.5.

#![allow(clippy::unwrap_used)]

use nalgebra::DMatrix;
use trifacet_budget::validation::tolerance;
use trifacet_budget::{
    Budget, Distribution, Evaluation, Input, MonteCarlo, Sampler, Stop, Validation, Verdict,
};

/// Nominal length of the end gauge, nanometres.
const NOMINAL: f64 = 50e6;

/// JCGM 100, H.1: `l = l_s + d - l_s (dalpha theta + alpha_s dtheta)`, lengths in nanometres, with the values of
/// table H.1 and the degrees of freedom of H.1.6.
fn end_gauge() -> Budget {
    let rectangular = Distribution::Rectangular;
    let inputs = vec![
        Input::normal("l_s", NOMINAL + 623.0, 25.0).evaluated(Evaluation::B, 18.0),
        Input::normal("d", 215.0, 9.7).evaluated(Evaluation::A, 25.6),
        Input::new("alpha_s", 11.5e-6, 1.2e-6, rectangular),
        Input::new("theta", -0.1, 0.41, Distribution::Arcsine),
        Input::new("dalpha", 0.0, 0.58e-6, rectangular).evaluated(Evaluation::B, 50.0),
        Input::new("dtheta", 0.0, 0.029, rectangular).evaluated(Evaluation::B, 2.0),
    ];
    // c = 1, 1, -l_s dtheta, -l_s dalpha, -l_s theta, -l_s alpha_s (H.1.4).
    let length = inputs[0].value;
    let row = [1.0, 1.0, 0.0, 0.0, length * 0.1, -length * 11.5e-6];
    Budget::new(inputs, DMatrix::from_row_slice(1, 6, &row), None).unwrap()
}

#[test]
fn the_end_gauge_of_the_gum_is_reproduced() {
    let budget = end_gauge();
    // Table H.1: the components |c_i| u(x_i), nanometres, as printed.
    for (i, printed) in [(0, 25.0), (1, 9.7), (2, 0.0), (3, 0.0), (4, 2.9), (5, 16.6)] {
        let component = budget.contribution(0, i).abs();
        let name = &budget.inputs()[i].name;
        // The printed 16.6 is from the unrounded 0.05/sqrt(3) K; 0.029 K gives 16.7.
        assert!((component - printed).abs() < 0.1, "{name}: {component}");
    }
    // H.1.4 and table H.1: u_c^2 = 1002 nm^2, u_c = 32 nm.
    let u = budget.standard_uncertainty(0);
    assert_eq!(u.round(), 32.0);
    assert!((u * u - 1002.0).abs() < 5.0, "{}", u * u);
    // H.1.6: nu_eff = 16.7, truncated to 16; t_99(16) = 2.92; U_99 = 93 nm.
    let dof = budget.effective_dof(0).unwrap();
    assert!((dof - 16.7).abs() < 0.4 && dof.floor() == 16.0, "{dof}");
    let k = budget.coverage_factor(0, 0.99);
    assert_eq!((k * 100.0).round(), 292.0);
    assert_eq!(budget.expanded(0, 0.99).round(), 93.0);
    let shares: f64 = (0..6).map(|i| budget.share(0, i)).sum();
    assert!((shares - 1.0).abs() < 1e-12);
    // H.1.3.2: the 9.7 nm are the root of 5.8^2 + 3.9^2 + 6.7^2, with 24, 5 and 8 degrees of freedom (H.1.6: 25.6).
    let parts = [(5.8, 24.0), (3.9, 5.0), (6.7, 8.0)];
    let inputs: Vec<_> =
        parts.map(|(u, dof)| Input::normal("d", 0.0, u).evaluated(Evaluation::A, dof)).into();
    let d = Budget::new(inputs, DMatrix::from_element(1, 3, 1.0), None).unwrap();
    assert!((d.standard_uncertainty(0) - 9.7).abs() < 0.05);
    assert!((d.effective_dof(0).unwrap() - 25.6).abs() < 0.3, "{:?}", d.effective_dof(0));
}

/// JCGM 101, 9.5: `dL = L_s + D + d_1 + d_2 - L_s (dalpha (theta_0 + Delta) + alpha_s dtheta) - L_nom` (9.5.2), with
/// the distributions of table 10. Nanometres.
fn gauge_block() -> Vec<Input> {
    let t = |name: &str, value, std, dof| {
        Input::new(name, value, std, Distribution::StudentT).evaluated(Evaluation::A, dof)
    };
    let limited =
        |name: &str, value, half, distribution| Input::limited(name, value, half, distribution).unwrap();
    let trapezoid = |inexactness| Distribution::CurvilinearTrapezoid { inexactness };
    vec![
        t("L_s", NOMINAL + 623.0, 25.0, 18.0),
        t("D", 215.0, 6.0, 24.0),
        t("d_1", 0.0, 4.0, 5.0),
        t("d_2", 0.0, 7.0, 8.0),
        limited("alpha_s", 11.5e-6, 2e-6, Distribution::Rectangular),
        Input::normal("theta_0", -0.1, 0.2),
        limited("Delta", 0.0, 0.5, Distribution::Arcsine),
        limited("dalpha", 0.0, 1e-6, trapezoid(0.1)),
        limited("dtheta", 0.0, 0.05, trapezoid(0.5)),
    ]
}

#[test]
fn the_gauge_block_of_jcgm_101_is_reproduced() {
    let inputs = gauge_block();
    let mut sampler = Sampler::new(&inputs, None, 101).unwrap();
    let monte_carlo = MonteCarlo::run(&mut sampler, 1, 0.99, Stop::After(1_000_000), |x, y| {
        y[0] = x[0] + x[1] + x[2] + x[3] - x[0] * (x[7] * (x[5] + x[6]) + x[4] * x[8]) - NOMINAL;
        true
    });
    // Table 11, nanometres: estimate 838, standard uncertainty 36, shortest 99 % interval [745, 932].
    assert_eq!(monte_carlo.estimate(0).round(), 838.0);
    assert_eq!(monte_carlo.standard_uncertainty(0).round(), 36.0);
    let shortest = monte_carlo.shortest(0);
    // 1.26 million trials there: the ends scatter by a nanometre.
    assert!((shortest.low - 745.0).abs() < 1.5 && (shortest.high - 932.0).abs() < 1.5, "{shortest:?}");

    // The law of propagation, table 11: 838, 32, [745, 931] from a t-distribution with 16 degrees of freedom.
    let length = inputs[0].value;
    let mut linear: Vec<_> = inputs;
    // H.1.6: dalpha is known to 10 %, dtheta to 50 %.
    (linear[7].dof, linear[8].dof) = (50.0, 2.0);
    let row = [1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, length * 0.1, -length * 11.5e-6];
    let budget = Budget::new(linear, DMatrix::from_row_slice(1, 9, &row), None).unwrap();
    assert_eq!(budget.standard_uncertainty(0).round(), 32.0);
    assert_eq!(budget.effective_dof(0).unwrap().floor(), 16.0);
    // The publication rounds the uncertainty before it expands it: 2.92 * 32 nm.
    let expanded = budget.coverage_factor(0, 0.99) * budget.standard_uncertainty(0).round();
    assert_eq!([(838.0 - expanded).round(), (838.0 + expanded).round()], [745.0, 931.0]);
}

/// JCGM 101, 9.2: the sum of four quantities with standard uncertainty 1.
fn sum_of_four(distribution: Distribution, stop: Stop) -> (Budget, MonteCarlo) {
    let inputs: Vec<_> = (1..=4).map(|i| Input::new(format!("X{i}"), 0.0, 1.0, distribution)).collect();
    let mut sampler = Sampler::new(&inputs, None, 92).unwrap();
    let monte_carlo = MonteCarlo::run(&mut sampler, 1, 0.95, stop, |x, y| {
        y[0] = x.iter().sum();
        true
    });
    (Budget::new(inputs, DMatrix::from_element(1, 4, 1.0), None).unwrap(), monte_carlo)
}

fn validation(budget: &Budget, monte_carlo: &MonteCarlo, digits: i32) -> Validation {
    let (u, expanded) = (budget.standard_uncertainty(0), budget.expanded(0, 0.95));
    let scatter = monte_carlo.scatter(0);
    Validation::new(0.0, expanded, monte_carlo.symmetric(0), scatter, tolerance(u, digits))
}

#[test]
fn the_additive_model_of_jcgm_101_is_reproduced() {
    // Table 2: normal distributions; u = 2.00, 95 % interval [-3.92, 3.92].
    let (budget, trials) = sum_of_four(Distribution::Normal, Stop::After(1_000_000));
    assert!((budget.expanded(0, 0.95) - 3.92).abs() < 0.001);
    let interval = trials.symmetric(0);
    assert!((interval.high - 3.92).abs() < 0.02 && (interval.low + 3.92).abs() < 0.02, "{interval:?}");
    assert!((trials.standard_uncertainty(0) - 2.0).abs() < 0.005);
    assert_eq!(validation(&budget, &trials, 2).verdict, Verdict::Validated);

    // Table 3 and 9.2.3.4: rectangular distributions; exactly +-2 sqrt(3) (2 - (3/5)^(1/4)) = +-3.88.
    let (budget, trials) = sum_of_four(Distribution::Rectangular, Stop::After(4_000_000));
    let exact = 2.0 * 3.0_f64.sqrt() * (2.0 - 0.6_f64.powf(0.25));
    for interval in [trials.symmetric(0), trials.shortest(0)] {
        assert!((interval.high - exact).abs() < 0.03 && (interval.low + exact).abs() < 0.03, "{interval:?}");
    }
    let symmetric = trials.symmetric(0);
    assert!((symmetric.high - exact).abs() < 2.0 * trials.scatter(0));
    // +-3.92 differs by 0.04: within the 0.05 of two digits, beyond the 0.005 of three.
    assert_eq!(validation(&budget, &trials, 2).verdict, Verdict::Validated);
    assert_eq!(validation(&budget, &trials, 3).verdict, Verdict::NotValidated);
    // Ten thousand trials are too few to say so at two digits.
    let (budget, trials) = sum_of_four(Distribution::Rectangular, Stop::After(10_000));
    assert_eq!(validation(&budget, &trials, 2).verdict, Verdict::Undecided);
}

#[test]
fn adaptive_trials_end_when_the_results_have_settled() {
    let stop = |most| Stop::Settled { digits: 1, most };
    let (_, trials) = sum_of_four(Distribution::Normal, stop(1_000_000));
    assert!(trials.settled() && (20_000..500_000).contains(&trials.trials()), "{}", trials.trials());
    let (_, trials) = sum_of_four(Distribution::Normal, Stop::Settled { digits: 4, most: 50_000 });
    assert!(!trials.settled() && trials.trials() == 50_000);
}

#[test]
fn the_same_seed_gives_the_same_bits_and_failed_trials_are_counted() {
    let run = |seed| {
        let mut sampler = Sampler::new(&gauge_block(), None, seed).unwrap();
        MonteCarlo::run(&mut sampler, 1, 0.95, Stop::After(20_000), |x, y| {
            y[0] = x[1];
            x[2] < 4.0
        })
    };
    let (a, b, c) = (run(1), run(1), run(2));
    assert_eq!((a.estimate(0), a.symmetric(0)), (b.estimate(0), b.symmetric(0)));
    assert_ne!(a.estimate(0), c.estimate(0));
    // Beyond one scale of t with 5 degrees of freedom on one side: 18 %.
    assert_eq!(a.trials() + a.failed(), 20_000);
    assert!((a.failed() as f64 / 20_000.0 - 0.1816).abs() < 0.02, "{}", a.failed());
}
