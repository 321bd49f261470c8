//! The motion of the mirror: a pose for every time.
//!
//! Motions add up per axis; without a motion the axis is at rest. Every motion, including vibration, is a
//! pure function of time, so that poses can be computed for any times in any order.

use std::f64::consts::TAU;

use rand::RngExt;
use rand_pcg::Pcg64;
use trifacet_optics::Pose;

use super::{TwinError, random};
use crate::config::{Motion, MotionKind};

/// Number of sines in a vibration. With one sine in each of this many slices of the band, the sum is close to
/// normally distributed, and repeats only after the inverse of the width of a slice, if at all.
const VIBRATION_SINES: u32 = 40;

/// The pose of the mirror as a function of time.
#[derive(Clone, Debug)]
pub struct Trajectory {
    movements: Vec<Movement>,
}

/// One motion of one axis.
#[derive(Clone, Debug)]
struct Movement {
    /// Index into tx, ty, tz, roll, pitch, yaw.
    axis: usize,
    from_s: f64,
    until_s: f64,
    course: Course,
}

/// Amounts in metres or radians; waves as a function of the time since `from_s`. `Travel` is the way that is
/// still to go: its amount at `from_s`, zero at `until_s`.
#[derive(Clone, Debug)]
enum Course {
    Step(f64),
    Ramp(f64),
    Travel(f64),
    Waves(Vec<Wave>),
}

#[derive(Clone, Copy, Debug)]
struct Wave {
    amplitude: f64,
    omega: f64,
    phase: f64,
}

impl Trajectory {
    /// The sum of these motions; `seed` determines frequencies and phases of the vibrations.
    ///
    /// # Errors
    /// A motion is incomplete or has a value out of range; the error names its key.
    pub fn new(motions: &[Motion], seed: u64) -> Result<Self, TwinError> {
        let movements = motions.iter().enumerate().map(|(i, motion)| movement(i, motion, seed));
        Ok(Self { movements: movements.collect::<Result<_, _>>()? })
    }

    /// A constant pose.
    pub fn rest(pose: Pose) -> Self {
        let stay = |(axis, amount)| Movement {
            axis,
            from_s: 0.0,
            until_s: f64::INFINITY,
            course: Course::Step(amount),
        };
        Self { movements: pose.to_array().into_iter().enumerate().map(stay).collect() }
    }

    /// A move from `from` to `to` that begins at `at_s` and takes `over_s` seconds. It begins and ends without a
    /// step of velocity or acceleration (minimum jerk), so that the loop can follow.
    pub fn travel(from: &Pose, to: &Pose, at_s: f64, over_s: f64) -> Self {
        let Self { mut movements } = Self::rest(*to);
        for (axis, (from, to)) in from.to_array().into_iter().zip(to.to_array()).enumerate() {
            let course = Course::Travel(from - to);
            movements.push(Movement { axis, from_s: at_s, until_s: at_s + over_s, course });
        }
        Self { movements }
    }

    /// The pose at `t_s` seconds.
    pub fn pose(&self, t_s: f64) -> Pose {
        let mut pose = [0.0; 6];
        for m in &self.movements {
            pose[m.axis] += m.at(t_s);
        }
        Pose::from_array(pose)
    }
}

impl Movement {
    fn at(&self, t_s: f64) -> f64 {
        let since = t_s - self.from_s;
        if since < 0.0 {
            return 0.0;
        }
        match &self.course {
            Course::Ramp(amount) => amount * (since / (self.until_s - self.from_s)).min(1.0),
            _ if t_s >= self.until_s => 0.0,
            Course::Step(amount) => *amount,
            Course::Travel(way) => {
                let part = since / (self.until_s - self.from_s);
                way * (1.0 - part.powi(3) * (10.0 + part * (6.0 * part - 15.0)))
            }
            Course::Waves(waves) => {
                waves.iter().map(|w| w.amplitude * (w.omega * since + w.phase).sin()).sum()
            }
        }
    }
}

