//! Reload: changes that a running daemon takes over from its configuration file.

use std::fmt;

use serde_json::Value;

use super::{Config, InvalidValues};

macro_rules! live {
    ($($($field:ident).+),* $(,)?) => {
        /// The keys and sections that can change while the daemon runs. All others require a restart.
        pub const LIVE: &[&[&str]] = &[$(&[$(stringify!($field)),+]),*];

        /// Copies the differences between `old` and `new` into `config`, where they can take effect live.
        fn take_over(config: &mut Config, old: &Config, new: &Config) {
            $(if old.$($field).+ != new.$($field).+ {
                config.$($field).+.clone_from(&new.$($field).+);
            })*
        }
    };
}

live! {
    channels,
    calibration,
    centering.mode,
    centering.target,
    centering.setpoint_um,
    centering.loop_delay_ms,
    centering.lag_ms,
    centering.kp,
    centering.ki_per_s,
    centering.feed_forward,
    centering.tracking_hz,
    centering.search,
    centering.search_attempts,
    centering.lock_limit_um,
    centering.lock_time_ms,
    centering.lost_time_ms,
    centering.self_check_s,
    steering.matrix,
    steering.origin_um,
    steering.origin_verified,
    steering.readback_um,
    steering.pointing_um,
    steering.deviation_um,
    steering.limit_um,
    steering.slew_mm_per_s,
    steering.park_um,
    steering.on_exit,
    steering.lease_ms,
    steering.on_lease,
    laser,
    estimation.spot_noise_um,
    estimation.power_noise,
    estimation.systematic_um,
    estimation.systematic_urad,
    estimation.fuse_steering,
    estimation.edge_margin_mm,
    estimation.balance_limit,
    frames,
    uncertainty,
    log.level,
}

/// The result of a reload.
#[derive(Clone, Debug, PartialEq)]
pub struct Reload {
    /// The configuration with which the daemon continues.
    pub running: Config,
    /// The part of the file that was taken over. The next reload is compared with it.
    pub taken: Config,
    /// Dotted keys that were taken over.
    pub changed: Vec<String>,
    /// Dotted keys that require a restart.
    pub refused: Vec<String>,
}

/// Why a file cannot be taken over.
#[derive(Debug, thiserror::Error)]
pub enum ReloadError {
    /// The configurations cannot be compared.
    #[error("cannot compare: {0}")]
    Compare(#[from] serde_json::Error),
    /// Old and new values conflict.
    #[error(transparent)]
    Conflict(#[from] InvalidValues),
}

/// Compares a file with the state that was last taken over from it, and applies the differences to the
/// running configuration. Values that were changed by command, and not in the file, are kept.
///
/// # Errors
/// Fails if old and new values conflict.
pub fn reload(running: &Config, taken: &Config, file: &Config) -> Result<Reload, ReloadError> {
    let (changed, refused) = differences(taken, file)?.into_iter().partition(|key| is_live(key));
    let (mut running, mut now_taken) = (running.clone(), taken.clone());
    take_over(&mut running, taken, file);
    take_over(&mut now_taken, taken, file);
    running.verify()?;
    Ok(Reload { running, taken: now_taken, changed, refused })
}

/// A key with two values.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    /// The dotted key.
    pub key: String,
    /// The value before; null if it was absent.
    pub old: Value,
    /// The value now; null if it is absent.
    pub new: Value,
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [old, new] = [&self.old, &self.new].map(|value| match value {
            Value::Null => "absent".into(),
            value => value.to_string(),
        });
        write!(f, "{} = {new}, was {old}", self.key)
    }
}

fn is_live(key: &str) -> bool {
    LIVE.iter().any(|live| {
        let live = live.join(".");
        key.strip_prefix(&live).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
    })
}

/// The keys whose values differ, in order, without `monitor.token`.
///
/// # Errors
/// Fails if a configuration cannot be serialised.
pub fn changes(old: &Config, new: &Config) -> Result<Vec<Change>, serde_json::Error> {
    let mut changes = Vec::new();
    compare("", &serde_json::to_value(old)?, &serde_json::to_value(new)?, &mut changes);
    Ok(changes)
}

/// The dotted keys whose values differ, in order.
fn differences(old: &Config, new: &Config) -> Result<Vec<String>, serde_json::Error> {
    let mut keys: Vec<_> = changes(old, new)?.into_iter().map(|change| change.key).collect();
    if old.monitor.token != new.monitor.token && !keys.iter().any(|key| key == "monitor.token") {
        keys.push("monitor.token".into()); // the serialised trees do not show the token
    }
    Ok(keys)
}

