//! `[control]`: the socket that accepts commands for a running daemon.

use std::fmt;
use std::path::PathBuf;

use serde::{Deserialize, Deserializer, Serialize, de};

use super::board_place::LONGEST_SOCKET;
use super::check::Checker;
use super::places::{self, AUTO};
use super::text::or_off;

/// Settings of `[control]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ControlConfig {
    /// Path of the Unix socket. `None` (`"off"` in the file) disables it; `"auto"` in the file is the place of
    /// [`places::control_socket`].
    #[serde(deserialize_with = "path_or_off", serialize_with = "or_off")]
    pub socket: Option<PathBuf>,
    /// Permissions of the socket. Every user with write permission may steer.
    #[serde(deserialize_with = "permissions")]
    pub mode: u32,
}

impl Default for ControlConfig {
    fn default() -> Self {
        Self { socket: places::control_socket(), mode: 0o660 }
    }
}

impl ControlConfig {
    pub(super) fn check(&self, mut at: Checker<'_>) {
        if let Some(path) = &self.socket {
            let fine = path.is_absolute() && path.as_os_str().len() <= LONGEST_SOCKET;
            let allowed = format!("\"auto\", \"off\", or an absolute path of at most {LONGEST_SOCKET} bytes");
            at.demand(fine, "socket", format!("{:?}", path.display().to_string()), allowed);
        }
        let fine = self.mode & !0o777 == 0 && self.mode & 0o600 == 0o600;
        at.demand(fine, "mode", format!("\"{:04o}\"", self.mode), MODE);
    }
}

const MODE: &str = "octal permissions from \"0600\" to \"0777\" with which the owner may read and write";

fn path_or_off<'de, D: Deserializer<'de>>(from: D) -> Result<Option<PathBuf>, D::Error> {
    let text = String::deserialize(from)?;
    Ok(match text.as_str() {
        "off" => None,
        AUTO => places::control_socket(),
        path => Some(path.into()),
    })
}

/// Parses `"0660"`, or TOML's own `0o660`.
fn permissions<'de, D: Deserializer<'de>>(from: D) -> Result<u32, D::Error> {
    struct Permissions;
    impl de::Visitor<'_> for Permissions {
        type Value = u32;
        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str(MODE)
        }
        fn visit_str<E: de::Error>(self, text: &str) -> Result<u32, E> {
            u32::from_str_radix(text, 8).map_err(|_| E::invalid_value(de::Unexpected::Str(text), &self))
        }
        fn visit_i64<E: de::Error>(self, number: i64) -> Result<u32, E> {
            u32::try_from(number).map_err(|_| E::invalid_value(de::Unexpected::Signed(number), &self))
        }
    }
    from.deserialize_any(Permissions)
}
