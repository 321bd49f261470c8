//! `reload`: takes over changes of the configuration file.

use std::fmt::Display;
use std::path::Path;

use jiff::Timestamp;
use serde_json::{Value, json};
use tokio::sync::Mutex;

use super::RunningConfig;
use super::config_file::Access;
use super::live::ChannelMap;
use crate::config::CalibrationState;
use crate::config::reload::{Reload, reload};
use crate::config::{self, CalibrationContext, SteeringConfig};
use crate::exit::{self, Failure};

/// Reads the file again, and takes over the changes that do not need a restart. The daemon executes other
/// commands while it reads.
///
/// # Errors
/// Fails if the file cannot be read or is not valid, or if the changes cannot be put in force.
pub(super) async fn take_over_file(live: &Mutex<RunningConfig>, file: Access) -> Result<Value, Failure> {
    // The access is kept to the end, so that no other command writes the file in the meantime.
    let (context, _file) = file.run(read).await.map_err(|e| unchanged(e.code, &e))?;
    live.lock().await.take_over(&context).await
}

/// Reads the configuration and its correction tables. Blocks.
fn read(file: &Path) -> Result<Box<CalibrationContext>, Failure> {
    let wrong = |e: &dyn Display| Failure::new(exit::CONFIG, e.to_string());
    let config = config::load_again(file).map_err(|e| wrong(&e))?;
    CalibrationContext::read(config).map(Box::new).map_err(|e| wrong(&e))
}

/// A large origin that `tune --accept-origin` wrote may hide a displaced PSD: said at the start and at each reload.
pub fn warn_of_unverified_origin(steering: &SteeringConfig) {
    if !steering.origin_verified {
        let origin_um = steering.origin_um;
        tracing::warn!(?origin_um, "steering.origin_um is not verified: it may hide a displaced PSD");
    }
}

fn unchanged(code: u8, why: &dyn Display) -> Failure {
    Failure::new(code, format!("configuration unchanged: {why}"))
}

impl RunningConfig {
    async fn take_over(&mut self, file: &CalibrationContext) -> Result<Value, Failure> {
        let (plan, channels, calibration) = self.plan(file).map_err(|e| unchanged(exit::CONFIG, &e))?;
        let Reload { running, taken, changed, refused } = *plan;
        self.go_on_with(running, channels, calibration).await?;
        self.taken = taken;
        warn_of_unverified_origin(&self.running.steering);
        let mut answer = json!({ "changed": changed, "refused": refused, "config": self.id() });
        if !refused.is_empty() {
            answer["error"] = format!("these changes need a restart: {}", refused.join(", ")).into();
            answer["code"] = exit::DATA.into();
        }
        Ok(answer)
    }

    /// What changes with this file, with the new channel map and the new calibration if they change.
    fn plan(
        &self,
        file: &CalibrationContext,
    ) -> anyhow::Result<(Box<Reload>, Option<ChannelMap>, Option<CalibrationState>)> {
        let CalibrationContext { config, tables, calibration } = file;
        let mut plan = Box::new(reload(&self.running, &self.taken, config)?);
        let map = plan.running.channels != self.running.channels;
        // The contents of a correction table may have changed.
        let contents = *tables != self.tables;
        if contents && !map {
            plan.changed.push("channels (the contents of a correction table)".into());
        }
        let before = &self.facts.calibration;
        let record = calibration.record != before.record;
        if record && plan.running.calibration == self.running.calibration {
            plan.changed.push("calibration (the contents of the record)".into());
        }
        let channels = plan.running.channels(tables)?;
        // The record may belong to the file, but not to what of it can take effect.
        let record = calibration.record.clone();
        let calibration = CalibrationState::of(&plan.running, &channels, record, Timestamp::now());
        let calibration = (calibration != *before).then_some(calibration);
        Ok((plan, (map || contents).then(|| (channels, tables.clone())), calibration))
    }
}
