//! Distant warm starts and meaningless signals: the solver returns the right pose or an error, never a
//! wrong pose.

use proptest::prelude::*;
use trifacet_optics::{
    Estimator, Head, HeadError, Model, Optics, Pose, Psd, Signals, SolveError, Vec2, Vec3,
};

use super::heads::{self, Draw, State, misfit};

/// Limit on the iterations of a solution: twenty from a warm start and twenty from a cold one.
const BOUND: u8 = 40;

fn jumped(draw: &mut Draw, from: &Pose) -> Pose {
    let jump = [1e-3, 1e-3, 1e-3, 5e-3, 5e-3, 5e-3].map(|limit| draw.within(limit));
    let from = from.to_array();
    Pose::from_array(std::array::from_fn(|i| from[i] + jump[i]))
}

#[test]
fn a_beam_that_jumps_across_the_apex_is_followed() {
    for (name, head) in heads::all() {
        let optics = Optics::new(&head);
        let estimator = Estimator::new(optics.clone(), Model::Gaussian);
        // In sigmas; for the nominal head 100, 200, 300 and 400 um.
        for (sigmas, limit) in [(0.87, 8), (1.74, 11), (2.61, 14), (3.48, 20)] {
            let mut draw = Draw::new(7);
            let (mut iterations, mut worst, mut cases) = (0, 0.0_f64, 0);
            while cases < 1000 {
                let from = draw.state(&optics, Model::Gaussian, 0.5, 0.0).pose;
                let d = draw.direction(sigmas * optics.sigma());
                let to = jumped(&mut draw, &from);
                let (before, after) =
                    (optics.trace(Model::Gaussian, &from, d), optics.trace(Model::Gaussian, &to, -d));
                let (Ok(before), Ok(after)) = (before, after) else { continue };
                let warm = estimator.solve(&heads::signals(&before), None).unwrap();
                let state = State { pose: to, offset: -d, signals: heads::signals(&after) };
                let solution = estimator.solve(&state.signals, Some(&warm)).unwrap();
                worst = worst.max(state.error(&solution));
                iterations = iterations.max(solution.iterations);
                cases += 1;
            }
            println!("{name}, {sigmas} sigma: {iterations} iterations, error {worst:.1e} at most");
            assert!(worst < 1e-10, "{name}, {sigmas} sigma: {worst:e}");
            assert!(iterations <= limit, "{name}, {sigmas} sigma: {iterations} iterations");
        }
    }
}

/// Any two states with light on all facets.
#[test]
fn a_distant_warm_start_gives_the_right_pose_or_an_error() {
    for (name, head) in heads::all() {
        let optics = Optics::new(&head);
        let estimator = Estimator::new(optics.clone(), Model::Gaussian);
        let mut draw = Draw::new(8);
        let mut any = || loop {
            let pose = draw.pose(1.0);
            let length = draw.within(7.0 * optics.sigma());
            let offset = draw.direction(length);
            if let Ok(reading) = optics.trace(Model::Gaussian, &pose, offset) {
                return State { pose, offset, signals: heads::signals(&reading) };
            }
        };
        let (mut solved, mut cases, mut worst) = (0, 0, 0.0_f64);
        while cases < 1000 {
            let (from, to) = (any(), any());
            let Ok(warm) = estimator.solve(&from.signals, None) else { continue };
            cases += 1;
            match estimator.solve(&to.signals, Some(&warm)) {
                Ok(solution) => {
                    worst = worst.max(to.error(&solution));
                    assert!(solution.iterations <= BOUND);
                    solved += 1;
                }
                Err(e) => assert!(to.offset.norm() > 4.0 * optics.sigma(), "{name}: {e} {to:?}"),
            }
        }
        println!("{name}: {solved} of {cases} solved, {worst:.1e} m or rad off at most");
        assert!(worst < 1e-9, "{name}: {worst:e}");
    }
}

/// The linearised equations are reused from sample to sample: random walks of all sizes, also along single
/// axes.
#[test]
fn a_chain_of_warm_starts_stays_exact() {
    for (name, head) in heads::all() {
        for model in [Model::Ray, Model::Gaussian] {
            let optics = Optics::new(&head);
            let estimator = Estimator::new(optics.clone(), model);
            let mut draw = Draw::new(7);
            let mut worst = [0.0_f64; 2];
            for _ in 0..40 {
                let mut at = draw.state(&optics, model, 0.5, 0.0);
                let size = 10_f64.powf(draw.within(4.0) - 7.0);
                let sizes: [f64; 8] = std::array::from_fn(|_| size * 10_f64.powf(draw.within(2.0) - 2.0));
                let mut warm = None;
                for _ in 0..200 {
                    let pose = at.pose.to_array();
                    at.pose = Pose::from_array(std::array::from_fn(|i| pose[i] + draw.within(sizes[i])));
                    let moved = at.offset + Vec2::new(draw.within(sizes[6]), draw.within(sizes[7]));
                    if model == Model::Gaussian && moved.norm() < 2.6 * optics.sigma() {
                        at.offset = moved;
                    }
                    let Ok(reading) = optics.trace(model, &at.pose, at.offset) else { break };
                    at.signals = heads::signals(&reading);
                    let solution = estimator.solve(&at.signals, warm.as_ref()).unwrap();
                    let (spots, powers) = misfit(&estimator, &solution, &at.signals).unwrap();
                    worst[0] = worst[0].max(at.error(&solution));
                    worst[1] = worst[1].max(spots).max(powers * optics.sigma());
                    warm = Some(solution);
                }
            }
            println!("{name}, {model:?}: error {:.1e}, residual of the signals {:.1e} m", worst[0], worst[1]);
            assert!(worst.iter().all(|w| *w < 1e-10), "{name}, {model:?}: {worst:?}");
        }
    }
}

