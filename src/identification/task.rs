//! The task: takes the place of centering, receives samples, makes the steps, and returns the stage.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::mpsc;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;
use trifacet_core::signals::Identity;
use trifacet_core::steering::{Command, StagePosition};
use trifacet_core::time::Clock;
use trifacet_wire::actuator::Ack;

use super::gaps::{self, Gaps};
use super::observation::{self, Observation, Observer};
use super::plan::{Plan, Settings, refused, um};
use super::probe::Probe;
use super::record::{Recording, Step};
use crate::acquisition::SourceError;
use crate::acquisition::task::SampleEvent;
use crate::exit::{self, Failure};
use crate::steering::{Driver, StageEvent};

/// Longest wait for the first sample.
const FIRST_SAMPLE_TIMEOUT: Duration = Duration::from_secs(5);
/// Longest wait for each further sample, plus five periods.
const SILENCE: Duration = Duration::from_millis(500);
/// Longest wait for the stage, in multiples of the time at rest.
const STAGE: usize = 5;
/// Longest wait for the acknowledgement of the last command.
const LAST_ACK: Duration = Duration::from_secs(1);
/// A step is made on a sample that is older than the median age by at most this fraction of a period.
const FRESH: f64 = 0.25;
/// Multiple of a dwell time without a fresh sample after which the machine counts as too slow.
const BEHIND: usize = 20;

/// Connections of the task.
#[derive(Debug)]
pub struct IdentificationLinks {
    /// Samples in order, from acquisition.
    pub samples: mpsc::Receiver<SampleEvent>,
    /// Ends the measurement. The stage is returned all the same.
    pub stop: CancellationToken,
}

/// Receives the progress of the measurement.
pub trait Audience {
    /// The plan, before anything moves. Returns `false` to end without moving.
    fn plan(&mut self, plan: &Plan, source: &Identity) -> bool;

    /// Steps made so far. Called where a delay has no effect.
    fn progress(&mut self, made: u32, of: u32);

    /// The stage was returned to this position. `complaint` is the reason if it has not acknowledged this.
    fn back(&mut self, position: StagePosition, complaint: Option<&str>);
}

/// Measures. Returns `None` if `audience` declines the plan.
///
/// # Errors
/// The measurement is unsafe or not possible ([`exit::DATA`]), source or stage fail ([`exit::UNAVAILABLE`]),
/// `stop` is cancelled ([`exit::INTERRUPTED`]), or acquisition ends ([`exit::SOFTWARE`]). If anything was
/// moved, the stage is returned first.
pub async fn run<D: Driver, C: Clock>(
    settings: Settings,
    observer: Observer,
    driver: D,
    clock: C,
    links: IdentificationLinks,
    audience: &mut dyn Audience,
) -> Result<Option<Recording>, Failure> {
    let IdentificationLinks { samples, stop } = links;
    let mut tuner = Tuner {
        settings,
        observer,
        driver,
        clock,
        samples,
        stop,
        source: None,
        ready: false,
        unready: "no message from the stage".into(),
        said: None,
        commanded: None,
        commands: 0,
        looks: Vec::new(),
        rested: 0,
        ages: Vec::new(),
        fresh: f64::INFINITY,
        gaps: Gaps::default(),
    };
    let plan = tuner.rest().await?;
    let Some(source) = tuner.source.clone() else { return Err(refused("the source is gone")) };
    if !audience.plan(&plan, &source) {
        return Ok(None);
    }
    tuner.rested = tuner.looks.len();
    let steps = tuner.steps(&plan, audience).await;
    let complaint = tuner.finish(plan.end).await;
    audience.back(plan.end, complaint.as_deref());
    let repeats = tuner.gaps.repeats();
    Ok(Some(Recording { plan, rest: tuner.rested, steps: steps?, looks: tuner.looks, repeats }))
}

/// State of the measurement.
struct Tuner<D, C> {
    settings: Settings,
    observer: Observer,
    driver: D,
    clock: C,
    samples: mpsc::Receiver<SampleEvent>,
    stop: CancellationToken,
    source: Option<Arc<Identity>>,
    /// The stage accepts commands.
    ready: bool,
    /// Why the stage does not accept commands, if known.
    unready: String,
    /// Last position that the stage reported.
    said: Option<StagePosition>,
    commanded: Option<StagePosition>,
    commands: u32,
    looks: Vec<Observation>,
    /// Number of observations before the first movement.
    rested: usize,
    /// Ages of the samples at their evaluation, before the first movement; seconds.
    ages: Vec<f64>,
    /// Largest age of a sample on which a step is made, seconds.
    fresh: f64,
    gaps: Gaps,
}

impl<D: Driver, C: Clock> Tuner<D, C> {
    /// Observes at rest, and makes the plan.
    async fn rest(&mut self) -> Result<Plan, Failure> {
        while self.looks.len() < self.settings.rest || !self.ready {
            let look = self.next().await?;
            self.ages.push(self.clock.now().seconds_since(look.time));
            if self.looks.len() > STAGE * self.settings.rest {
                return Err(unavailable(format!("the stage does not take commands: {}", self.unready)));
            }
        }
        self.ages.sort_by(f64::total_cmp);
        self.fresh = self.ages[self.ages.len() / 2] + FRESH * self.settings.period;
        let rest = &self.looks[self.looks.len() - self.settings.rest..];
        self.settings.plan(rest, self.said)
    }

