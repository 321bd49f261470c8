//! The budget at a pose, the Monte Carlo method beside it, and the worst pose of a range.

use nalgebra::{DMatrix, Matrix6};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use trifacet_budget::validation::tolerance;
use trifacet_budget::{Budget, BudgetError, Input, MonteCarlo, Sampler, SamplerError, Stop, Validation};
use trifacet_core::uncertainty::{Effect, Instrument, InstrumentError, Measurement, Moment};
use trifacet_optics::{Pose, Rigid};

use crate::config::{Components, Group, NotCovered, Unit};

/// Names and units of the measurands.
pub const MEASURANDS: [(&str, Unit); 6] = [
    ("tx", Unit::Metre),
    ("ty", Unit::Metre),
    ("tz", Unit::Metre),
    ("roll", Unit::Radian),
    ("pitch", Unit::Radian),
    ("yaw", Unit::Radian),
];

/// Significant digits of a standard uncertainty.
pub const DIGITS: i32 = 2;

/// What a calibration record tells about poses.
pub trait PoseCovariance {
    /// Covariances of poses relative to the tare, of the table of the reference: tx, ty, tz (m), roll, pitch, yaw
    /// (rad). `tare` and `poses` are those of the mirror in the sensor's world frame. `None` if one of them is out of
    /// reach.
    fn relative_to(&self, tare: &Pose, poses: &[Pose]) -> Option<Vec<Matrix6<f64>>>;

    /// The PSDs on which the spot of a pose of the mirror, in the sensor's world frame, lies outside of the readings
    /// of the calibration.
    fn uncovered(&self, pose: &Pose) -> Vec<char>;

    /// The table of the reference, in the frame of the mirror.
    fn table(&self) -> Rigid;

    /// Where the numbers come from: the record and its date.
    fn source(&self) -> String;
}

/// Why there is no budget.
#[derive(Clone, Debug, thiserror::Error)]
pub enum AssessmentError {
    /// The pose cannot be measured.
    #[error(transparent)]
    Instrument(#[from] InstrumentError),
    /// The quantities do not make a budget.
    #[error(transparent)]
    Budget(#[from] BudgetError),
    /// The calibration record has no uncertainty for a pose.
    #[error("the calibration record states no uncertainty here: a PSD gets no light")]
    Calibration,
    /// The quantities cannot be drawn.
    #[error(transparent)]
    Sampler(#[from] SamplerError),
}

/// All that a budget is made of.
pub struct Basis<'a> {
    /// The instrument.
    pub instrument: Instrument,
    /// The quantities that the configuration states.
    pub components: Components,
    /// The calibration record that belongs to the configuration.
    pub calibration: Option<&'a dyn PoseCovariance>,
    /// Why the head does not count as calibrated.
    pub objection: Option<String>,
}

/// The budget at a pose.
#[derive(Clone, Debug)]
pub struct Assessment {
    /// The pose relative to the tare.
    pub pose: Pose,
    /// The rows of the table. Their inputs are those of the budget, in this order.
    pub groups: Vec<Group>,
    /// The budget of tx, ty, tz (m), roll, pitch, yaw (rad).
    pub budget: Budget,
    /// What it does not cover.
    pub not_covered: Vec<NotCovered>,
    /// Effects that do not matter, and why.
    pub notes: Vec<String>,
    /// The PSDs on which the spot lies outside of the readings of the calibration.
    pub uncovered: Vec<char>,
    /// Whether it covers the geometry of the head: by a calibration record, or as configured.
    pub geometry: Geometry,
    /// Why the head does not count as calibrated.
    pub objection: Option<String>,
}

/// What stands for the errors of the head's geometry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Geometry {
    /// A calibration record, which may have expired.
    Calibrated,
    /// `estimation.systematic_um` and `systematic_urad`.
    Configured,
    /// Nothing.
    NotCovered,
}

impl Basis<'_> {
    /// The budget at a pose relative to the tare.
    ///
    /// # Errors
    /// The pose is outside the range of the sensor.
    pub fn assess(&self, pose: &Pose) -> Result<Assessment, AssessmentError> {
        self.assess_all(std::slice::from_ref(pose))?.pop().ok_or(AssessmentError::Calibration)
    }

    /// The budgets at several poses: the calibration record is asked once for all.
    fn assess_all(&self, poses: &[Pose]) -> Result<Vec<Assessment>, AssessmentError> {
        let measure = |pose| Ok((pose, self.instrument.measure(pose)?));
        let measurements = poses.iter().map(measure).collect::<Result<Vec<_>, AssessmentError>>()?;
        let mut covariances = vec![None; poses.len()];
        if let (Some(calibration), Some((_, first))) = (&self.calibration, measurements.first()) {
            let sensor: Vec<_> = measurements.iter().map(|(_, m)| m.sensor_pose(Moment::Pose)).collect();
            let known = calibration.relative_to(&first.sensor_pose(Moment::Tare), &sensor);
            covariances = known.ok_or(AssessmentError::Calibration)?.into_iter().map(Some).collect();
        }
        let all = measurements.iter().zip(&covariances);
        all.map(|((pose, measurement), covariance)| self.assess_one(pose, measurement, covariance.as_ref()))
            .collect()
    }