fn compare(path: &str, old: &Value, new: &Value, changes: &mut Vec<Change>) {
    match (old, new) {
        (Value::Object(old), Value::Object(new)) => {
            for (name, new) in new {
                let path = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
                compare(&path, old.get(name).unwrap_or(&Value::Null), new, changes);
            }
        }
        (old, new) if old != new => {
            changes.push(Change { key: path.to_owned(), old: old.clone(), new: new.clone() });
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use trifacet_core::centering::LoopMode;

    use super::super::parse;
    use super::*;

    fn config(text: &str) -> Config {
        parse(text, None).unwrap()
    }

    #[test]
    fn reloadable_keys_are_applied_and_the_others_are_named() {
        let old = config("");
        let file = config(
            "acquisition.source = 'serial'\ncentering.kp = 0.3\nframes.tool.translation_mm = [0, 0, -40]\n\
             publishing.udp = []\nlog.level = 'warn'\nhead.psd_size_mm = 12\ntwin.motion = []\n\
             channels.b.dark_v = [0, 0, 0.001]\n",
        );
        let reload = reload(&old, &old, &file).unwrap();
        let changed = ["centering.kp", "channels.b.dark_v", "frames.tool.translation_mm", "log.level"];
        assert_eq!(reload.changed, changed);
        let refused = ["acquisition.source", "head.psd_size_mm", "publishing.udp", "twin.motion"];
        assert_eq!(reload.refused, refused);
        let wanted = config(
            "centering.kp = 0.3\nframes.tool.translation_mm = [0, 0, -40]\nlog.level = 'warn'\n\
             channels.b.dark_v = [0, 0, 0.001]\n",
        );
        assert_eq!(reload.running, wanted);
        // A second reload refuses the same keys again and reports no other change.
        let again = super::reload(&reload.running, &reload.taken, &file).unwrap();
        assert!(again.changed.is_empty());
        assert_eq!(again.refused, refused);
    }

    #[test]
    fn a_section_of_the_twin_that_is_added_or_removed_requires_a_restart() {
        let (without, with) = (config(""), config("[twin.tolerances]\nseed = 2\n"));
        for (old, new) in [(&without, &with), (&with, &without)] {
            let reload = reload(old, old, new).unwrap();
            assert_eq!(reload.refused, ["twin.tolerances"]);
            assert_eq!(&reload.running, old);
        }
    }

    #[test]
    fn every_reloadable_key_is_applied() {
        let old = config("");
        let file = config(
            "[channels]\nsum_threshold_v = 0.06\n[calibration]\nexpires_days = 30\n\
             [centering]\nmode = 'off'\ntarget = 'balance'\nsetpoint_um = [1, 2]\nloop_delay_ms = 3\nlag_ms = 1\n\
             kp = 1\nki_per_s = 1\nfeed_forward = false\ntracking_hz = 5\nsearch = false\nsearch_attempts = 9\nlock_limit_um = 4\nlock_time_ms = 1\nlost_time_ms = 1\nself_check_s = 9\n\
             [steering]\nmatrix = [[1, 0], [0, -1]]\norigin_um = [1, 0]\norigin_verified = false\nreadback_um = 0.2\npointing_um = 2\nlimit_um = 300\nslew_mm_per_s = 1\npark_um = [1, 1]\non_exit = 'park'\nlease_ms = 100\n\
             on_lease = 'park'\n[laser]\npower_uw = 600\n[estimation]\nspot_noise_um = 2\npower_noise = 0.1\nsystematic_um = [1, 1, 1]\nsystematic_urad = [1, 1, 1]\nfuse_steering = true\nedge_margin_mm = 1\n\
             balance_limit = 0.1\n[frames.tare]\nrotation_deg = [1, 0, 0]\n[uncertainty]\npointing_urad = 1\n[log]\nlevel = 'warn'\n",
        );
        let all = reload(&old, &old, &file).unwrap();
        assert_eq!(all.running, file);
        // All but deviation_um, which takes the place of pointing_um.
        assert_eq!((all.changed.len(), all.refused.len()), (LIVE.len() - 1, 0));
        let earlier = config("steering.deviation_um = 2");
        assert_eq!(reload(&old, &old, &earlier).unwrap().changed, ["steering.deviation_um"]);
    }

    #[test]
    fn values_set_by_command_stay_unless_the_file_changes_them() {
        let old = config("");
        let mut running = old.clone();
        running.centering.mode = LoopMode::Shadow;
        running.centering.kp = Some(0.7);
        let reload = reload(&running, &old, &config("centering.kp = 0.2\ncentering.lag_ms = 2")).unwrap();
        assert_eq!(reload.running.centering.mode, LoopMode::Shadow);
        assert_eq!(reload.running.centering.kp, Some(0.2));
    }

    #[test]
    fn values_that_are_inconsistent_with_fixed_ones_are_refused() {
        let old = config("");
        let file = config("head.psd_size_mm = 20\nestimation.edge_margin_mm = 8");
        let error = reload(&old, &old, &file).unwrap_err().to_string();
        assert!(error.contains("estimation.edge_margin_mm = 8") && error.contains("6.5"), "{error}");
    }
}
