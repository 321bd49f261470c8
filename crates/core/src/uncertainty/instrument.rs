//! The measurement model: the published pose as a function of all input quantities. SI units.

use nalgebra::Rotation3;
use trifacet_optics::{
    Estimator, Head, Model, Optics, Pose, Rigid, Signals, Solution, SolveError, TraceError, Vec2, Vec3,
};

use super::effect::{Effect, Moment};

/// Relative error of the diameter at which the product of diameter and offset is evaluated. The result is
/// proportional to the product.
const DIAMETER: f64 = 0.05;

/// Why a pose has no budget.
#[derive(Clone, Debug, thiserror::Error)]
pub enum InstrumentError {
    /// The mirror cannot be at the tare pose.
    #[error("the tare pose is outside the range of the sensor: {0}; check [frames]")]
    Tare(TraceError),
    /// The sensor cannot measure the pose.
    #[error("the pose {} is outside the range of the sensor: {reason}", text(pose))]
    Pose {
        /// The pose relative to the tare.
        pose: Pose,
        /// The reason.
        reason: TraceError,
    },
    /// The equations have no solution.
    #[error("the pose cannot be solved: {0}")]
    Solve(#[from] SolveError),
}

fn text(pose: &Pose) -> String {
    let [x, y, z, roll, pitch, yaw] = pose.to_array().map(|value| value * 1e6);
    format!("{x} {y} {z} um, {roll} {pitch} {yaw} urad")
}

/// An instrument at its tare pose.
#[derive(Clone, Debug)]
pub struct Instrument {
    head: Head,
    estimator: Estimator,
    tool: Rigid,
    /// The table of the reference of the calibration, in the frame of the mirror.
    table: Rigid,
    /// The mirror at the tare, in the sensor's world frame.
    tare: Rigid,
    tared: bool,
}

/// An instrument with the mirror at a pose.
#[derive(Clone, Debug)]
pub struct Measurement<'a> {
    instrument: &'a Instrument,
    /// Signals and solution at the pose and at the tare.
    at: [At; 2],
}

#[derive(Clone, Debug)]
struct At {
    pose: Pose,
    signals: Signals,
    solution: Solution,
}

/// Deviations of all quantities from their estimates.
#[derive(Clone, Debug, Default)]
struct Deviations {
    at: [SignalDeviations; 2],
    direction: [f64; 2],
    gain: f64,
    distance: f64,
    height: f64,
    sum: [f64; 3],
    pose: [f64; 6],
    relative: [f64; 6],
    tool: [f64; 3],
    scale: [f64; 3],
    angle_scale: [f64; 3],
    squareness: [f64; 3],
}

#[derive(Clone, Debug, Default)]
struct SignalDeviations {
    spots: [f64; 6],
    powers: [f64; 3],
    offset: [f64; 2],
}

impl Instrument {
    /// An instrument with this head. `tool`: the point of interest in the frame of the mirror. `tare`: the mirror at the
    /// tare, in the sensor's world frame; `None`: not tared, poses are relative to the centred mirror.
    pub fn new(head: Head, model: Model, tool: Rigid, tare: Option<Rigid>) -> Self {
        let estimator = Estimator::new(Optics::new(&head), model);
        let (tared, tare) = (tare.is_some(), tare.unwrap_or_else(Rigid::identity));
        Self { head, estimator, tool, table: Rigid::identity(), tare, tared }
    }

    /// The instrument, calibrated with a reference whose table is at this place in the frame of the mirror.
    #[must_use]
    pub fn calibrated_at(self, table: Rigid) -> Self {
        Self { table, ..self }
    }

    /// Whether it is tared.
    pub fn tared(&self) -> bool {
        self.tared
    }

    /// The point of interest with its axes at the tare, in the sensor's world frame.
    pub fn zero(&self) -> Rigid {
        self.tare * self.tool
    }

