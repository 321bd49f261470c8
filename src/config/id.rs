//! The fingerprint of geometry and calibration that every frame carries.

use std::fmt::Write as _;
use std::io;

use super::{Config, FramesConfig};

impl Config {
    /// CRC-32 of all that decides which pose belongs to which codes: the head, the channels, the
    /// contents of the correction tables, and the frames. The same on every machine; equal for files
    /// that mean the same.
    ///
    /// # Errors
    /// A correction table cannot be read.
    pub fn config_id(&self) -> io::Result<u32> {
        Ok(self.frames.id(self.calibration_id()?))
    }

    /// The same without the frames: what decides which pose in the sensor's world belongs to which codes.
    ///
    /// # Errors
    /// A correction table cannot be read.
    pub fn calibration_id(&self) -> io::Result<u32> {
        let mut text = String::new();
        // `{:?}` writes the shortest digits that give the same number back, on every platform.
        let _ = writeln!(text, "trifacet-geometry-1 {:?} model {:?}", self.head, self.estimation.model);
        let channels = &self.channels;
        let _ = writeln!(text, "power {:?} mW/V", channels.power_mw_per_v);
        for psd in channels.psds() {
            let _ = writeln!(
                text,
                "{:?} full scale {:?} V gain {:?} dark {:?} V",
                psd.amplifier, psd.full_scale_v, psd.gain, psd.dark_v
            );
        }
        let mut crc = crc32fast::Hasher::new();
        crc.update(text.as_bytes());
        for psd in channels.psds() {
            let table = psd.correction.as_ref().map(std::fs::read).transpose()?;
            crc.update(&[u8::from(table.is_some())]);
            crc.update(&table.unwrap_or_default());
        }
        Ok(crc.finalize())
    }
}

impl FramesConfig {
    /// The fingerprint of poses in these frames, given that of the calibration behind them; the same if
    /// the frames change nothing.
    pub fn id(&self, calibration: u32) -> u32 {
        if *self == Self::default() {
            return calibration;
        }
        let mut text = format!("trifacet-frames-1 {calibration:08x}");
        for transform in [self.base, self.tool, self.tare] {
            // Adding zero makes -0.0 what it means.
            let [mm, deg] = [transform.translation_mm, transform.rotation_deg].map(|v| v.map(|x| x + 0.0));
            let _ = write!(text, " {mm:?} {deg:?}");
        }
        crc32fast::hash(text.as_bytes())
    }
}
