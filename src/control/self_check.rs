//! `self-check`: moves the beam over a small pattern and tests whether the pose depends on it.

use std::time::Duration;

use serde_json::{Value, json};
use tokio::sync::Mutex;
use tokio::time::{Instant, sleep, sleep_until};
use trifacet_core::centering::LoopMode;
use trifacet_core::self_check::{NAMES, Point, SelfCheck};
use trifacet_core::steering::{BeamOffset, StagePosition};
use trifacet_core::time::Clock;
use trifacet_wire::LockState;

use super::live::{FAST_SIDE_TIMEOUT, ask, execute};
use super::{Command, RunningConfig};
use crate::centering::CenteringRequest;
use crate::clock::SystemClock;
use crate::clock::utc::read_clocks;
use crate::doubts::Subject;
use crate::estimation::{EstimationRequest, ReportMean};
use crate::exit::{self, Failure};
use crate::publishing::columns::rfc3339;

/// The pattern about the setpoint, metres.
const PATTERN: [[f64; 2]; 4] = [[20e-6, 0.0], [-20e-6, 0.0], [0.0, 20e-6], [0.0, -20e-6]];
/// Repetitions of the pattern.
const ROUNDS: usize = 4;
/// Time of one mean, seconds; at least [`LEAST`] reports.
const MEAN_S: f64 = 0.2;
/// Reports in a mean, at least.
const LEAST: u32 = 20;
/// Attempts at a point, if the loop does not stay locked.
const ATTEMPTS: u32 = 3;
/// A point is reached after this many loop delays and times of the lock.
const SETTLED: f64 = 5.0;
/// What a dependence can mean.
const MEANING: &str = "tx to yaw: the powers or spots are wrong (dark offsets, gains, ambient light, dirt), or \
                       head.beam_diameter_mm; offset: steering.matrix, channels.readback_um_per_v or \
                       head.beam_diameter_mm";

/// Runs the check every `centering.self_check_s`, until the daemon ends.
///
/// A finding is a doubt. If there is no result, the log has one line, and the next attempt comes at the usual time.
pub async fn run_periodically(live: &Mutex<RunningConfig>) {
    let mut config = live.lock().await.config_in_force.subscribe();
    let (mut last, mut failing) = (Instant::now(), false);
    loop {
        let every = config.borrow_and_update().centering.self_check_s;
        let due = async {
            if every > 0.0 {
                sleep_until(last + Duration::from_secs_f64(every)).await;
            } else {
                std::future::pending::<()>().await;
            }
        };
        tokio::select! {
            changed = config.changed() => if changed.is_err() { return },
            () = due => {
                let result = Box::pin(execute(live, Command::SelfCheck)).await;
                last = Instant::now();
                let fails = result.err().filter(|failure| failure.code != exit::DATA);
                match (&fails, failing) {
                    (Some(failure), false) => tracing::warn!("periodic self-check: {}", failure.message),
                    (None, true) => tracing::info!("periodic self-check: it has a result again"),
                    _ => {}
                }
                failing = fails.is_some();
            }
        }
    }
}

impl RunningConfig {
    /// Runs the check. The setpoint is that of before in every case.
    ///
    /// # Errors
    /// [`exit::UNAVAILABLE`]: it is not possible; [`exit::IN_USE`]: the mirror or the loop was not at rest, a later
    /// attempt may succeed; [`exit::DATA`]: something was found.
    pub(super) async fn self_check(&mut self) -> Result<Value, Failure> {
        self.can_be_checked().await?;
        let points = self.points().await;
        self.go_to([0.0; 2]).await.map_err(|failure| {
            let why = format!("the setpoint was not returned: {}; use `ctl setpoint`", failure.message);
            Failure::new(failure.code, why)
        })?;
        let check =
            SelfCheck::new(&points?).ok_or_else(|| restless("the beam did not follow the pattern"))?;
        let (_, utc_ns) = read_clocks();
        let verdict = verdict(&check, &rfc3339(utc_ns));
        self.last_self_check = Some(verdict.clone());
        let text = verdict["text"].as_str().unwrap_or_default().to_owned();
        match verdict["verdict"].as_str() {
            Some("ok") => {
                self.doubter.end(Subject::SelfCheck);
                Ok(json!({ "self_check": verdict }))
            }
            Some("found") => {
                self.doubter.begin(Subject::SelfCheck, SystemClock.now(), text.clone());
                Err(Failure::new(exit::DATA, text))
            }
            _ => Err(restless(&text)),
        }
    }

