//! Checks whether the closed loop is stable with given gains and delay.

/// The step of the simulation is at least this fraction of the delay.
const FINEST: f64 = 1.0 / 32.0;
/// The simulation covers this many delays and time constants.
const HORIZON: f64 = 100.0;

/// Whether the error of a loop with these gains (proportional, and integral per second) decays. The stage has
/// gain 1, the delay `delay_s` and a first-order lag with the time constant `lag_s`; the loop is sampled
/// every `period_s`. All times are in seconds.
///
/// The function simulates the step response and compares the largest errors of an early and of a late
/// interval.
pub fn is_stable([kp, ki_per_s]: [f64; 2], delay_s: f64, lag_s: f64, period_s: f64) -> bool {
    let dt = period_s.max(FINEST * delay_s);
    let delay = (delay_s / dt).round().max(1.0) as usize;
    let left = if lag_s > 0.0 { (-dt / lag_s).exp() } else { 0.0 };
    // A lag longer than a thousand delays does no harm to stability.
    let steps = (HORIZON * (delay as f64 + (lag_s / dt).min(1e3 * delay as f64))) as usize;
    let mut commands = vec![0.0; steps + delay];
    let (mut beam, mut last, mut command) = (0.0_f64, 1.0, 0.0);
    let mut largest = [0.0_f64; 2];
    for k in 0..steps {
        beam = commands[k] + (beam - commands[k]) * left;
        let error = 1.0 - beam;
        command += kp * (error - last) + ki_per_s * dt * error;
        commands[k + delay] = command;
        last = error;
        if !error.is_finite() {
            return false;
        }
        if k >= steps / 4 {
            let half = usize::from(k >= steps * 5 / 8);
            largest[half] = largest[half].max(error.abs());
        }
    }
    largest[1] <= largest[0].max(1e-9)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stable(kp: f64, ki_per_s: f64, lag_ms: f64) -> bool {
        is_stable([kp, ki_per_s], 2.5e-3, lag_ms * 1e-3, 1e-3)
    }

    #[test]
    fn the_stability_limit_agrees_with_theory() {
        // An integrator with a delay is stable up to Ki delay = pi/2; a sampled one acts half a period
        // earlier.
        let limit = |period_s| {
            (1..400)
                .map(|k| f64::from(k) * 0.01)
                .find(|k| !is_stable([0.0, k / 2.5e-3], 2.5e-3, 0.0, period_s))
        };
        assert!((limit(1e-6).unwrap() - 1.57).abs() < 0.05, "{:?}", limit(1e-6));
        assert!(stable(0.0, 0.0, 0.5), "zero gains");
        assert!(stable(0.1, 200.0, 0.5) && stable(0.0, 1.0, 0.5) && stable(0.1, 200.0, 1e6));
        assert!(!stable(0.1, 2000.0, 0.5) && !stable(10.0, 200.0, 0.5) && !stable(0.0, 1e5, 0.0));
    }
}
