//! Version of the board protocol, and what is wrong with a message.

/// The major version of the protocol: the version in every message.
pub const VERSION: u8 = 1;

/// The highest minor version that this program implements.
pub const MINOR: u8 = 1;

/// Reasons why an undamaged frame is not a message of this version.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MessageError {
    /// Another version of the protocol.
    #[error("message {kind:#04x} of protocol version {version}; this program speaks version {VERSION}")]
    Version {
        /// Type of the message.
        kind: u8,
        /// Version of the message.
        version: u8,
    },
    /// The type does not exist in this version and direction.
    #[error("unknown message type {0:#04x}")]
    Type(u8),
    /// The length is wrong for the type.
    #[error("message {kind:#04x} has the wrong length: {length} bytes")]
    Length {
        /// Type of the message.
        kind: u8,
        /// Length of the message without checksum, bytes.
        length: usize,
    },
    /// A field has an undefined value.
    #[error("message {kind:#04x}: the value of the {field} is undefined")]
    Value {
        /// Type of the message.
        kind: u8,
        /// Name of the field.
        field: &'static str,
    },
}
