//! Signals of known states, solved from a cold start.

use trifacet_optics::{Estimator, Model, Optics};

use super::heads::{self, Draw};

/// Largest error and largest number of iterations over random states.
fn cold(estimator: &Estimator, cases: u32, scale: f64, offset: f64) -> (f64, u8) {
    let mut draw = Draw::new(1);
    let (mut worst, mut iterations) = (0.0_f64, 0);
    for _ in 0..cases {
        let state = draw.state(estimator.optics(), estimator.model(), scale, offset);
        let solution = estimator.solve(&state.signals, None).unwrap_or_else(|e| panic!("{e} {state:?}"));
        worst = worst.max(state.error(&solution));
        iterations = iterations.max(solution.iterations);
    }
    (worst, iterations)
}

#[test]
fn a_hundred_thousand_poses_are_found_from_a_cold_start() {
    for (model, offset, limit) in [(Model::Ray, 0.0, 6), (Model::Gaussian, 100e-6, 8)] {
        let estimator = Estimator::new(Optics::new(&heads::nominal()), model);
        let (worst, iterations) = cold(&estimator, 100_000, 1.0, offset);
        println!("{model:?}: {iterations} iterations, error {worst:.1e} m or rad at most");
        assert!(iterations <= limit, "{model:?}: {iterations} iterations");
        assert!(worst < 1e-10, "{model:?}: {worst:e}");
    }
}

#[test]
fn poses_of_other_heads_are_found_from_a_cold_start() {
    for (name, head) in heads::all() {
        for (model, part_of_sigma) in [(Model::Ray, 0.0), (Model::Gaussian, 0.9)] {
            let optics = Optics::new(&head);
            let offset = part_of_sigma * optics.sigma();
            let (worst, iterations) = cold(&Estimator::new(optics, model), 2000, 0.8, offset);
            println!("{name}, {model:?}: {iterations} iterations, error {worst:.1e} m or rad at most");
            assert!(iterations <= 10, "{name}, {model:?}: {iterations} iterations");
            assert!(worst < 1e-10, "{name}, {model:?}: {worst:e}");
        }
    }
}