fn movement(i: usize, motion: &Motion, seed: u64) -> Result<Movement, TwinError> {
    let error = |key: &str, reason: &str| TwinError::new(format!("twin.motion[{i}].{key}"), reason);
    let amount = amount(motion, error)?;
    let frequency = || match motion.frequency_hz {
        Some(f) if f > 0.0 && f.is_finite() => Ok(f),
        _ => Err(error("frequency_hz", "a sine or vibration needs a frequency above 0")),
    };
    if !(motion.from_s.is_finite() && motion.until_s.is_none_or(|until| until > motion.from_s)) {
        return Err(error("until_s", "must be later than from_s"));
    }
    let course = match motion.kind {
        MotionKind::Step => Course::Step(amount),
        MotionKind::Ramp if motion.until_s.is_none_or(f64::is_infinite) => {
            return Err(error("until_s", "a ramp needs the time at which it has covered its amount"));
        }
        MotionKind::Ramp => Course::Ramp(amount),
        MotionKind::Sine => Course::Waves(vec![Wave {
            amplitude: amount,
            omega: TAU * frequency()?,
            phase: motion.phase_deg.to_radians(),
        }]),
        MotionKind::Vibration => {
            let low = frequency()?;
            let high = match motion.high_hz {
                Some(high) if high > low && high.is_finite() => high,
                _ => {
                    return Err(error(
                        "high_hz",
                        "a vibration needs its upper frequency, above frequency_hz",
                    ));
                }
            };
            Course::Waves(vibration(amount, low, high, &mut random(seed, 2 + i as u64)))
        }
    };
    let until_s = motion.until_s.unwrap_or(f64::INFINITY);
    Ok(Movement { axis: motion.axis as usize, from_s: motion.from_s, until_s, course })
}

/// The amount in metres or radians; only the key that fits the axis may be set.
fn amount(motion: &Motion, error: impl Fn(&str, &str) -> TwinError) -> Result<f64, TwinError> {
    let (amount, stray, key) = if motion.axis.is_turn() {
        (motion.amount_urad, motion.amount_um, "amount_urad")
    } else {
        (motion.amount_um, motion.amount_urad, "amount_um")
    };
    match (amount, stray) {
        (Some(micro), None) if micro.is_finite() => Ok(micro * 1e-6),
        _ => Err(error(key, "must be set, finite, and the only amount: translation in um, rotation in urad")),
    }
}

