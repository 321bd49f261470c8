//! The calibration in force, and its end while the daemon runs.

use std::time::Duration;

use jiff::Timestamp;
use tokio::sync::Mutex;
use tokio::time::{MissedTickBehavior, interval};

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
