//! The share of the calibration in the uncertainty of a pose: what the fit of the head left unknown.

use nalgebra::Matrix6;
use trifacet::calibration::Record;
use trifacet::config::{CalibrationContext, Config};
use trifacet::exit::{self, Failure};
use trifacet_optics::Rigid;
use trifacet_optics::calibration::result::{Calibration, Raw};

use super::SolveArgs;

/// Frames that differ by less count as the same: metres, and radians. The share changes by a millionth part.
const SAME: f64 = 1e-6;

/// Computes the covariances of poses, relative to the tare row, by the calibration.
pub(super) struct CalibrationShare {
    calibration: Calibration,
    tare: Option<Raw>,
}

impl CalibrationShare {
    /// The share for these options, or why it is not known. Blocks.
    ///
    /// # Errors
    /// Fails if the record cannot be read.
    pub(super) fn open(
        context: &CalibrationContext,
        args: &SolveArgs,
    ) -> anyhow::Result<Result<Self, String>> {
        let config = &context.config;
        let Some(path) = &config.calibration.record else {
            return Ok(Err("the configuration names no calibration record (calibration.record)".into()));
        };
        if config.pivot_mm().is_some() {
            return Ok(Err(
                "the calibration is that of a translated beam, and steering.kind is \"tilt\"".into()
            ));
        }
        if let Some(why) = context.calibration.objection() {
            return Ok(Err(why));
        }
        if !(args.readings && args.frames && args.tare_row.is_some()) {
            return Ok(Err("they need --readings, --frames and --tare-row".into()));
        }
        let refuse = |why: String| Failure::new(exit::CONFIG, format!("{}: {why}", path.display()));
        let record = Record::open(path).map_err(|e| refuse(e.to_string()))?;
        let calibration = record.calibration().map_err(|e| refuse(e.to_string()))?;
        if !same_frames(&calibration, config) {
            return Ok(Err("frames.base and frames.tool are not those of the calibration".into()));
        }
        Ok(Ok(Self { calibration, tare: None }))
    }

    /// Sets the readings of the tare row.
    pub(super) fn set_tare(&mut self, tare: Raw) {
        self.tare = Some(tare);
    }

    /// Covariances for readings; `None` where the calibration has no pose for them.
    pub(super) fn of(&self, readings: &[Raw]) -> Vec<Option<Matrix6<f64>>> {
        let all = self.tare.and_then(|tare| self.calibration.relative_covariances(readings, &tare));
        all.unwrap_or_else(|| vec![None; readings.len()])
    }
}

/// Whether the user's frames are those for which the calibration states covariances.
fn same_frames(calibration: &Calibration, config: &Config) -> bool {
    let near = |a: &Rigid, b: &Rigid| {
        (a.rotation - b.rotation).abs().max() < SAME && (a.translation - b.translation).abs().max() < SAME
    };
    let [base, tool] = calibration.base_and_tool();
    near(&base, &config.frames.base.build()) && near(&tool, &config.frames.tool.build())
}