    /// Makes all steps of both axes. Any failure ends the measurement at once.
    async fn steps(&mut self, plan: &Plan, audience: &mut dyn Audience) -> Result<Vec<Step>, Failure> {
        self.take_over(plan).await?;
        for axis in 0..2 {
            self.probe(axis, plan).await?;
        }
        let mut steps = Vec::new();
        for axis in 0..2 {
            self.rest_at(plan.end_of_step(axis, false), plan).await?;
            for k in 0..plan.steps {
                let made = steps.len() as u32 + 1;
                let step =
                    self.step(axis, k % 2 == 0, plan, || audience.progress(made, 2 * plan.steps)).await?;
                steps.push(step);
            }
            self.rest_at(plan.found, plan).await?;
        }
        Ok(steps)
    }

    /// Makes one step and observes it. If samples stop meanwhile, the stage returns and the step is repeated.
    async fn step(
        &mut self,
        axis: usize,
        forth: bool,
        plan: &Plan,
        mut progress: impl FnMut(),
    ) -> Result<Step, Failure> {
        let (from, to) = (plan.end_of_step(axis, !forth), plan.end_of_step(axis, forth));
        let mut attempts = 0;
        loop {
            let gaps = self.gaps.count();
            let computed = self.go(to, plan).await?;
            let step = Step { axis, forth, to, on: self.looks.len() - 1, computed };
            self.dwell(plan.dwell / 2, plan).await?;
            progress();
            self.dwell(plan.dwell - plan.dwell / 2, plan).await?;
            if self.gaps.count() == gaps {
                return Ok(step);
            }
            attempts += 1;
            self.gaps.repeat(attempts)?;
            self.rest_at(from, plan).await?;
        }
    }

    /// Sends the stage to a position and waits for a dwell time.
    async fn rest_at(&mut self, to: StagePosition, plan: &Plan) -> Result<(), Failure> {
        self.go(to, plan).await?;
        self.dwell(plan.dwell, plan).await
    }

    /// Sends the first command: the present position. If the beam moves, the position is wrong.
    async fn take_over(&mut self, plan: &Plan) -> Result<(), Failure> {
        let beam = |looks: &[Observation]| {
            observation::mean(looks.iter().rev().take(plan.dwell / 2).map(|l| l.beam))
        };
        let before = beam(&self.looks);
        self.go(plan.found, plan).await?;
        self.dwell(plan.dwell, plan).await?;
        let Some((before, after)) = before.zip(beam(&self.looks)) else { return Ok(()) };
        let moved = (after[0] - before[0]).hypot(after[1] - before[1]);
        if moved > plan.step {
            return Err(refused(format!(
                "the beam moved by {} um when the stage was commanded to its stated position, {} {} um: \
                 channels.readback_um_per_v (or --at) is wrong, or something else moves the beam",
                um(moved),
                um(plan.found[0]),
                um(plan.found[1])
            )));
        }
        Ok(())
    }

    /// Makes one step of an axis and observes it: the movement must end within a dwell time. If samples stop
    /// meanwhile, the step is repeated.
    async fn probe(&mut self, axis: usize, plan: &Plan) -> Result<(), Failure> {
        let mut attempts = 0;
        let (before, on) = loop {
            let (before, gaps) = (self.looks.len() - plan.dwell, self.gaps.count());
            self.go(plan.end_of_step(axis, false), plan).await?;
            let on = self.looks.len() - 1;
            self.dwell(plan.watch, plan).await?;
            if self.gaps.count() == gaps {
                break (before, on);
            }
            attempts += 1;
            self.gaps.repeat(attempts)?;
            self.rest_at(plan.found, plan).await?;
        };
        let seen = Probe {
            axis,
            sent: plan.step / 2.0,
            zero: self.looks[on].time,
            rest: &self.looks[..self.rested],
            before: &self.looks[before..=on],
            after: &self.looks[on + 1..],
        };
        seen.judge(plan, self.settings.period)?;
        self.go(plan.found, plan).await?;
        self.dwell(2 * plan.dwell, plan).await
    }

    /// Commands a position on the next sample that is no older than [`Tuner::fresh`]. Returns the time from
    /// the sample to the command, seconds.
    async fn go(&mut self, to: StagePosition, plan: &Plan) -> Result<f64, Failure> {
        for _ in 0..BEHIND * plan.dwell {
            let look = self.watch(plan).await?;
            let age = self.clock.now().seconds_since(look.time);
            if self.samples.is_empty() && age <= self.fresh {
                self.send(to);
                return Ok(self.clock.now().seconds_since(look.time));
            }
        }
        Err(refused("this machine is too busy: hardly any sample is evaluated in time"))
    }

