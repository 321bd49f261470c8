//! The configuration together with the contents of its correction tables, and its calibration.

use std::path::PathBuf;

use jiff::Timestamp;
use trifacet_optics::FACETS;

use super::assembly::AssemblyError;
use super::file::read_regular;
use super::{CalibrationState, Config};

/// Contents of the correction tables of PSDs A, B and C.
///
/// They are read once, so that fingerprint, channel map and recording use the same contents.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Tables(pub [Option<Vec<u8>>; 3]);

/// A correction table that cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("correction table of PSD {psd}, {}: {source}", path.display())]
pub struct TableError {
    psd: char,
    path: PathBuf,
    source: std::io::Error,
}

impl Tables {
    /// Reads the tables that a configuration names. Blocks.
    ///
    /// # Errors
    /// Fails with the first table that cannot be read.
    pub fn read(config: &Config) -> Result<Self, TableError> {
        let mut tables = Self::default();
        for ((table, psd), channels) in tables.0.iter_mut().zip(FACETS).zip(config.channels.psds()) {
            if let Some(path) = &channels.correction {
                let refuse = |source| TableError { psd, path: path.clone(), source };
                *table = Some(read_regular(path).map_err(refuse)?);
            }
        }
        Ok(tables)
    }
}

impl Tables {
    /// The tables whose contents differ, as a message each.
    pub fn changes(&self, new: &Self) -> Vec<String> {
        let crc = |table: &Option<Vec<u8>>| {
            table.as_ref().map_or("none".to_owned(), |text| format!("CRC-32 {:08x}", crc32fast::hash(text)))
        };
        let both = FACETS.into_iter().zip(self.0.iter().zip(&new.0)).filter(|(_, (old, new))| old != new);
        both.map(|(psd, (old, new))| format!("correction table of PSD {psd}: {}, was {}", crc(new), crc(old)))
            .collect()
    }
}

/// All inputs that determine the meaning of samples and poses.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CalibrationContext {
    /// The configuration.
    pub config: Config,
    /// Its correction tables.
    pub tables: Tables,
    /// Its calibration.
    pub calibration: CalibrationState,
}

impl CalibrationContext {
    /// Reads the tables and the calibration record of a configuration. Blocks.
    ///
    /// # Errors
    /// Fails if a correction table or the record cannot be read, or is not valid.
    pub fn read(config: Config) -> Result<Self, AssemblyError> {
        let tables = Tables::read(&config)?;
        let channels = config.channels(&tables)?;
        let record = config.calibration.read().map_err(AssemblyError::Record)?;
        let mut calibration = CalibrationState::of(&config, &channels, record, Timestamp::now());
        if calibration.belongs() {
            calibration.spread = config.calibration.read_spread().map_err(AssemblyError::Record)?;
        }
        Ok(Self { config, tables, calibration })
    }

    /// Whether a valid calibration record belongs to the configuration. Otherwise frames carry `UNCALIBRATED`.
    pub fn calibrated(&self) -> bool {
        self.calibration.is_valid()
    }

    /// The fingerprint that every frame carries, see [`Config::id`].
    pub fn id(&self) -> u32 {
        self.config.id(self.config.calibration_id(&self.tables))
    }
}
