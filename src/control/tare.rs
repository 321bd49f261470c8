//! `tare`: the pose that reads zero.

use std::path::Path;
use std::time::Duration;

use serde_json::{Value, json};
use trifacet_optics::Pose;

use super::RunningConfig;
use super::config_file::Access;
use super::live::{FAST_SIDE_TIMEOUT, ask};
use crate::config::edit::{self, Edit};
use crate::config::{FramesConfig, TransformConfig};
use crate::estimation::EstimationRequest;
use crate::exit::{self, Failure};

/// Time over which a tare averages, seconds: default and maximum.
const TARE_S: [f64; 2] = [0.1, 10.0];

impl RunningConfig {
    /// Makes the mean of the next poses read zero. `save_to`: the file to which the tare is written.
    ///
    /// # Errors
    /// Fails if a pose is not valid, or if the tare cannot be written or put in force.
    pub(super) async fn tare(
        &mut self,
        poses: Option<u32>,
        save_to: Option<Access>,
    ) -> Result<Value, Failure> {
        let rate_hz = self.running.acquisition.rate_hz / f64::from(self.running.estimation.average);
        let [usual, most] = TARE_S.map(|seconds| ((seconds * rate_hz).ceil() as u32).max(1));
        let poses = poses.unwrap_or(usual);
        if poses > most {
            let why = format!("poses={poses}: allowed is 1 to {most}, {} s at {rate_hz} Hz", TARE_S[1]);
            return Err(Failure::new(exit::USAGE, why));
        }
        // Before the measurement, so that it is not in vain.
        let save_to = match save_to {
            Some(file) => Some(file.run(check).await?.1),
            None => None,
        };
        let mean = self.mean(poses, rate_hz).await?;
        let untared = FramesConfig { tare: TransformConfig::default(), ..self.running.frames };
        let pose = untared.build().pose(&mean).ok_or_else(|| {
            no_tare("the pitch is within a degree of 90 degrees: turn [frames.base] or [frames.tool]")
        })?;
        let mut answer = self.set_tare(TransformConfig::of(&pose), save_to).await?;
        answer["poses"] = poses.into();
        Ok(answer)
    }

    async fn mean(&self, poses: u32, rate_hz: f64) -> Result<Pose, Failure> {
        let patience = FAST_SIDE_TIMEOUT + Duration::from_secs_f64(2.0 * f64::from(poses) / rate_hz);
        let mean = ask(&self.fast.questions, patience, |reply| EstimationRequest::Mean(poses, reply)).await?;
        mean.map(|mean| mean.pose).map_err(|status| {
            no_tare(format!("no valid pose: {}", status.names().collect::<Vec<_>>().join(", ")))
        })
    }

    /// Sets the tare, after it was written to a file.
    ///
    /// # Errors
    /// Fails if the tare cannot be written or put in force.
    pub(super) async fn set_tare(
        &mut self,
        tare: TransformConfig,
        save_to: Option<Access>,
    ) -> Result<Value, Failure> {
        let mut next = self.running.clone();
        next.frames.tare = tare;
        next.verify().map_err(|wrong| Failure::new(exit::DATA, wrong.to_string()))?;
        let saved = save_to.is_some();
        if let Some(file) = save_to {
            file.run(move |file| write(file, tare)).await.map_err(|e| {
                let why = format!("tare unchanged: {}", e.message);
                Failure::new(e.code, why)
            })?;
            self.taken.frames.tare = tare;
        }
        self.go_on_with(next, None, None).await?;
        Ok(json!({ "tare": self.running.frames.tare, "saved": saved, "config": self.id() }))
    }
}

fn no_tare(why: impl std::fmt::Display) -> Failure {
    Failure::new(exit::DATA, format!("tare unchanged: {why}"))
}

fn check(file: &Path) -> Result<(), Failure> {
    edit::check(file).map_err(|e| {
        Failure::new(exit::IO, format!("tare unchanged: cannot write it to {}: {e:#}", file.display()))
    })
}

fn write(file: &Path, tare: TransformConfig) -> Result<(), Failure> {
    let edit = |key, values: [f64; 3]| Edit {
        section: &["frames", "tare"],
        key,
        value: values.into_iter().collect(),
    };
    let edits = [edit("translation_mm", tare.translation_mm), edit("rotation_deg", tare.rotation_deg)];
    edit::write(file, &edits)
        .map_err(|e| Failure::new(exit::IO, format!("cannot write it to {}: {e:#}", file.display())))
}