    /// Whether the loop is locked, with a readback, and the pattern is within the limits.
    async fn can_be_checked(&self) -> Result<(), Failure> {
        let not = |why: &str| Failure::new(exit::UNAVAILABLE, format!("no self-check: {why}"));
        let view = ask(&self.fast.orders, FAST_SIDE_TIMEOUT, CenteringRequest::View).await?;
        if view.mode != LoopMode::On || view.lock != LockState::Locked {
            return Err(not("the loop is not locked"));
        }
        let last = ask(&self.fast.questions, FAST_SIDE_TIMEOUT, EstimationRequest::Last).await?;
        if last.is_none_or(|report| report.steering_residual.is_none()) {
            return Err(not("no readback of the stage, or no beam offset (model \"ray\"), or no valid pose"));
        }
        let params = self.running.loop_params();
        let commanded = view.commanded.ok_or_else(|| not("the position of the stage is not known"))?;
        let within = |step: &[f64; 2]| {
            let step = params.map.stage_step(BeamOffset(*step));
            (0..2).all(|axis| (commanded[axis] + 2.0 * step[axis]).abs() <= params.controller.limit)
        };
        if PATTERN.iter().all(within) { Ok(()) } else { Err(not("the stage is too near to its limit")) }
    }

    async fn points(&self) -> Result<Vec<Point>, Failure> {
        let mut points = Vec::new();
        for step in PATTERN.iter().cycle().take(ROUNDS * PATTERN.len()) {
            self.go_to(*step).await?;
            let mut attempts = 0;
            points.push(loop {
                attempts += 1;
                match self.point().await {
                    Err(failure) if failure.code == exit::IN_USE && attempts < ATTEMPTS => {}
                    result => break result?,
                }
            });
        }
        Ok(points)
    }

    /// The mean at the present setpoint, once the beam is there.
    async fn point(&self) -> Result<Point, Failure> {
        let params = self.running.loop_params();
        let settle = SETTLED * params.loop_delay_s.max(params.lag_s) + 2.0 * params.limits.lock_s;
        sleep(Duration::from_secs_f64(settle)).await;
        let rate_hz = self.running.acquisition.rate_hz / f64::from(self.running.estimation.average);
        let count = ((MEAN_S * rate_hz).ceil() as u32).max(LEAST);
        let patience = FAST_SIDE_TIMEOUT + Duration::from_secs_f64(2.0 * f64::from(count) / rate_hz);
        let request = |reply| EstimationRequest::Mean(count, reply);
        let mean = ask(&self.fast.questions, patience, request).await?;
        let ReportMean { pose, offset, readback, locked } =
            mean.map_err(|status| restless(&status.names().collect::<Vec<_>>().join(", ")))?;
        let (Some(offset), Some(readback), true) = (offset, readback, locked) else {
            return Err(restless("the loop did not stay locked"));
        };
        let [tx, ty, tz, roll, pitch, yaw] = pose.to_array();
        let beam = params.map.beam(StagePosition(readback)).into();
        Ok(Point { beam, values: [tx, ty, tz, roll, pitch, yaw, offset[0], offset[1]] })
    }

    /// Moves the setpoint by this step from the configured one.
    async fn go_to(&self, step: [f64; 2]) -> Result<(), Failure> {
        let mut params = self.running.loop_params();
        params.setpoint = BeamOffset([0, 1].map(|axis| params.setpoint[axis] + step[axis]));
        let tuning = Box::new(params);
        ask(&self.fast.orders, FAST_SIDE_TIMEOUT, |done| CenteringRequest::Retune(tuning, done)).await
    }
}

fn restless(why: &str) -> Failure {
    Failure::new(exit::IN_USE, format!("the self-check has no result: {why}"))
}

/// The result as `ctl status` shows it.
fn verdict(check: &SelfCheck, at: &str) -> Value {
    let say = |i: usize| {
        let ((name, unit), d) = (NAMES[i], &check.dependences[i]);
        let [x, y] = [0, 1].map(|axis| format!("{:+.3} +- {:.3}", d.excess[axis], d.sigma[axis]));
        format!("{name} {x} and {y} {unit}")
    };
    let found: Vec<String> = check.found().map(say).collect();
    let (word, text) = if !check.conclusive() {
        ("unclear", "the mirror was not at rest, or the noise is too large".to_owned())
    } else if found.is_empty() {
        (
            "ok",
            "the pose does not depend on the beam position, and the offset follows the readback".to_owned(),
        )
    } else {
        ("found", format!("with the beam along x and y changes: {}. {MEANING}", found.join("; ")))
    };
    let each = NAMES
        .iter()
        .zip(&check.dependences)
        .map(|((name, unit), d)| json!({ "of": name, "unit": unit, "excess": d.excess, "sigma": d.sigma }));
    json!({ "at": at, "verdict": word, "text": text, "dependences": each.collect::<Vec<_>>() })
}
