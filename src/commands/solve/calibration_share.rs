//! The share of the calibration in the uncertainty of a pose relative to the tare row.

use std::fs::File;
use std::io::BufReader;

use nalgebra::Matrix6;
use trifacet::calibration::{Record, fingerprint};
use trifacet::config::Config;
use trifacet_optics::Rigid;
use trifacet_optics::calibration::result::{Calibration, Raw};

use super::SolveArgs;

/// Columns of the standard uncertainties by the calibration.
pub(super) const CAL_STD: [&str; 6] = [
    "cal_std_tx_m",
    "cal_std_ty_m",
    "cal_std_tz_m",
    "cal_std_roll_rad",
    "cal_std_pitch_rad",
    "cal_std_yaw_rad",
];

/// What the calibration leaves unknown.
pub(super) struct CalibrationShare {
    calibration: Calibration,
    /// The frame whose pose is asked for, in the frame of the calibration's reference table.
    tool: Rigid,
    tare: Option<Raw>,
}

impl CalibrationShare {
    /// Reads the record of a configuration. Blocks.
    ///
    /// # Errors
    /// Why the share is not known.
    pub(super) fn new(config: &Config, args: &SolveArgs) -> Result<Self, String> {
        let Some(path) = &config.calibration.record else {
            return Err("without a calibration record the share of the calibration is not known".into());
        };
        if !args.readings || args.tare_row.is_none() {
            return Err(
                "the share of the calibration is that of a difference of two readings: give --readings and \
                        --tare-row"
                    .into(),
            );
        }
        let wrong = |what: &dyn std::fmt::Display| format!("{}: {what}", path.display());
        let file = File::open(path).map_err(|e| wrong(&e))?;
        let record = Record::read(BufReader::new(file)).map_err(|e| wrong(&e))?;
        let channels = config.read_channels().map_err(|e| wrong(&e))?;
        if record.header.fits != fingerprint(config, &channels) {
            return Err(wrong(&"the record belongs to another configuration"));
        }
        let calibration = record.calibration().map_err(|e| wrong(&e))?;
        let tool = if args.frames { config.frames.tool.build() } else { Rigid::identity() };
        Ok(Self { tool: calibration.tool_on_table(&tool), calibration, tare: None })
    }

    /// Takes the tare row: the numbers of its columns, which begin with spots and powers.
    pub(super) fn set_tare(&mut self, numbers: &[f64]) {
        self.tare = raw(numbers);
    }

    /// Covariance of the pose of a row relative to the tare row; NaN if it is not known.
    pub(super) fn covariance(&self, numbers: &[f64]) -> Matrix6<f64> {
        let known = || {
            let (reading, tare) = (raw(numbers)?, self.tare.as_ref()?);
            self.calibration.relative_covariances(&[reading], tare, &self.tool)?.pop()?
        };
        known().unwrap_or_else(|| Matrix6::from_element(f64::NAN))
    }
}

fn raw(numbers: &[f64]) -> Option<Raw> {
    let [a, b, c, d, e, f, powers @ ..] = numbers else { return None };
    let powers = powers.first_chunk::<3>()?;
    Some(Raw { spots: [*a, *b, *c, *d, *e, *f], powers: *powers })
}