/// Noise between two frequencies with this rms: one sine at a random frequency in each slice of the band.
fn vibration(rms: f64, low: f64, high: f64, rng: &mut Pcg64) -> Vec<Wave> {
    let width = (high - low) / f64::from(VIBRATION_SINES);
    let amplitude = rms * (2.0 / f64::from(VIBRATION_SINES)).sqrt();
    (0..VIBRATION_SINES)
        .map(|k| {
            let frequency = low + width * (f64::from(k) + rng.random::<f64>());
            Wave { amplitude, omega: TAU * frequency, phase: TAU * rng.random::<f64>() }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Axis;

    fn motion(axis: Axis, amount: f64, kind: MotionKind) -> Motion {
        let turn = axis.is_turn();
        Motion {
            axis,
            amount_um: (!turn).then_some(amount),
            amount_urad: turn.then_some(amount),
            kind,
            from_s: 1.0,
            until_s: Some(3.0),
            frequency_hz: Some(0.5),
            high_hz: Some(40.0),
            phase_deg: 90.0,
        }
    }

    fn at(motions: &[Motion], t_s: f64) -> [f64; 6] {
        Trajectory::new(motions, 1).unwrap().pose(t_s).to_array()
    }

    #[test]
    fn motions_follow_their_course_and_add_up() {
        let step = motion(Axis::Tx, 10.0, MotionKind::Step);
        let ramp = motion(Axis::Tx, 4.0, MotionKind::Ramp);
        let sine = motion(Axis::Pitch, 5.0, MotionKind::Sine);
        let all = [step, ramp, sine];
        let expect = |t, tx: f64, pitch: f64| {
            let pose = at(&all, t);
            assert!((pose[0] - tx).abs() < 1e-18 && (pose[4] - pitch).abs() < 1e-18, "{t}: {pose:?}");
            assert!([1, 2, 3, 5].iter().all(|&i| pose[i] == 0.0));
        };
        expect(0.999, 0.0, 0.0);
        expect(1.0, 10e-6, 5e-6);
        expect(1.5, 11e-6, 0.0);
        expect(2.0, 12e-6, -5e-6);
        expect(3.0, 4e-6, 0.0);
        expect(99.0, 4e-6, 0.0);
        assert_eq!(at(&[], 2.0), [0.0; 6]);
    }

    #[test]
    fn a_move_begins_where_the_mirror_is_ends_at_its_target_and_never_jumps() {
        let (from, to) = ([1e-3, 0.0, -2e-4, 5e-3, 0.0, 1e-4], [-1e-3, 3e-4, -2e-4, -5e-3, 2e-3, 0.0]);
        let travel = Trajectory::travel(&Pose::from_array(from), &Pose::from_array(to), 3.0, 0.5);
        let at = |t_s: f64| travel.pose(t_s).to_array();
        assert_eq!(at(3.5), to);
        assert_eq!(at(99.0), to);
        let near = |a: [f64; 6], b: [f64; 6]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-18);
        assert!(near(at(3.0), from), "{:?}", at(3.0));
        assert!(near(at(3.25), [0, 1, 2, 3, 4, 5].map(|i| f64::midpoint(from[i], to[i]))), "{:?}", at(3.25));
        // The largest velocity of a minimum-jerk move is 1.875 times the mean.
        let step = |k: u32| (at(3.0 + 1e-3 * f64::from(k + 1))[0] - at(3.0 + 1e-3 * f64::from(k))[0]).abs();
        let largest = (0..500).map(step).fold(0.0, f64::max);
        assert!((largest / (2e-3 / 500.0) - 1.875).abs() < 0.01, "{largest:e}");
        assert!(step(0) < 1e-9 && step(499) < 1e-9);
        assert_eq!(
            Trajectory::travel(&Pose::from_array(from), &Pose::from_array(to), 3.0, 0.0).pose(3.0).to_array(),
            to
        );
    }

    #[test]
    fn vibration_has_its_rms_and_its_band_and_repeats_by_seed() {
        let mut shake = motion(Axis::Yaw, 3.0, MotionKind::Vibration);
        (shake.from_s, shake.until_s, shake.frequency_hz) = (0.0, None, Some(20.0));
        let (rate, n) = (1000.0, 100_000);
        let one = Trajectory::new(&[shake.clone()], 7).unwrap();
        let x: Vec<f64> = (0..n).map(|k| one.pose(f64::from(k) / rate).yaw).collect();
        let rms = (x.iter().map(|x| x * x).sum::<f64>() / f64::from(n)).sqrt();
        assert!((rms / 3e-6 - 1.0).abs() < 0.02, "{rms}");
        // Zero crossings of noise between 20 and 40 Hz: twice the rms frequency, 30.55 Hz.
        let crossings = x.windows(2).filter(|w| w[0] * w[1] < 0.0).count() as f64 / 100.0;
        assert!((crossings - 61.1).abs() < 2.0, "{crossings}");
        assert_eq!(Trajectory::new(&[shake.clone()], 7).unwrap().pose(1.23), one.pose(1.23));
        assert_ne!(Trajectory::new(&[shake], 8).unwrap().pose(1.23), one.pose(1.23));
    }

    #[test]
    fn incomplete_motions_are_refused_by_key() {
        let whole = motion(Axis::Tz, 1.0, MotionKind::Vibration);
        let refused = |change: &dyn Fn(&mut Motion), key: &str| {
            let mut bad = whole.clone();
            change(&mut bad);
            let error = Trajectory::new(&[whole.clone(), bad], 1).unwrap_err();
            assert_eq!(error.key, format!("twin.motion[1].{key}"));
        };
        refused(&|m| m.amount_um = None, "amount_um");
        refused(&|m| m.amount_urad = Some(1.0), "amount_um");
        refused(&|m| m.axis = Axis::Roll, "amount_urad");
        refused(&|m| m.amount_um = Some(f64::NAN), "amount_um");
        refused(&|m| m.frequency_hz = None, "frequency_hz");
        refused(&|m| m.high_hz = Some(0.1), "high_hz");
        refused(&|m| m.until_s = Some(0.5), "until_s");
        refused(&|m| (m.kind, m.until_s) = (MotionKind::Ramp, None), "until_s");
    }
}