    fn assess_one(
        &self,
        pose: &Pose,
        measurement: &Measurement<'_>,
        covariance: Option<&Matrix6<f64>>,
    ) -> Result<Assessment, AssessmentError> {
        let mut groups = self.components.groups.clone();
        for (input, effect) in groups.iter_mut().flat_map(|group| &mut group.inputs) {
            if let Effect::Spot(moment, i) = *effect {
                input.value = measurement.spots(moment)[i];
            }
        }
        let correlation = covariance.map(|covariance| self.add_calibration(covariance, &mut groups));
        let inputs: Vec<_> = groups.iter().flat_map(|group| group.inputs.clone()).collect();
        let count = inputs.len();
        let mut sensitivities = DMatrix::zeros(6, count);
        for (i, (input, effect)) in inputs.iter().enumerate() {
            sensitivities.set_column(i, &nalgebra::Vector6::from(measurement.slope(*effect, input.std)?));
        }
        let inputs = inputs.into_iter().map(|(input, _)| input).collect();
        let configured =
            groups.iter().any(|group| group.inputs.iter().any(|(_, e)| matches!(e, Effect::Pose(_))));
        let sensor = measurement.sensor_pose(Moment::Pose);
        let uncovered = self.calibration.map_or(Vec::new(), |calibration| calibration.uncovered(&sensor));
        let mut notes = self.components.notes.clone();
        if !uncovered.is_empty() {
            let psds = uncovered.iter().map(char::to_string).collect::<Vec<_>>().join(", ");
            notes.push(format!(
                "The calibration does not cover this pose: the spot on PSD {psds} lies outside of its readings."
            ));
        }
        Ok(Assessment {
            pose: *pose,
            uncovered,
            budget: Budget::new(inputs, sensitivities, correlation)?,
            groups,
            not_covered: self.components.not_covered.clone(),
            notes,
            geometry: match (self.calibration.is_some(), configured) {
                (true, _) => Geometry::Calibrated,
                (false, true) => Geometry::Configured,
                (false, false) => Geometry::NotCovered,
            },
            objection: self.objection.clone(),
        })
    }

    /// Adds the rows of the calibration; returns the correlation of all inputs.
    fn add_calibration(&self, covariance: &Matrix6<f64>, groups: &mut Vec<Group>) -> DMatrix<f64> {
        let source = self.calibration.map_or(String::new(), PoseCovariance::source);
        let std = covariance.diagonal().map(|variance| variance.max(0.0).sqrt());
        let first: usize = groups.iter().map(|group| group.inputs.len()).sum();
        for (name, unit, from) in
            [("calibration, position", Unit::Metre, 0), ("calibration, rotation", Unit::Radian, 3)]
        {
            let input = |i: usize| {
                let name = format!("{name}: {}", MEASURANDS[from + i].0);
                (Input::normal(name, 0.0, std[from + i]), Effect::Relative(from + i))
            };
            let inputs = (0..3).map(input).collect();
            groups.push(Group { name: name.into(), source: source.clone(), unit, inputs });
        }
        let mut correlation = DMatrix::identity(first + 6, first + 6);
        for (i, k) in (0..6).flat_map(|i| (0..i).map(move |k| (i, k))) {
            let scale = std[i] * std[k];
            let r = if scale > 0.0 { (covariance[(i, k)] / scale).clamp(-1.0, 1.0) } else { 0.0 };
            (correlation[(first + i, first + k)], correlation[(first + k, first + i)]) = (r, r);
        }
        correlation
    }

    /// Draws all quantities, and computes the pose with the full model.
    ///
    /// # Errors
    /// The pose is outside the range of the sensor, or the quantities cannot be drawn.
    pub fn monte_carlo(
        &self,
        assessment: &Assessment,
        probability: f64,
        trials: usize,
        seed: u64,
    ) -> Result<MonteCarlo, AssessmentError> {
        let measurement = self.instrument.measure(&assessment.pose)?;
        let inputs = assessment.budget.inputs();
        let count = inputs.len();
        let correlation = DMatrix::from_fn(count, count, |a, b| assessment.budget.input_correlation(a, b));
        let mut sampler = Sampler::new(inputs, Some(&correlation), seed)?;
        let effects: Vec<_> =
            assessment.groups.iter().flat_map(|g| &g.inputs).map(|(i, e)| (*e, i.value)).collect();
        Ok(MonteCarlo::run(&mut sampler, 6, probability, Stop::After(trials), |drawn, pose| {
            let deviations = effects.iter().zip(drawn).map(|((effect, value), x)| (*effect, x - value));
            match measurement.pose(deviations) {
                Ok(result) => pose.copy_from_slice(&result),
                Err(_) => return false,
            }
            true
        }))
    }