    /// The point of interest with its axes, in the frame of the mirror.
    pub fn tool(&self) -> Rigid {
        self.tool
    }

    /// The model of the beam.
    pub fn model(&self) -> Model {
        self.estimator.model()
    }

    /// The measurement of a pose relative to the tare, in the user's frames.
    ///
    /// # Errors
    /// The pose or the tare pose is outside the range of the sensor.
    pub fn measure(&self, pose: &Pose) -> Result<Measurement<'_>, InstrumentError> {
        let sensor = self.tare * self.tool * Rigid::from(pose) * self.tool.inverse();
        let refuse = |reason| InstrumentError::Pose { pose: *pose, reason };
        let tare = self.at(&Pose::from(&self.tare), InstrumentError::Tare)?;
        Ok(Measurement { instrument: self, at: [self.at(&Pose::from(&sensor), refuse)?, tare] })
    }

    fn at(&self, pose: &Pose, refuse: impl Fn(TraceError) -> InstrumentError) -> Result<At, InstrumentError> {
        let signals = self.signals(pose, Vec2::zeros()).map_err(refuse)?;
        let solution = self.estimator.solve(&signals, None)?;
        Ok(At { pose: *pose, signals, solution })
    }

    fn signals(&self, pose: &Pose, offset: Vec2) -> Result<Signals, TraceError> {
        let reading = self.estimator.optics().trace(self.model(), pose, offset)?;
        Ok(Signals { spots: reading.spots, powers: reading.powers })
    }

    /// The solver for a head that deviates.
    fn estimator(&self, moment: Moment, by: &Deviations, diameter: bool) -> Option<Estimator> {
        let drifted = moment == Moment::Pose && (by.direction != [0.0; 2] || by.distance != 0.0);
        if !drifted && !diameter {
            return None;
        }
        let mut head = self.head.clone();
        if moment == Moment::Pose {
            let optics = self.estimator.optics();
            // The axes across the nominal beam, in which offsets are given.
            let axis = |i: usize| Vec3::from_fn(|k, _| optics.across(Vec3::ith(k, 1.0))[i]);
            let turn = axis(0) * by.direction[0] + axis(1) * by.direction[1];
            head.beam_direction = Rotation3::new(turn) * head.beam_direction;
            for psd in &mut head.psds {
                psd.origin *= 1.0 + by.distance;
            }
        }
        if diameter {
            head.beam_diameter *= 1.0 + DIAMETER;
        }
        Some(Estimator::new(Optics::new(&head), self.model()))
    }
}

