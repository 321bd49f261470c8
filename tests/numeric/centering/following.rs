//! Tracking errors of the loop for a moving mirror: the table of `docs/centering.md`.
//!
//! 10 kHz; a command computed from sample k acts on sample k+4. One tuning for all rows.

use trifacet::closed_loop_sim::ClosedLoopSim;
use trifacet::config::{Axis, Config, Motion, MotionKind};

use super::{bench, motion};

/// Delay from a sample to the effect of its command, in samples.
const DELAY: usize = 4;

/// The change that a row makes to the bench.
type Change = fn(&mut Config);

/// The true offset of the beam along x, micrometres, of every scan.
fn offsets(change: Change, motion: &Motion, samples: usize) -> Vec<f64> {
    let mut config = bench();
    config.twin.motion.push(motion.clone());
    change(&mut config);
    let mut sim = ClosedLoopSim::new(&config).unwrap();
    (0..samples).map(|_| sim.step().scan.truth.offset.x * 1e6).collect()
}

fn along_x(kind: MotionKind, amount_um: f64) -> Motion {
    motion(Axis::Tx, kind, amount_um)
}

fn sine(amount_um: f64, frequency_hz: f64) -> Motion {
    Motion { frequency_hz: Some(frequency_hz), ..along_x(MotionKind::Sine, amount_um) }
}

fn rms(x: &[f64]) -> f64 {
    (x.iter().map(|x| x * x).sum::<f64>() / x.len() as f64).sqrt()
}

/// The response to a step.
#[derive(Debug)]
struct Step {
    /// Number of samples until the offset stays below 1 um.
    settled: usize,
    /// Overshoot, percent.
    overshoot: f64,
}

fn step(change: Change) -> Step {
    let after = &offsets(change, &Motion { from_s: 0.2, ..along_x(MotionKind::Step, 100.0) }, 3000)[2000..];
    // The mirror moves along +x, so the beam is off along -x, and an overshoot is positive.
    let settled = after.iter().rposition(|x| x.abs() >= 1.0).map_or(0, |k| k + 1);
    Step { settled, overshoot: after.iter().copied().fold(0.0, f64::max) }
}

struct Row {
    label: &'static str,
    step: Step,
    ramp: f64,
    sine_10: f64,
    sine_50: f64,
    rest: f64,
}

/// Rms of the ramp and of the sines over whole periods after a start-up of 0.2 s; the ramp includes its
/// onset.
fn row(label: &'static str, change: Change) -> Row {
    let rms_of = |motion| rms(&offsets(change, &motion, 12_000)[2000..]);
    let ramp = Motion { from_s: 0.2, until_s: Some(0.5), ..along_x(MotionKind::Ramp, 300.0) };
    Row {
        label,
        step: step(change),
        ramp: rms(&offsets(change, &ramp, 5000)[2000..]),
        sine_10: rms_of(sine(100.0, 10.0)),
        sine_50: rms_of(sine(20.0, 50.0)),
        rest: rms_of(along_x(MotionKind::Step, 0.0)),
    }
}

fn nine(config: &mut Config, tracking_hz: f64) {
    config.twin.steering.readback_noise_um = None;
    config.centering.tracking_hz = Some(tracking_hz);
}

#[test]
fn tracking_errors_are_those_of_the_documentation() {
    let rows = [
        row("PI alone", |c| c.centering.feed_forward = false),
        row("with feed-forward", |_| {}),
        row("nine signals", |c| c.twin.steering.readback_noise_um = None),
        row("nine signals, tracking 100 Hz", |c| nine(c, 100.0)),
        row("nine signals, tracking 50 Hz", |c| nine(c, 50.0)),
    ];
    println!(
        "{:<30} {:>14} {:>12} {:>13} {:>13} {:>13} {:>9}",
        "", "step: samples", "overshoot %", "ramp um rms", "10 Hz um rms", "50 Hz um rms", "rest"
    );
    for Row { label, step, ramp, sine_10, sine_50, rest } in &rows {
        println!(
            "{label:<30} {:>14} {:>12.2} {ramp:>13.3} {sine_10:>13.3} {sine_50:>13.3} {rest:>9.3}",
            step.settled, step.overshoot
        );
    }
    let [pi, forward, ..] = &rows;
    for Step { settled, overshoot } in [&pi.step, &forward.step] {
        assert!(*settled <= 8 * DELAY, "below 1 um after {settled} samples");
        assert!(*overshoot < 5.0, "{overshoot} %");
    }
    assert!(forward.ramp <= 0.1 && (pi.ramp - 0.8).abs() < 0.05);
    assert!(forward.sine_10 <= 0.4 && (pi.sine_10 - 3.5).abs() < 0.2);
    assert!(forward.sine_50 <= 1.77 && forward.sine_50 <= 0.5 * pi.sine_50);
}
