//! The fingerprint of what a calibration determines.

use std::fmt::Write as _;

use sha2::{Digest, Sha256};
use trifacet_core::channels::{Channels, Correction};

use crate::config::Config;

/// SHA-256, in hexadecimal, of everything that a calibration determines or relies on: the geometry of the head, the
/// amplifiers and gains of the PSDs, their correction tables as numbers, and the model of the beam. `channels` are
/// those of `config`, with their tables.
///
/// Not part of it is what may change without a new calibration: dark offsets, frames, steering, limits, noise.
/// A key that a later version adds to the head enters only if it differs from its default, so that a record stays
/// valid.
pub fn fingerprint(config: &Config, channels: &Channels) -> String {
    let mut text = String::new();
    let head = &config.head;
    // `{:?}` writes the shortest digits that parse to the same number, on every platform.
    let _ = writeln!(text, "trifacet-calibration-1 model {:?}", config.estimation.model);
    let nominal = [head.psd_distance_mm, head.psd_size_mm, head.facet_angle_deg, head.beam_diameter_mm];
    let _ = writeln!(text, "{:?} light {:?}", plain(nominal), head.beam_direction.map(plain));
    for facet in head.facets() {
        let parts = [facet.normal, facet.psd_origin_mm, facet.psd_normal, facet.psd_up];
        let _ = writeln!(text, "{:?}", parts.map(|part| part.map(plain)));
    }
    let mut hash = Sha256::new();
    for psd in &channels.psds {
        let _ = writeln!(text, "{:?} {:?} V {:?}", psd.amplifier, psd.full_scale_v, psd.gain);
        hash.update(text.as_bytes());
        text.clear();
        for number in psd.correction.iter().flat_map(Correction::numbers) {
            hash.update((number + 0.0).to_le_bytes());
        }
    }
    format!("{:x}", hash.finalize())
}

/// Replaces -0.0 by 0.0.
fn plain<const N: usize>(numbers: [f64; N]) -> [f64; N] {
    numbers.map(|x| x + 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Tables, parse};

    fn with_tables(text: &str, tables: [Option<&str>; 3]) -> String {
        let config = parse(text, None).unwrap();
        let tables = Tables(tables.map(|table| table.map(|text| text.as_bytes().to_vec())));
        let channels = config.channels(&tables).unwrap();
        fingerprint(&config, &channels)
    }

    fn of(text: &str) -> String {
        with_tables(text, [None; 3])
    }

    #[test]
    fn what_a_calibration_determines_changes_the_fingerprint_and_nothing_else_does() {
        let nominal = of("");
        // A record that was written once must fit for ever.
        assert_eq!(nominal, "3509688d24b94b85b42e1b9d23c4c0aeac22e4cd05fad15c382d78eadc67eaf7");
        let others = "frames.tare.rotation_deg = [1, 0, 0]\nsteering.matrix = [[0, 1], [-1, 0]]\n\
                      channels.a.dark_v = [0.001, 0, 0]\nestimation.spot_noise_um = 2\ncentering.kp = 0.1\n\
                      channels.b.gain = [1, 1.0, 1e0]\nlog.level = 'warn'";
        assert_eq!(of(others), nominal);
        let determined = [
            "head.psd_distance_mm = 251",
            "head.beam_diameter_mm = 0.5",
            "head.beam_direction = [0, 1e-3, -1]",
            "head.b.normal = [-1, 1.7, 2]",
            "head.c.psd_origin_mm = [-120, -220, 5]",
            "head.a.psd_up = [0, 1e-3, 1]",
            "channels.c.gain = [1, 1, 1.02]",
            "channels.c.full_scale_v = 5",
            "channels.a.amplifier = 'difference'",
            "estimation.model = 'ray'",
        ];
        let mut all: Vec<_> = determined.into_iter().map(of).chain([nominal]).collect();
        let number = all.len();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), number);
    }

    #[test]
    fn tables_count_as_numbers_and_each_for_its_psd() {
        let table =
            "u_m,v_m,du_m,dv_m\n-7e-3,-7e-3,1e-6,0\n7e-3,-7e-3,1e-6,0\n-7e-3,7e-3,1e-6,0\n7e-3,7e-3,1e-6,0\n";
        let same = "# PSD A\ndu_m;dv_m;u_m;v_m\n1e-6;0;0.007;0.007\n1e-6;0;0.007;-0.007\n0.000001;-0.0;-7e-3;7e-3\n1e-6;0;-7e-3;-7e-3\n";
        let a = with_tables("", [Some(table), None, None]);
        assert_eq!(a, with_tables("", [Some(same), None, None]));
        assert_ne!(a, with_tables("", [None, Some(table), None]));
        assert_ne!(a, with_tables("", [Some(&table.replace("1e-6", "2e-6")), None, None]));
        assert_ne!(a, of(""));
    }
}
