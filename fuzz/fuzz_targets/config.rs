//! Text of a configuration: it is parsed or refused with a message for each problem, a valid one survives a round trip,
//! and a command that writes into it leaves all other values as they were.

#![no_main]

use libfuzzer_sys::fuzz_target;
use trifacet::config::edit::{Edit, Value, edited};
use trifacet::config::{Config, ConfigError, parse};
use trifacet::text::decode;

fuzz_target!(|bytes: &[u8]| {
    let Ok(text) = decode(bytes) else { return };
    match parse(text, None) {
        Ok(config) => valid(text, &config),
        Err(ConfigError::Wrong { problems, .. }) => {
            assert!(!problems.is_empty());
            assert!(problems.iter().all(|problem| !problem.message.is_empty()));
        }
        Err(other) => panic!("{other}"),
    }
});

fn valid(text: &str, config: &Config) {
    config.verify().expect("what was parsed is valid");
    // The token is never written.
    let mut public = config.clone();
    (public.monitor.token, public.monitor.control) = (None, false);
    let written = toml::to_string(&public).expect("a configuration can be written");
    let again = parse(&written, None).unwrap_or_else(|error| panic!("{error}: {written}"));
    assert_eq!(public, again);
    let edit = Edit { section: &["steering"], key: "origin_um", value: Value::from_iter([1.0, 2.0]) };
    // It fails if the path is no table, such as `steering = {}` with dotted keys.
    let Ok(new) = edited(text, &[edit]) else { return };
    let new = parse(&new, None).unwrap_or_else(|error| panic!("{error}: {new}"));
    let mut expected = config.clone();
    expected.steering.origin_um = [1.0, 2.0];
    assert_eq!(new, expected);
}
