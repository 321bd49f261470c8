//! Serialises the configuration to the text of a file.

use serde::{Serialize, Serializer};

use super::Config;

impl Config {
    /// The text of a file with the same meaning, but without secrets. Steering by the live page is
    /// therefore disabled.
    ///
    /// # Errors
    /// Fails if a number is too large for TOML.
    pub fn to_text(&self) -> Result<String, toml::ser::Error> {
        let mut public = self.clone();
        (public.monitor.token, public.monitor.control) = (None, false);
        toml::to_string(&public)
    }
}

/// Serialises `None` as `"off"`.
#[expect(clippy::ref_option, reason = "so serde calls it")]
pub(super) fn or_off<T: Serialize, S: Serializer>(value: &Option<T>, to: S) -> Result<S::Ok, S::Error> {
    match value {
        Some(value) => value.serialize(to),
        None => "off".serialize(to),
    }
}

#[cfg(test)]
mod tests {
    use crate::config::{Token, load, parse};

    #[test]
    fn shipped_files_survive_a_round_trip() {
        let mut files = 0;
        for file in std::fs::read_dir("config").unwrap().map(|file| file.unwrap().path()) {
            if file.extension().is_some_and(|e| e == "toml") {
                let config = load(Some(&file)).unwrap();
                let text = config.to_text().unwrap();
                assert_eq!(parse(&text, None).unwrap(), config, "{}: {text}", file.display());
                files += 1;
            }
        }
        assert!(files >= 6, "{files}");
    }

    #[test]
    fn switched_off_keys_stay_off_and_secrets_are_omitted() {
        let text = "monitor.listen = 'off'\npublishing.tcp = 'off'\ntwin.steering.readback_noise_um = 'off'\n\
                    twin.fault = [{ at_s = 1.5, kind = 'laser-bump', shift_um = [1.0, -2.0] }, \
                    { at_s = 2.0, for_s = 0.1, kind = 'psd-dark', psd = 1 }]\n\
                    twin.motion = [{ axis = 'roll', amount_urad = 3.0, kind = 'vibration', frequency_hz = 1.0, high_hz = 9.0 }]\n\
                    publishing.udp = ['127.0.0.1:9', { address = '239.255.73.62:7362', divider = 4, ttl = 2 }]\n\
                    publishing.allow = ['10.0.0.0/8']\ncontrol.mode = '0600'\n\
                    channels.b.dark_v = [0.1, -0.30000000000000004, 1e-300]\ntwin.seed = 9007199254740992";
        let config = parse(text, None).unwrap();
        assert_eq!(parse(&config.to_text().unwrap(), None).unwrap(), config);
        let secret = "monitor.control = true\nmonitor.token = 'correct-horse-battery'";
        let mut config = parse(secret, None).unwrap();
        let text = config.to_text().unwrap();
        assert!(!text.contains("correct") && !text.contains("token"), "{text}");
        (config.monitor.token, config.monitor.control) = (None::<Token>, false);
        assert_eq!(parse(&text, None).unwrap(), config);
    }
}
