//! The calibration in force, and its end while the daemon runs.

use std::time::Duration;

use jiff::Timestamp;
use serde_json::{Value, json};
use tokio::sync::Mutex;
use tokio::time::{MissedTickBehavior, interval};
use trifacet_core::telemetry::Drift;

use super::RunningConfig;
use crate::config::CalibrationState;
use crate::config::SourceKind;

/// Interval of the checks whether a calibration has expired.
const LOOK: Duration = Duration::from_secs(1);

/// Logs whether the record is valid: at the start, and when this changes. Without a record the frames say all.
pub fn log_calibration(calibration: &CalibrationState, expires_days: Option<f64>) {
    let record = calibration.describe(Timestamp::now(), expires_days);
    match (calibration.objection(), record) {
        (None, Some(record)) => tracing::info!(record, "the head is calibrated"),
        (Some(why), Some(record)) => tracing::warn!(record, "{why}: the frames carry UNCALIBRATED"),
        (_, None) => {}
    }
    if calibration.belongs() && calibration.spread.is_none() {
        tracing::warn!(
            "the calibration record does not contain what frames need: they do not state what the calibration left unknown; \
             calibrate again"
        );
    }
}

/// Puts the end of a calibration in force when its time has come. Never returns.
pub async fn watch_expiry(live: &Mutex<RunningConfig>) {
    let mut looks = interval(LOOK);
    looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        looks.tick().await;
        live.lock().await.renew_calibration(Timestamp::now()).await;
    }
}

impl RunningConfig {
    /// Judges the calibration again. A failure is logged, and tried again with the next look.
    async fn renew_calibration(&mut self, now: Timestamp) {
        if self.running.acquisition.source == SourceKind::Replay {
            return; // the recording states what was in force
        }
        let renewed = self.facts.calibration.at(now, self.running.calibration.expires_days);
        if renewed != self.facts.calibration
            && let Err(failure) = self.go_on_with(self.running.clone(), None, Some(renewed)).await
        {
            tracing::warn!("the end of the calibration is not yet in force: {failure}");
        }
    }
}

/// The drift since the calibration; `null` for what is not known.
pub(super) fn drift(drift: &Drift) -> Value {
    let um = |metres: [f64; 2]| metres.map(|m| m * 1e6);
    let percent = |parts: [f64; 2]| parts.map(|part| part * 1e2);
    json!({
        "residual_um": drift.residual.map(um),
        "limit_um": drift.limit.map(|metres| metres * 1e6),
        "power_gains_percent": drift.power_gains.map(percent),
        "dark_percent": drift.dark.map(|parts| parts.map(|part| part * 1e2)),
    })
}
