//! Builds the parameters of channel map, centering and estimation from the configuration.
//!
//! The units of the file are converted to SI units here.

use std::path::Path;
use std::sync::Arc;

use trifacet_core::centering::controller::Controller;
use trifacet_core::centering::lock::LockLimits;
use trifacet_core::centering::{Centering, LoopParams};
use trifacet_core::channels::{Channels, MissingSignal, PsdChannels};
use trifacet_core::estimation::by_pose::ByPose;
use trifacet_core::estimation::integrity::Readback;
use trifacet_core::estimation::{Estimation, Frames, Settings};
use trifacet_core::pipeline::{Mapping, Measurement, Pipeline};
use trifacet_core::steering::{BeamMap, BeamOffset, BeamPoint, StagePosition};
use trifacet_core::uncertainty::{Instrument, Stated};
use trifacet_optics::{Estimator, FACETS, HeadError, Pose, Rigid, Vec2};
use trifacet_wire::Status;

use super::correction::{CorrectionFileError, parse_correction};
use super::{
    CalibrationContext, CalibrationState, CenteringConfig, Components, Config, FramesConfig, RecordError,
    SteeringConfig, TableError, Tables,
};
use crate::exit::{self, Failure};

/// Why the parameters cannot be built from a configuration.
#[derive(Debug, thiserror::Error)]
pub enum AssemblyError {
    /// The geometry does not describe a sensor head.
    #[error(transparent)]
    Head(#[from] HeadError),
    /// A correction table cannot be read.
    #[error(transparent)]
    Unreadable(#[from] TableError),
    /// A file is not a valid correction table.
    #[error("correction table of PSD {psd}: {source}")]
    Correction {
        /// Name of the PSD: A, B or C.
        psd: char,
        /// The error, with the name of the file.
        source: CorrectionFileError,
    },
    /// The calibration record cannot be read or used.
    #[error("calibration.record: {0}")]
    Record(RecordError),
}

impl From<AssemblyError> for Failure {
    fn from(error: AssemblyError) -> Self {
        Self::new(exit::CONFIG, error.to_string())
    }
}

/// The source does not fit the configuration.
impl From<MissingSignal> for Failure {
    fn from(missing: MissingSignal) -> Self {
        Self::new(exit::CONFIG, missing.to_string())
    }
}

impl Config {
    /// The channels with their correction tables. Blocks: reads the files of the tables.
    ///
    /// # Errors
    /// Fails if a correction table cannot be read or is not valid.
    pub fn read_channels(&self) -> Result<Channels, AssemblyError> {
        self.channels(&Tables::read(self)?)
    }

    /// The channels with correction tables that were read before.
    ///
    /// # Errors
    /// Fails if a correction table is not valid.
    pub fn channels(&self, tables: &Tables) -> Result<Channels, AssemblyError> {
        let [a, b, c] = [0, 1, 2].map(|psd| self.psd_channels(psd, tables));
        Ok(Channels {
            psds: [a?, b?, c?],
            sum_threshold_v: self.channels.sum_threshold_v,
            clip_limit: self.channels.clip_limit,
            watts_per_volt: self.channels.power_mw_per_v * 1e-3,
            readback_per_volt: self.channels.readback_um_per_v * 1e-6,
        })
    }

    fn psd_channels(&self, psd: usize, tables: &Tables) -> Result<PsdChannels, AssemblyError> {
        let half_size = self.head.psd_size_mm * 0.5e-3;
        let channels = self.channels.psds()[psd];
        let name = channels.correction.as_deref().unwrap_or(Path::new("?")).display().to_string();
        let refuse = |source| AssemblyError::Correction { psd: FACETS[psd], source };
        let correction =
            tables.0[psd].as_ref().map(|text| parse_correction(&name, text, half_size).map_err(refuse));
        Ok(PsdChannels {
            amplifier: channels.amplifier,
            full_scale_v: channels.full_scale_v,
            gain: channels.gain,
            dark_v: channels.dark_v,
            half_size,
            correction: correction.transpose()?,
        })
    }

    /// The parameters of the centering loop, in SI units.
    pub fn loop_params(&self) -> LoopParams {
        let Self { steering, centering, .. } = self;
        let rate_hz = self.acquisition.rate_hz;
        let gains = centering.gains(rate_hz);
        LoopParams {
            mode: centering.mode,
            target: centering.target,
            setpoint: BeamOffset(centering.setpoint_um.map(|um| um * 1e-6)),
            map: steering.beam_map(),
            controller: Controller {
                kp: gains.kp,
                ki_per_s: gains.ki_per_s,
                limit: steering.limit_um * 1e-6,
                slew: steering.slew_mm_per_s * 1e-3,
            },
            limits: centering.lock_limits(),
            feed_forward: centering.feed_forward,
            tracking_hz: centering.tracking_hz(rate_hz),
            loop_delay_s: centering.loop_delay_s(rate_hz),
            lag_s: centering.lag_ms * 1e-3,
            period_s: 1.0 / rate_hz,
            park: StagePosition(steering.park_um.map(|um| um * 1e-6)),
            on_exit: steering.on_exit,
            on_lease: steering.on_lease.into(),
            lease_ms: steering.lease_ms,
        }
    }

    /// The centering loop in its initial state.
    ///
    /// # Errors
    /// Fails if the geometry does not describe a sensor head.
    pub fn centering_loop(&self) -> Result<Centering, HeadError> {
        Ok(Centering::new(self.loop_params(), self.optics()?))
    }

    /// Mapping and estimation with these parameters, without a source of samples.
    ///
    /// # Errors
    /// Fails if the geometry does not describe a sensor head, or if a correction table is not valid.
    pub fn measurement(&self, context: &CalibrationContext) -> Result<Measurement, AssemblyError> {
        let channels = self.channels(&context.tables)?;
        let settings = self.estimation_settings(&context.calibration, context.id())?;
        Ok(Measurement { mapping: Mapping::new(channels), estimation: Estimation::new(settings) })
    }

    /// The instrument of which the uncertainty is computed.
    ///
    /// # Errors
    /// Fails if the geometry does not describe a sensor head.
    pub fn instrument(&self) -> Result<Instrument, HeadError> {
        let [base, tare, tool] = [self.frames.base, self.frames.tare, self.frames.tool].map(|t| t.build());
        // pose = tare^-1 * base * sensor * tool is the identity at the tare.
        let tare = self.frames.is_tared().then(|| base.inverse() * tare * tool.inverse());
        Ok(Instrument::new(self.head.build()?, self.estimation.model.into(), tool, tare))
    }

    /// The whole pipeline in its initial state, without a source of samples.
    ///
    /// # Errors
    /// Fails if the geometry does not describe a sensor head, or if a correction table is not valid.
    pub fn pipeline(&self, context: &CalibrationContext) -> Result<Pipeline, AssemblyError> {
        let silence = self.acquisition.silence();
        Ok(Pipeline::new(self.measurement(context)?, self.centering_loop()?, silence))
    }

    /// The systematic uncertainty that depends on the pose, with the frames and the head of `settings`.
    fn by_pose(
        &self,
        settings: &Settings,
        calibration: &CalibrationState,
    ) -> Result<Option<Arc<ByPose>>, HeadError> {
        let spread = calibration.spread.as_ref().map(|spread| Arc::clone(&spread.0));
        if spread.is_none() && !self.uncertainty.states_anything() {
            return Ok(None);
        }
        let (optics, frames) = (settings.estimator.optics(), &settings.frames);
        // A tare may only move the coordinates: the mirror cannot be where poses are zero then.
        let zeros = [Some(frames.zero()), spread.as_ref().map(|spread| spread.zero_pose())];
        let reachable = |zero: &Pose| optics.trace(settings.estimator.model(), zero, Vec2::zeros()).is_ok();
        let zero = zeros.into_iter().flatten().find(reachable).unwrap_or_default();
        let table = spread.as_ref().map(|spread| spread.table());
        let quantities = Components::new(self, 1, table.as_ref()).by_pose(self.frames.is_tared());
        let instrument = Instrument::new(
            self.head.build()?,
            self.estimation.model.into(),
            self.frames.tool.build(),
            Some(Rigid::from(&zero)),
        );
        let stated =
            Stated::new(&instrument.calibrated_at(table.unwrap_or_else(Rigid::identity)), &quantities);
        if stated.is_none() {
            tracing::warn!(
                "frames do not include what [uncertainty] states: no light reaches the PSDs at the tare pose"
            );
        }
        Ok(ByPose::new(spread, stated, optics, &zero).map(Arc::new))
    }

    /// The parameters of estimation, in SI units. `calibration`: that of the configuration. `id`: the fingerprint of the
    /// configuration, see [`Config::id`].
    ///
    /// # Errors
    /// Fails if the geometry does not describe a sensor head.
    pub fn estimation_settings(
        &self,
        calibration: &CalibrationState,
        id: u32,
    ) -> Result<Settings, HeadError> {
        let estimation = &self.estimation;
        let mut fixed = Status::default();
        fixed.set(Status::UNCALIBRATED, !calibration.is_valid());
        let mut settings = Settings {
            estimator: Estimator::new(self.optics()?, estimation.model.into()),
            rate_hz: self.acquisition.rate_hz,
            average: estimation.average,
            spot_noise: estimation.spot_noise_um * 1e-6,
            power_noise: estimation.power_noise,
            systematic: self.systematic(calibration.spread.is_some()),
            by_pose: None,
            amplifiers: self.channels.psds().map(|psd| psd.amplifier),
            readback: Readback::new(self.steering.beam_map(), self.steering.beam_sigma_um() * 1e-6),
            fuse: estimation.fuse_steering,
            edge_margin: estimation.edge_margin_mm * 1e-3,
            balance_limit: estimation.balance_limit,
            fixed,
            frames: self.frames.build(),
            config: id,
        };
        settings.by_pose = self.by_pose(&settings, calibration)?;
        Ok(settings)
    }

    /// Standard uncertainties that averaging does not reduce, the same at every pose: `estimation.systematic_um` and
    /// `systematic_urad`, in SI units. They stand for the errors of the head's geometry. Where a calibration record states
    /// what is unknown of it (`recorded`) they do not count, unless a PSD may have moved since (`steering.origin_verified`).
    pub fn systematic(&self, recorded: bool) -> [f64; 6] {
        if recorded && self.steering.origin_verified { [0.0; 6] } else { self.estimation.systematic() }
    }
}

impl SteeringConfig {
    /// The map from stage position to beam position, metres.
    pub fn beam_map(&self) -> BeamMap {
        BeamMap::new(self.matrix, BeamPoint(self.origin_um.map(|um| um * 1e-6)))
    }
}

impl CenteringConfig {
    fn lock_limits(&self) -> LockLimits {
        LockLimits {
            offset: self.lock_limit_um * 1e-6,
            lock_s: self.lock_time_ms * 1e-3,
            lost_s: self.lost_time_ms * 1e-3,
            search: self.search,
            attempts: self.search_attempts,
        }
    }
}

impl FramesConfig {
    /// The transformation from the sensor's world frame to the user's frame.
    ///
    /// With the default configuration, poses pass unchanged, bit by bit.
    pub fn build(&self) -> Frames {
        if *self == Self::default() {
            return Frames::default();
        }
        Frames::new(&self.base.build(), &self.tare.build(), &self.tool.build())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Standing;

    #[test]
    fn the_default_configuration_has_the_default_parameters_of_the_core() {
        let config = Config::default();
        assert_eq!(config.loop_params(), LoopParams::default());
        assert_eq!(config.head.build().unwrap(), trifacet_optics::Head::default());
        let (channels, nominal) = (config.channels(&Tables::default()).unwrap(), Channels::default());
        assert_eq!(format!("{channels:?}"), format!("{nominal:?}"));
        let valid = CalibrationState { standing: Standing::Valid, ..CalibrationState::default() };
        let settings = config.estimation_settings(&valid, 0).unwrap();
        let nominal = Settings::new(config.optics().unwrap(), trifacet_optics::Model::Gaussian);
        assert_eq!(format!("{settings:?}"), format!("{nominal:?}"));
    }
}
