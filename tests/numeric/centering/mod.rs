//! The whole loop in lockstep with the twin: tracking, search for the apex, and no false reports under
//! faults.
//!
//! `cargo test --test numeric centering -- --nocapture` prints the tables.

mod faults;
mod finding;
mod following;

use trifacet::config::{Axis, Config, Motion, MotionKind, parse};

/// 10 kHz; a command computed from sample k acts on sample k+4: the dead time of the stage is a little less
/// than
/// four samples to achieve this. Spot noise 1.08 um, power noise 5e-4 of each power, readback noise 0.1 um.
const BENCH: &str = "\
    acquisition.rate_hz = 10000\n\
    estimation.power_noise = 5e-4\n\
    [centering]\nloop_delay_ms = 0.4\nlag_ms = 0\n\
    [steering]\nslew_mm_per_s = 500\n\
    [twin]\npower_noise = 5e-4\nmotion = []\n\
    [twin.steering]\ndelay_ms = 0.39\nlag_ms = 0\n";

/// The bench, with a mirror at rest.
fn bench() -> Config {
    parse(BENCH, None).unwrap()
}

/// The bench with a stage of this travel to each side. All light on one PSD does not clip it: with clipping,
/// its spot would be unknown, and only the search would find the apex.
fn wide_bench(limit_um: f64) -> Config {
    let mut config = bench();
    config.channels.power_mw_per_v = 0.1;
    config.channels.readback_um_per_v = limit_um / 8.0;
    config.steering.limit_um = limit_um;
    config.steering.full_scale_um = 1.2 * limit_um;
    config.twin.steering.limit_um = 1.1 * limit_um;
    config
}

/// A movement of the mirror along an axis, micrometres or microradians. Callers may change the other fields.
fn motion(axis: Axis, kind: MotionKind, amount: f64) -> Motion {
    Motion {
        axis,
        amount_um: Some(amount).filter(|_| !axis.is_turn()),
        amount_urad: Some(amount).filter(|_| axis.is_turn()),
        kind,
        from_s: 0.0,
        until_s: None,
        frequency_hz: None,
        high_hz: None,
        phase_deg: 0.0,
    }
}