impl Measurement<'_> {
    /// The spot coordinates (u, v of A, B, C, metres) at the pose or at the tare.
    pub fn spots(&self, moment: Moment) -> [f64; 6] {
        self.at[moment as usize].signals.spots
    }

    /// The pose of the mirror in the sensor's world frame, at the pose or at the tare.
    pub fn sensor_pose(&self, moment: Moment) -> Pose {
        self.at[moment as usize].pose
    }

    /// The pose relative to the tare that is published if the quantities deviate from their estimates: tx, ty, tz in
    /// metres, roll, pitch, yaw in radians.
    ///
    /// # Errors
    /// There is no pose with these deviations.
    pub fn pose(&self, deviations: impl Iterator<Item = (Effect, f64)>) -> Result<[f64; 6], InstrumentError> {
        let mut by = Deviations::default();
        for (effect, value) in deviations {
            by.add(effect, value);
        }
        let mut mirror = self.solved(Moment::Pose, &by)?;
        mirror.t.z += by.height;
        let mirror = plus(mirror.to_array(), &by.pose);
        let tare = self.solved(Moment::Tare, &by)?;
        let mut relative = Rigid::from(&tare).inverse() * Rigid::from(&Pose::from_array(mirror));
        if by.relative != [0.0; 6] {
            let table = self.instrument.table;
            let seen = Pose::from(&(table.inverse() * relative * table)).to_array();
            relative = table * Rigid::from(&Pose::from_array(plus(seen, &by.relative))) * table.inverse();
        }
        let mut tool = self.instrument.tool;
        tool.translation += Vec3::from(by.tool);
        let pose = Pose::from(&(tool.inverse() * relative * tool));
        Ok(by.reference(pose.to_array()))
    }

    /// The derivative of the pose with respect to a quantity with this standard uncertainty, over plus and minus the
    /// uncertainty (JCGM 100, 5.1.3, note 2).
    ///
    /// # Errors
    /// There is no pose with these deviations.
    pub fn slope(&self, effect: Effect, std: f64) -> Result<[f64; 6], InstrumentError> {
        // A quantity without uncertainty has a derivative all the same.
        let step = if std > 0.0 { std } else { 1e-8 };
        let moved = |by: f64| self.pose(std::iter::once((effect, by)));
        let (high, low) = (moved(step)?, moved(-step)?);
        Ok(std::array::from_fn(|j| (high[j] - low[j]) / (2.0 * step)))
    }

    fn solved(&self, moment: Moment, by: &Deviations) -> Result<Pose, InstrumentError> {
        let (at, own) = (&self.at[moment as usize], &by.at[moment as usize]);
        let mut signals = at.signals;
        let diameter = own.offset != [0.0; 2];
        if diameter {
            let offset = Vec2::from(own.offset) / DIAMETER;
            signals = self.instrument.signals(&at.pose, offset).map_err(InstrumentError::Tare)?;
        }
        let gain = if moment == Moment::Pose { by.gain } else { 0.0 };
        for (i, spot) in signals.spots.iter_mut().enumerate() {
            *spot = *spot * (1.0 + gain) * (1.0 + by.sum[i / 2]) + own.spots[i];
        }
        for (power, deviation) in signals.powers.iter_mut().zip(own.powers) {
            *power *= 1.0 + deviation;
        }
        let drifted = self.instrument.estimator(moment, by, diameter);
        let (estimator, warm) = match &drifted {
            Some(drifted) => (drifted, None),
            None => (&self.instrument.estimator, Some(&at.solution)),
        };
        Ok(estimator.solve(&signals, warm)?.pose)
    }
}

impl Deviations {
    fn add(&mut self, effect: Effect, value: f64) {
        let place = match effect {
            Effect::Spot(moment, i) => &mut self.at[moment as usize].spots[i],
            Effect::Power(moment, i) => &mut self.at[moment as usize].powers[i],
            Effect::Offset(moment, i) => &mut self.at[moment as usize].offset[i],
            Effect::Direction(i) => &mut self.direction[i],
            Effect::Gain => &mut self.gain,
            Effect::Distance => &mut self.distance,
            Effect::Height => &mut self.height,
            Effect::SumOffset(i) => &mut self.sum[i],
            Effect::Pose(i) => &mut self.pose[i],
            Effect::Relative(i) => &mut self.relative[i],
            Effect::Tool(i) => &mut self.tool[i],
            Effect::Scale(i) => &mut self.scale[i],
            Effect::AngleScale(i) => &mut self.angle_scale[i],
            Effect::Squareness(i) => &mut self.squareness[i],
        };
        *place += value;
    }

    /// A pose as a reference with these errors would have it.
    fn reference(&self, [x, y, z, roll, pitch, yaw]: [f64; 6]) -> [f64; 6] {
        let [xy, xz, yz] = self.squareness;
        let [a, b, c] = self.scale.map(|scale| 1.0 + scale);
        let [d, e, f] = self.angle_scale.map(|scale| 1.0 + scale);
        [a * x + xy * y + xz * z, b * y + yz * z, c * z, d * roll, e * pitch, f * yaw]
    }
}

fn plus(mut pose: [f64; 6], by: &[f64; 6]) -> [f64; 6] {
    for (value, deviation) in pose.iter_mut().zip(by) {
        *value += deviation;
    }
    pose
}
