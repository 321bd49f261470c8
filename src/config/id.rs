//! The fingerprint of geometry and calibration, which every frame carries.

use std::fmt::Write as _;

use super::{Config, FramesConfig, TableError, Tables};

impl Config {
    /// CRC-32 of everything that determines which pose belongs to which codes: the head, the channels, the
    /// contents of the correction tables, the frames, and the steering if it is used as a signal.
    ///
    /// It is the same on every machine, and equal for files with the same meaning.
    ///
    /// # Errors
    /// Fails if a correction table cannot be read.
    pub fn config_id(&self) -> Result<u32, TableError> {
        Ok(self.id(self.calibration_id(&Tables::read(self)?)))
    }

    /// The same fingerprint, from the fingerprint of the calibration.
    pub fn id(&self, calibration: u32) -> u32 {
        self.frames.id(self.fusion_id(calibration))
    }

    /// Fingerprint of the calibration and, if the readback is used as two more signals, of the beam map.
    fn fusion_id(&self, calibration: u32) -> u32 {
        if !self.estimation.fuse_steering {
            return calibration;
        }
        let matrix = self.steering.matrix.map(plain);
        let (origin, scale) = (plain(self.steering.origin_um), self.channels.readback_um_per_v);
        let text = format!("trifacet-fusion-1 {calibration:08x} {matrix:?} {origin:?} um {scale:?} um/V");
        crc32fast::hash(text.as_bytes())
    }

    /// The fingerprint without frames and steering: everything that determines which pose in the sensor's
    /// world frame belongs to which codes, for nine signals.
    pub fn calibration_id(&self, tables: &Tables) -> u32 {
        let mut text = String::new();
        // `{:?}` writes the shortest digits that parse to the same number, on every platform.
        let _ = writeln!(text, "trifacet-geometry-1 {:?} model {:?}", self.head, self.estimation.model);
        if let Some(pivot_mm) = self.pivot_mm() {
            let _ = writeln!(text, "pivot {:?} mm", plain(pivot_mm));
        }
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
        for table in &tables.0 {
            crc.update(&[u8::from(table.is_some())]);
            crc.update(table.as_deref().unwrap_or_default());
        }
        crc.finalize()
    }
}

impl FramesConfig {
    /// Fingerprint of poses in these frames, from the fingerprint of the calibration. It is unchanged if
    /// the frames are the identity.
    fn id(&self, calibration: u32) -> u32 {
        if *self == Self::default() {
            return calibration;
        }
        let mut text = format!("trifacet-frames-1 {calibration:08x}");
        for transform in [self.base, self.tool, self.tare] {
            let [mm, deg] = [transform.translation_mm, transform.rotation_deg].map(plain);
            let _ = write!(text, " {mm:?} {deg:?}");
        }
        crc32fast::hash(text.as_bytes())
    }
}

/// Replaces -0.0 by 0.0.
fn plain<const N: usize>(numbers: [f64; N]) -> [f64; N] {
    numbers.map(|x| x + 0.0)
}

#[cfg(test)]
mod tests {
    use crate::config::parse;

    fn id(text: &str) -> u32 {
        parse(text, None).unwrap().config_id().unwrap()
    }

    #[test]
    fn the_pivot_changes_the_id_only_if_the_beam_is_tilted() {
        let translated = id("");
        let unused = id("steering.tilt.pivot_mm = [0, 0, 500]");
        let [near, far] = [500, 600]
            .map(|z| id(&format!("steering = {{ kind = 'tilt', tilt = {{ pivot_mm = [0, 0, {z}] }} }}")));
        assert_eq!(unused, translated);
        assert!(near != far && near != translated && far != translated);
    }

    #[test]
    fn steering_changes_the_id_only_if_it_is_fused() {
        let geometries = ["", "steering.matrix = [[0, 1], [-1, 0]]", "steering.origin_um = [1, 0]"];
        let nine = geometries.map(id);
        assert_eq!(nine, [nine[0]; 3]);
        let eleven = geometries.map(|text| id(&format!("{text}\nestimation.fuse_steering = true")));
        let mut all = vec![nine[0], eleven[0], eleven[1], eleven[2]];
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), 4, "{all:x?}");
        let zero = id("steering.origin_um = [-0.0, 0]\nestimation.fuse_steering = true");
        assert_eq!(zero, eleven[0]);
    }
}
