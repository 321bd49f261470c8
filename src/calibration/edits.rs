//! The configuration before and after a calibration.

use trifacet_optics::HeadError;
use trifacet_optics::calibration::parameters::Nominal;
use trifacet_optics::calibration::result::Calibration;
use trifacet_optics::{Pose, Rigid, Vec3};

use crate::config::edit::{Edit, Value};
use crate::config::{Config, TransformConfig};

/// Names of the written tables.
pub const TABLES: [&str; 3] = ["psd-a.csv", "psd-b.csv", "psd-c.csv"];

/// The head before the fit, from a configuration.
///
/// # Errors
/// The geometry of the configuration does not describe a head.
pub fn nominal(config: &Config) -> Result<Nominal, HeadError> {
    let [[xx, xy], [yx, yy]] = config.steering.matrix;
    Ok(Nominal {
        head: config.head.build()?,
        steering_matrix: nalgebra::Matrix2::new(xx, xy, yx, yy),
        steering_origin: nalgebra::Vector2::from(config.steering.origin_um) / 1e6,
        stage: config.frames.base.build().inverse(),
        table: config.frames.tool.build().inverse(),
    })
}

/// What the calibration changes in a configuration.
pub fn edits(calibration: &Calibration, config: &Config) -> Vec<Edit> {
    let mut edits = Vec::new();
    let mut set = |section: &'static [&'static str], key: &'static str, value: Value| {
        edits.push(Edit { section, key, value });
    };
    let (head, gains) = calibration.rounded();
    set(&["head"], "beam_direction", list(head.beam_direction));
    set(&["head"], "beam_diameter_mm", (head.beam_diameter * 1e3).into());
    let sections: [&[&str]; 3] = [&["head", "a"], &["head", "b"], &["head", "c"]];
    for ((section, psd), normal) in sections.into_iter().zip(&head.psds).zip(&head.facets) {
        set(section, "normal", list(*normal));
        set(section, "psd_origin_mm", list(psd.origin * 1e3));
        set(section, "psd_normal", list(psd.x));
        set(section, "psd_up", list(psd.z));
    }
    let sections: [&[&str]; 3] = [&["channels", "a"], &["channels", "b"], &["channels", "c"]];
    for (((section, channels), gain), name) in
        sections.into_iter().zip(config.channels.psds()).zip(gains).zip(TABLES)
    {
        let [u, v, _] = channels.gain;
        set(section, "gain", [u, v, 1.0 / gain].into_iter().collect());
        set(section, "correction", name.into());
    }
    set(&["calibration"], "record", "calibration.json".into());
    let (matrix, origin) = calibration.steering();
    let rows = [0, 1].map(|i| [matrix[(i, 0)], matrix[(i, 1)]].into_iter().collect::<Value>());
    set(&["steering"], "matrix", rows.into_iter().collect());
    set(&["steering"], "origin_um", [origin.x * 1e6, origin.y * 1e6].into_iter().collect());
    let [base, tool] = calibration.base_and_tool();
    let mut frame = |section: &'static [&'static str], frame: &Rigid| {
        let TransformConfig { translation_mm, rotation_deg } = TransformConfig::of(&Pose::from(frame));
        set(section, "translation_mm", translation_mm.into_iter().collect());
        set(section, "rotation_deg", rotation_deg.into_iter().collect());
    };
    frame(&["frames", "base"], &base);
    frame(&["frames", "tool"], &tool);
    // A tare in the frames before the calibration means nothing in the new ones.
    if config.frames.tare != TransformConfig::default() {
        frame(&["frames", "tare"], &Rigid::identity());
    }
    edits
}

fn list(v: Vec3) -> Value {
    <[f64; 3]>::from(v).into_iter().collect()
}