    /// The worst pose of a range: that with the largest sum over the six measurands of their variances, each relative
    /// to that at the tare. Searched among the 64 corners, the middle, the 12 ends of the axes, and 200 poses at random
    /// with a fixed seed. Poses that the calibration does not cover are left out, and a note counts them. Also the
    /// largest standard uncertainty of each measurand, and the pose where it occurs.
    ///
    /// # Errors
    /// A pose of the range is outside the range of the sensor.
    pub fn worst(&self, range: [f64; 2]) -> Result<(Assessment, [(f64, Pose); 6]), AssessmentError> {
        let middle = self.assess(&Pose::default())?;
        let at_tare: [f64; 6] = std::array::from_fn(|j| middle.budget.standard_uncertainty(j));
        let mut largest = at_tare.map(|u| (u, Pose::default()));
        let mut worst = (0.0, middle);
        let all = self.assess_all(&candidates(range))?;
        let count = all.len();
        let (covered, outside): (Vec<_>, Vec<_>) = all.into_iter().partition(|a| a.uncovered.is_empty());
        for assessment in covered {
            let mut size = 0.0;
            for (j, largest) in largest.iter_mut().enumerate() {
                let u = assessment.budget.standard_uncertainty(j);
                size += if at_tare[j] > 0.0 { (u / at_tare[j]).powi(2) } else { 0.0 };
                if u > largest.0 {
                    *largest = (u, assessment.pose);
                }
            }
            if size > worst.0 {
                worst = (size, assessment);
            }
        }
        if !outside.is_empty() {
            let corners = outside.iter().filter(|a| is_corner(&a.pose, range)).count();
            worst.1.notes.push(format!(
                "The calibration does not cover {} of the {count} poses searched, {corners} of them among the 64 corners of \
                 the range. They are left out of the search: the uncertainty there rests on extrapolation.",
                outside.len()
            ));
        }
        Ok((worst.1, largest))
    }
}

/// Whether a pose is at an end of the range in all axes.
fn is_corner(pose: &Pose, [metres, radians]: [f64; 2]) -> bool {
    let ends = [metres, metres, metres, radians, radians, radians];
    pose.to_array().iter().zip(ends).all(|(x, end)| x.abs() >= end)
}

/// The poses among which the worst one is searched.
fn candidates([metres, radians]: [f64; 2]) -> Vec<Pose> {
    let scaled =
        |x: [f64; 6]| Pose::from_array(std::array::from_fn(|i| x[i] * if i < 3 { metres } else { radians }));
    let mut poses = Vec::new();
    for corner in 0..64 {
        poses.push(scaled(std::array::from_fn(|i| if corner >> i & 1 == 1 { 1.0 } else { -1.0 })));
    }
    for (axis, sign) in (0..6).flat_map(|axis| [(axis, 1.0), (axis, -1.0)]) {
        poses.push(scaled(std::array::from_fn(|i| if i == axis { sign } else { 0.0 })));
    }
    let mut rng = Pcg64::seed_from_u64(1);
    for _ in 0..200 {
        poses.push(scaled(std::array::from_fn(|_| 2.0 * rng.random::<f64>() - 1.0)));
    }
    poses
}

impl Assessment {
    /// The place of the first input of each row, and their number.
    pub fn rows(&self) -> impl Iterator<Item = (&Group, std::ops::Range<usize>)> {
        let mut first = 0;
        self.groups.iter().map(move |group| {
            let range = first..first + group.inputs.len();
            first = range.end;
            (group, range)
        })
    }

    /// The comparison of the interval of a measurand with that of the Monte Carlo method.
    pub fn validation(&self, measurand: usize, trials: &MonteCarlo) -> Validation {
        let u = self.budget.standard_uncertainty(measurand);
        let expanded = self.budget.expanded(measurand, trials.probability());
        let interval = trials.symmetric(measurand);
        let estimate = self.pose.to_array()[measurand];
        Validation::new(estimate, expanded, interval, trials.scatter(measurand), tolerance(u, DIGITS))
    }

    /// Whether the budget is that of the whole instrument, in a sentence.
    pub fn verdict(&self) -> String {
        let objection = self.objection.as_deref().unwrap_or_default();
        let missing = self.not_covered.len();
        let rest = match missing {
            0 => "all effects that the configuration can state are covered".into(),
            1 => "one effect that the configuration does not state is not covered".into(),
            count => format!("{count} effects that the configuration does not state are not covered"),
        };
        match self.geometry {
            Geometry::Calibrated if self.objection.is_none() => format!("The head is calibrated; {rest}."),
            Geometry::Calibrated => {
                format!(
                    "Not calibrated: {objection}. Its record stands for the geometry of the head; {rest}."
                )
            }
            Geometry::Configured => format!(
                "Not calibrated: {objection}. estimation.systematic_um and systematic_urad stand for the geometry of the \
                 head; {rest}."
            ),
            Geometry::NotCovered => format!(
                "THE HEAD IS NOT CALIBRATED: {objection}, and estimation.systematic_um and systematic_urad are 0. \
                 The budget does not cover the geometry of the head; {rest}."
            ),
        }
    }
}

#[cfg(test)]
mod tests;
