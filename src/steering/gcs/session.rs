//! A session with a controller: checks of its identity and settings, then motions.

use trifacet_core::steering::StagePosition;

use super::fault::{FINE, Fault, NOT_FOR_THIS_STAGE, UNKNOWN_COMMAND};
use super::link::{Link, label};
use super::protocol::{Answer, AnswerError, GcsQuery, move_to, servo_on};
use super::settings::Settings;
use super::unit;
use crate::config::SteeringConfig;

/// Fraction of its travel by which a stage may be beyond its ends: a controller regulates, and rounds.
const BEYOND: f64 = 0.01;

/// A controller that has passed the checks.
pub struct Session<'a> {
    settings: &'a Settings,
    link: Link,
    /// The ends of the travel, metres; one row per axis.
    travel: [[f64; 2]; 2],
}

impl<'a> Session<'a> {
    /// Connects, and checks whether the controller can be used as configured. Moves nothing, except by
    /// switching a servo on if that is allowed.
    ///
    /// # Errors
    /// The connection fails, or the controller cannot be used; the message names the remedy.
    pub async fn open(settings: &'a Settings, steering: &SteeringConfig) -> Result<Self, Fault> {
        let mut session = Self { settings, link: Link::open(settings).await?, travel: [[0.0; 2]; 2] };
        let identity = session.identify().await?;
        let left_over = session.error().await?;
        session.check_references().await?;
        session.check_unit().await?;
        let lowest = session.numbers(GcsQuery::Lowest).await?;
        let highest = session.numbers(GcsQuery::Highest).await?;
        let (low, high) = (settings.position(lowest), settings.position(highest));
        session.travel = [0, 1].map(|axis| [low[axis], high[axis]]);
        session.check_travel(steering)?;
        session.check_velocity(steering).await?;
        session.close_loops().await?;
        tracing::info!(
            %identity, line = %settings.line, axes = ?settings.axes, left_over_error = left_over,
            travel_um = ?session.travel.map(|ends| ends.map(rounded_um)),
            "steering stage identified"
        );
        Ok(session)
    }

    /// The identity: maker, model, serial number, version, separated by commas. Data left from an earlier
    /// session has another form.
    async fn identify(&mut self) -> Result<String, Fault> {
        const EXPECTED: &str = "maker, model, serial number and version";
        let (asked, answer) = self.ask(GcsQuery::Identity).await?;
        let wrong = |error| Fault::Answer { asked: asked.clone(), error };
        let line = answer.line(EXPECTED).map_err(wrong)?.to_owned();
        if line.matches(',').count() < 2 {
            return Err(wrong(AnswerError::Unexpected { expected: EXPECTED.into(), received: line }));
        }
        Ok(line)
    }

    /// Checks that the axes are in closed loop, where positions have a meaning.
    async fn close_loops(&mut self) -> Result<(), Fault> {
        let (asked, answer) = self.ask(GcsQuery::Servo).await?;
        let servo = answer.flags(&self.settings.axes).map_err(|error| Fault::Answer { asked, error })?;
        let Some(axis) = self.first_without(servo) else { return Ok(()) };
        if !self.settings.servo_on {
            return Err(Fault::Unfit(format!(
                "the servo of axis {axis} is off: switch it on, or let trifacet do it with \
                 steering.gcs.servo_on = true (the stage may jump then)"
            )));
        }
        tracing::info!(axes = ?self.settings.axes, "switching the servo on");
        let command = servo_on(&self.settings.axes);
        match self.command(&command).await? {
            FINE => Ok(()),
            code => Err(Fault::Refused { asked: label(&command), code }),
        }
    }

    /// Checks that the axes are referenced. Referencing moves the stage to its reference switch, so the
    /// operator must start it. Stages without a reference switch do not know the query.
    async fn check_references(&mut self) -> Result<(), Fault> {
        let Some((asked, answer)) = self.ask_if_known(GcsQuery::Referenced).await? else { return Ok(()) };
        let done = answer.flags(&self.settings.axes).map_err(|error| Fault::Answer { asked, error })?;
        match self.first_without(done) {
            None => Ok(()),
            Some(axis) => Err(Fault::Unfit(format!(
                "axis {axis} is not referenced: reference it with the maker's program (FRF {axis} moves the \
                 stage to its reference), with nothing in its way; trifacet then continues automatically"
            ))),
        }
    }

    async fn check_unit(&mut self) -> Result<(), Fault> {
        let Some((asked, answer)) = self.ask_if_known(GcsQuery::Unit).await? else { return Ok(()) };
        let units = answer.words(&self.settings.axes).map_err(|error| Fault::Answer { asked, error })?;
        for (axis, name) in self.settings.axes.iter().zip(&units) {
            unit::check(axis, name, self.settings.unit * 1e6)?;
        }
        Ok(())
    }