#[test]
fn every_error_states_its_reason() {
    let optics = Optics::new(&heads::nominal());
    let estimator = Estimator::new(optics.clone(), Model::Gaussian);
    let rest = heads::signals(&optics.trace(Model::Gaussian, &Pose::default(), Vec2::zeros()).unwrap());
    let refusal = |change: &dyn Fn(&mut Signals)| {
        let mut signals = rest;
        change(&mut signals);
        estimator.solve(&signals, None).unwrap_err()
    };
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        assert!(matches!(refusal(&|s| s.spots[3] = bad), SolveError::NotFinite { signal: "spot", psd: 'B' }));
        assert_eq!(refusal(&|s| s.powers[2] = bad), SolveError::NotFinite { signal: "power", psd: 'C' });
    }
    let huge = SolveError::NotFinite { signal: "power", psd: 'A' };
    assert_eq!(refusal(&|s| s.powers = [f64::MAX; 3]), huge, "their sum is infinite");
    assert!(matches!(refusal(&|s| s.spots[4] = -6.6e-3), SolveError::OffPsd { psd: 'C', .. }));
    for power in [0.0, -1e-3] {
        assert_eq!(refusal(&|s| s.powers[1] = power), SolveError::Dark { psd: 'B', power });
    }
    assert_eq!(refusal(&|s| s.powers[0] = 1e-10), SolveError::Dark { psd: 'A', power: 1e-10 });
    // Five sigma from the apex, Newton's steps are too short to converge within the limit.
    let far = refusal(&|s| s.powers = [1.0, 1.0, 1e-8]);
    assert_eq!(far, SolveError::NotConverged { iterations: 20 });
    // A spot that requires a facet turned away from the light.
    let wide = Head::nominal(0.25, 0.5, std::f64::consts::FRAC_PI_4, 0.46e-3).unwrap();
    let signals = Signals { spots: [0.24, 0.24, 0.24, -0.24, -0.24, 0.24], powers: [1.0; 3] };
    let away = Estimator::new(Optics::new(&wide), Model::Ray).solve(&signals, None);
    assert!(matches!(away, Err(SolveError::OutOfRange { .. })), "{away:?}");
}

#[test]
fn three_adjacent_detectors_are_singular() {
    // Almost parallel facets reflect all light in one direction: a rotation about that direction is
    // unobservable.
    let mut head = heads::nominal();
    for (facet, psd) in head.facets.iter_mut().zip(&mut head.psds) {
        *facet = Vec3::new(facet.x * 1e-9, facet.y * 1e-9, 1.0);
        *psd = Psd::facing(Vec3::z() * 0.25, -Vec3::z(), Vec3::x(), 0.013);
    }
    for model in [Model::Ray, Model::Gaussian] {
        let optics = Optics::new(&head.clone().checked().unwrap());
        let reading = optics.trace(model, &Pose::default(), Vec2::zeros()).unwrap();
        let solved = Estimator::new(optics, model).solve(&heads::signals(&reading), None);
        assert!(matches!(solved, Err(SolveError::Singular { .. })), "{model:?}: {solved:?}");
    }
}

#[test]
fn a_detector_without_a_plane_is_refused() {
    for (normal, up) in
        [(Vec3::x(), Vec3::x()), (Vec3::zeros(), Vec3::z()), (Vec3::x() * f64::NAN, Vec3::z())]
    {
        let mut head: Head = heads::nominal();
        head.psds[1] = Psd::facing(head.psds[1].origin, normal, up, 0.013);
        assert_eq!(head.checked().unwrap_err(), HeadError::PsdAxes { psd: 'B' });
    }
}

/// Inputs of the solver: plausible numbers and arbitrary ones.
fn spot() -> impl Strategy<Value = f64> {
    prop_oneof![12 => -6.5e-3..6.5e-3, 1 => any::<f64>(), 1 => Just(0.0)]
}

fn power() -> impl Strategy<Value = f64> {
    prop_oneof![6 => 0.0..1e-3, 6 => (-13.0..0.0).prop_map(|p| 10_f64.powf(p)), 1 => any::<f64>()]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(20_000))]

    /// A returned solution reproduces the signals, from a cold start and from the solution of other signals.
    #[test]
    fn garbage_gives_a_pose_that_explains_it_or_a_reason(
        first in (prop::array::uniform6(spot()), prop::array::uniform3(power())),
        second in (prop::array::uniform6(spot()), prop::array::uniform3(power())),
        ray: bool,
    ) {
        let model = if ray { Model::Ray } else { Model::Gaussian };
        let estimator = Estimator::new(Optics::new(&heads::nominal()), model);
        let mut warm = None;
        for (spots, powers) in [first, second] {
            let signals = Signals { spots, powers };
            match estimator.solve(&signals, warm.as_ref()) {
                Ok(solution) => {
                    prop_assert!(solution.iterations <= BOUND);
                    let (spots, powers) = misfit(&estimator, &solution, &signals).unwrap();
                    prop_assert!(spots < 1e-9, "{solution:?} misses a spot by {spots:e} m");
                    prop_assert!(powers < 1e-6, "{solution:?} misses a power by {powers:e}");
                    warm = Some(solution);
                }
                Err(e) => prop_assert!(e.iterations() <= BOUND),
            }
        }
    }
}
