//! Success rate and duration of the search for the apex: 200 starts within 3 mm of it, and 50 beside the
//! mirror.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use trifacet::closed_loop_sim::ClosedLoopSim;
use trifacet::config::{Axis, Config, MotionKind};
use trifacet_wire::LockState;

use super::{motion, wide_bench};

/// Travel of the stage to each side, micrometres; the mirror has a radius of 5 mm.
const REACH_UM: f64 = 8000.0;
/// The axes in the order of a pose.
const AXES: [Axis; 6] = [Axis::Tx, Axis::Ty, Axis::Tz, Axis::Roll, Axis::Pitch, Axis::Yaw];

/// Seconds until the loop reports "locked", which must then be true; `None` if that takes more than `most_s`.
fn seconds_to_lock(config: &Config, most_s: f64) -> Option<f64> {
    let mut sim = ClosedLoopSim::new(config).unwrap();
    loop {
        let turn = sim.step();
        let command = turn.command.map_or([0.0; 2], |command| command.position.0);
        assert!(command.iter().all(|p| p.abs() <= config.steering.limit_um * 1e-6));
        if turn.state.lock == LockState::Locked {
            let off = turn.scan.truth.offset.norm();
            assert!(
                off < config.centering.lock_limit_um * 1e-6,
                "reported as locked with an offset of {off} m"
            );
            return Some(turn.scan.t_s);
        }
        if turn.scan.t_s > most_s {
            return None;
        }
    }
}

/// Smallest, median, 90 % and largest.
fn quantiles(mut times: Vec<f64>) -> [f64; 4] {
    times.sort_by(f64::total_cmp);
    let last = times.len() - 1;
    [0, last / 2, last * 9 / 10, last].map(|k| times[k])
}

fn report(label: &str, times: Vec<f64>) {
    let n = times.len();
    let [least, median, most, all] = quantiles(times).map(|s| s * 1e3);
    println!(
        "{label:<40} {n:>4} starts, ms to lock: least {least:.0}, median {median:.0}, 90 % {most:.0}, all {all:.0}"
    );
}

/// A beam at a random place between two distances from the apex, over a mirror at a random position and
/// rotated by up to 2 mrad. The loop does not know either.
fn start(random: &mut Pcg64, from: f64, to: f64) -> Config {
    let mut config = wide_bench(REACH_UM);
    let mut symmetric = |most: f64| most * (2.0 * random.random::<f64>() - 1.0);
    let pose = [
        symmetric(1e-3),
        symmetric(1e-3),
        symmetric(0.2e-3),
        symmetric(2e-3),
        symmetric(2e-3),
        symmetric(5e-3),
    ];
    let distance = (from * from + (to * to - from * from) * random.random::<f64>()).sqrt();
    let angle = std::f64::consts::TAU * random.random::<f64>();
    config.twin.laser_offset_um =
        [pose[0] + distance * angle.cos(), pose[1] + distance * angle.sin()].map(|m| m * 1e6);
    config.twin.motion =
        AXES.into_iter().zip(pose).map(|(axis, at)| motion(axis, MotionKind::Step, at * 1e6)).collect();
    config.twin.seed = random.random_range(0..1000);
    config
}

#[test]
fn the_loop_finds_the_apex_from_anywhere_within_3_mm() {
    let mut random = Pcg64::seed_from_u64(4);
    let times: Vec<f64> = (0..200)
        .map(|k| {
            let config = start(&mut random, 0.0, 3e-3);
            seconds_to_lock(&config, 10.0).unwrap_or_else(|| panic!("start {k}: {:?}", config.twin))
        })
        .collect();
    report("within 3 mm of the apex", times);
}

#[test]
fn the_loop_finds_the_apex_from_beside_the_mirror() {
    let mut random = Pcg64::seed_from_u64(5);
    let times: Vec<f64> = (0..50)
        .map(|k| {
            let config = start(&mut random, 5.05e-3, 6.5e-3);
            seconds_to_lock(&config, 30.0).unwrap_or_else(|| panic!("start {k}: {:?}", config.twin))
        })
        .collect();
    report("beside the mirror, without any light", times);
}