    /// Observes this number of samples. Each command renews the lease, as in the loop.
    async fn dwell(&mut self, samples: usize, plan: &Plan) -> Result<(), Failure> {
        for _ in 0..samples {
            self.watch(plan).await?;
            if let Some(position) = self.commanded
                && self.samples.is_empty()
            {
                self.send(position);
            }
        }
        Ok(())
    }

    /// The next observation. Fails if the beam is too far from the apex.
    async fn watch(&mut self, plan: &Plan) -> Result<Observation, Failure> {
        let look = self.next().await?;
        let far = look.offset[0].hypot(look.offset[1]);
        if far > plan.reach {
            return Err(refused(format!(
                "the beam is {} um off the apex, allowed: {} um during the steps",
                um(far),
                um(plan.reach)
            )));
        }
        Ok(look)
    }

    fn send(&mut self, position: StagePosition) {
        let limit = self.settings.limit();
        let position = StagePosition(position.map(|p| p.clamp(-limit, limit)));
        self.commands = self.commands.wrapping_add(1);
        self.commanded = Some(position);
        let Settings { lease_ms, on_expiry, .. } = self.settings;
        self.driver.steer(Command { id: self.commands, position, lease_ms, on_expiry });
    }

    /// The next observation. Handles events of the stage meanwhile.
    async fn next(&mut self) -> Result<Observation, Failure> {
        let mut why = "no data from the source".to_owned();
        let first = self.looks.is_empty();
        let patience = if first {
            FIRST_SAMPLE_TIMEOUT
        } else {
            SILENCE + Duration::from_secs_f64(5.0 * self.settings.period)
        };
        let mut deadline = std::pin::pin!(tokio::time::sleep(patience));
        loop {
            tokio::select! {
                biased;
                () = self.stop.cancelled() => return Err(Failure::new(exit::INTERRUPTED, "interrupted")),
                event = self.driver.next() => self.hear(event)?,
                acquired = self.samples.recv() => match acquired {
                    Some(SampleEvent::Sample(sample, _)) => {
                        let look = self.observer.look(&sample).map_err(|e| refused(e.to_string()))?;
                        if self.commanded.is_some() {
                            gaps::check_lease(self.looks.last(), &look, &self.settings)?;
                        }
                        self.looks.push(look);
                        return Ok(look);
                    }
                    Some(SampleEvent::Up(source)) => self.source = Some(source),
                    Some(SampleEvent::Down(down)) if first => why = down.to_string(),
                    // Samples may resume; otherwise the deadline ends the measurement.
                    Some(SampleEvent::Down(down @ SourceError::Stalled { .. })) => {
                        self.gaps.add();
                        why = format!("the source is down: {down}");
                    }
                    Some(SampleEvent::Down(down)) => return Err(unavailable(format!("the source is down: {down}"))),
                    Some(SampleEvent::Changed(_)) => {}
                    None => return Err(Failure::new(exit::SOFTWARE, "task acquisition ended by itself")),
                },
                () = &mut deadline => return Err(unavailable(why)),
            }
        }
    }

    /// Handles an event of the stage.
    fn hear(&mut self, event: StageEvent) -> Result<(), Failure> {
        match event {
            StageEvent::Up if self.commanded.is_some() => {
                Err(unavailable("the stage restarted: its position is unknown"))
            }
            StageEvent::Up => {
                self.ready = true;
                Ok(())
            }
            StageEvent::At(position) => {
                self.said = Some(position);
                Ok(())
            }
            StageEvent::Ack(Ack { accepted: false, .. }) => Err(refused("the stage refused a command")),
            StageEvent::Ack(_) => Ok(()),
            // Before the first command the stage may still be starting.
            StageEvent::Down(reason) if self.commanded.is_none() => {
                (self.ready, self.unready) = (false, reason);
                Ok(())
            }
            StageEvent::Down(reason) => {
                Err(unavailable(format!("the stage does not take commands: {reason}")))
            }
        }
    }

    /// Sends the last command and waits for its acknowledgement. Returns the reason if it does not arrive.
    async fn finish(&mut self, end: StagePosition) -> Option<String> {
        self.commanded?;
        self.send(end);
        let last = self.commands;
        let answer = async {
            loop {
                match self.driver.next().await {
                    StageEvent::Ack(Ack { id, accepted }) if id == last => return accepted,
                    _ => {}
                }
            }
        };
        // Acquisition transmits commands and answers. Draining its queue of samples keeps it from blocking.
        let samples = &mut self.samples;
        let drain = async { while samples.recv().await.is_some() {} };
        let accepted = tokio::select! {
            accepted = timeout(LAST_ACK, answer) => accepted,
            () = drain => return Some("acquisition ended before the stage answered".into()),
        };
        let complaint = match accepted {
            Ok(true) => return None,
            Ok(false) => "it refused the command",
            Err(_) => "it did not acknowledge this within a second; check its position",
        };
        Some(complaint.into())
    }
}

fn unavailable(why: impl Into<String>) -> Failure {
    Failure::new(exit::UNAVAILABLE, why)
}
