//! What a head of its own does to an estimator that believes the nominal head: the errors that another program has
//! found for heads with the default tolerances.

use trifacet::config::{Config, TwinTolerances};
use trifacet::core::channels::Channels;
use trifacet::core::time::Mono;
use trifacet::optics::{Estimator, Model, Optics, Pose, Rigid, Signals};
use trifacet::twin::Twin;

/// Poses per head.
const POSES: u32 = 40;

/// A twin without noise, whose beam is on the apex at this pose; micrometres and microradians.
fn quiet(seed: u64, pose: [f64; 6]) -> (Config, Pose) {
    let mut config = Config::default();
    let twin = &mut config.twin;
    (twin.spot_noise_um, twin.power_noise, twin.converter_bits) = (0.0, 0.0, 24);
    (twin.laser_offset_um, twin.tolerances) =
        ([pose[0], pose[1]], Some(TwinTolerances { seed, ..TwinTolerances::default() }));
    (config, Pose::from_array(pose.map(|x| x * 1e-6)))
}

/// The pose that the nominal head makes of the readings.
fn estimated(channels: &Channels, estimator: &Estimator, seed: u64, pose: [f64; 6]) -> Rigid {
    let (config, pose) = quiet(seed, pose);
    let mut twin = Twin::new(&config).unwrap();
    twin.place(pose);
    let scan = twin.next_scan().arrived(Mono(0), 0).unwrap();
    let sample = channels.map(twin.identity()).unwrap().sample(&scan);
    let solution = estimator.solve(&Signals { spots: sample.spots, powers: sample.powers }, None).unwrap();
    (&solution.pose).into()
}

/// Points that fill the range evenly: the R-sequence of M. Roberts in six dimensions.
fn pose(k: u32) -> [f64; 6] {
    let g: f64 = 1.134_724_138_4; // the root of x^7 = x + 1
    std::array::from_fn(|axis| {
        let range = if axis < 3 { 1000.0 } else { 5000.0 };
        range * (2.0 * (0.5 + f64::from(k) * g.powi(-(axis as i32) - 1)).fract() - 1.0)
    })
}

/// Errors of the poses of one head, relative to that at rest: rms in micrometres and microradians.
fn errors(seed: u64) -> [f64; 2] {
    let config = Config::default();
    let channels = config.read_channels().unwrap();
    let estimator = Estimator::new(Optics::new(&config.head.build().unwrap()), Model::Gaussian);
    let tare = estimated(&channels, &estimator, seed, [0.0; 6]).inverse();
    let mut squares = [0.0; 2];
    for k in 1..=POSES {
        let relative = Pose::from(&(tare * estimated(&channels, &estimator, seed, pose(k)))).to_array();
        for (axis, (found, truth)) in relative.iter().zip(pose(k)).enumerate() {
            squares[axis / 3] += (found * 1e6 - truth).powi(2) / f64::from(3 * POSES);
        }
    }
    squares.map(f64::sqrt)
}

#[test]
fn uncalibrated_heads_are_as_wrong_as_their_tolerances_make_them() {
    let mut um = Vec::new();
    let mut urad = Vec::new();
    for seed in 0..20 {
        let [translation, rotation] = errors(seed);
        um.push(translation);
        urad.push(rotation);
    }
    um.sort_by(f64::total_cmp);
    urad.sort_by(f64::total_cmp);
    // Another program, 20 heads: median 11 um and 23 urad, worst 15 um and 35 urad.
    assert!((7.0..14.0).contains(&um[10]) && (18.0..29.0).contains(&urad[10]), "{um:?} {urad:?}");
    assert!(um[0] > 4.0 && um[19] < 22.0 && urad[19] < 50.0, "{um:?} {urad:?}");
}