    /// Checks that the stage can reach all positions within the limits.
    ///
    /// # Errors
    /// The travel of an axis is smaller than the limits.
    pub fn check_travel(&self, steering: &SteeringConfig) -> Result<(), Fault> {
        let limit_um = steering.limit_um;
        for (axis, [low, high]) in self.settings.axes.iter().zip(self.travel) {
            let [low_um, high_um] = [low, high].map(rounded_um);
            if !(low_um <= -limit_um && limit_um <= high_um) {
                return Err(Fault::Unfit(format!(
                    "axis {axis} travels from {low_um} to {high_um} um, relative to steering.gcs.zero_um: \
                     plus and minus steering.limit_um, {limit_um}, must lie within"
                )));
            }
        }
        Ok(())
    }

    /// Warns if the stage is slower than the commands. It then lags behind them, which is not a fault.
    async fn check_velocity(&mut self, steering: &SteeringConfig) -> Result<(), Fault> {
        let Some((asked, answer)) = self.ask_if_known(GcsQuery::Velocity).await? else { return Ok(()) };
        let axes = &self.settings.axes;
        let velocity = answer.numbers(axes).map_err(|error| Fault::Answer { asked, error })?;
        for (axis, velocity) in axes.iter().zip(velocity) {
            let mm_per_s = velocity * self.settings.unit * 1e3;
            if mm_per_s < steering.slew_mm_per_s {
                tracing::warn!(
                    %axis, mm_per_s, slew_mm_per_s = steering.slew_mm_per_s,
                    "the axis is slower than steering.slew_mm_per_s: the stage will lag behind its commands"
                );
            }
        }
        Ok(())
    }

    /// The position of the stage, metres.
    ///
    /// # Errors
    /// The query fails, or the position is outside the travel: then the unit is wrong, or another stage
    /// answers.
    pub async fn position(&mut self) -> Result<StagePosition, Fault> {
        let position = self.settings.position(self.numbers(GcsQuery::Position).await?);
        for ((axis, at), [low, high]) in self.settings.axes.iter().zip(position).zip(self.travel) {
            let slack = BEYOND * (high - low);
            if !(low - slack..=high + slack).contains(&at) {
                let [at, low, high] = [at, low, high].map(rounded_um);
                return Err(Fault::Unfit(format!(
                    "axis {axis} reports the position {at} um, outside its travel from {low} to {high} um"
                )));
            }
        }
        Ok(position)
    }

    /// Whether the position is within the travel.
    pub fn reaches(&self, position: StagePosition) -> bool {
        self.travel.iter().zip(position).all(|([low, high], at)| (*low..=*high).contains(&at))
    }

    /// Sends the stage to a position; returns the command and the error code of the controller. `None`,
    /// without sending anything, if the position is not finite.
    ///
    /// # Errors
    /// The query for the error code fails.
    pub async fn go(&mut self, position: StagePosition) -> Result<Option<(String, i32)>, Fault> {
        let line = move_to(&self.settings.axes, self.settings.counted(position));
        let Some(line) = line else { return Ok(None) };
        Ok(Some((label(&line), self.command(&line).await?)))
    }

    fn first_without(&self, flags: [bool; 2]) -> Option<&'a String> {
        self.settings.axes.iter().zip(flags).find(|(_, flag)| !flag).map(|(axis, _)| axis)
    }

    async fn numbers(&mut self, question: GcsQuery) -> Result<[f64; 2], Fault> {
        let (asked, answer) = self.ask(question).await?;
        answer.numbers(&self.settings.axes).map_err(|error| Fault::Answer { asked, error })
    }

    async fn ask(&mut self, question: GcsQuery) -> Result<(String, Answer), Fault> {
        let line = question.line(&self.settings.axes);
        Ok((label(&line), self.link.ask(&line).await?))
    }

    /// Sends a query that not every controller knows; those that do not stay silent and have an error
    /// afterwards.
    async fn ask_if_known(&mut self, question: GcsQuery) -> Result<Option<(String, Answer)>, Fault> {
        match self.ask(question).await {
            Err(silent @ Fault::Silent { so_far: None, .. }) => match self.error().await? {
                UNKNOWN_COMMAND | NOT_FOR_THIS_STAGE => Ok(None),
                FINE => Err(silent),
                code => Err(Fault::Refused { asked: label(&question.line(&self.settings.axes)), code }),
            },
            other => other.map(Some),
        }
    }

    /// Code of the last error; the query clears it.
    async fn error(&mut self) -> Result<i32, Fault> {
        self.command(&GcsQuery::Error.line(&self.settings.axes)).await
    }

    /// Sends lines that end with the query for the error code.
    async fn command(&mut self, lines: &str) -> Result<i32, Fault> {
        let answer = self.link.ask(lines).await?;
        answer.code().map_err(|error| Fault::Answer { asked: label(lines), error })
    }
}

/// Micrometres, rounded to remove the error of the conversion.
pub fn rounded_um(metres: f64) -> f64 {
    (metres * 1e12).round() * 1e-6
}
