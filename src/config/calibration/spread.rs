//! The part of a calibration record from which the frames get their uncertainty.

use std::path::Path;
use std::sync::Arc;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::Deserialize;
use trifacet_optics::calibration::spread::{Spread, SpreadData};

use super::{RecordError, contents};

/// What a calibration leaves unknown of poses, shared by all that compute them.
#[derive(Clone, Debug)]
pub struct SharedSpread(pub Arc<Spread>);

/// The same object is equal to itself without a comparison of its millions of numbers.
impl PartialEq for SharedSpread {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0) || self.0 == other.0
    }
}

#[derive(Deserialize)]
struct Part {
    spread: Option<String>,
}

impl SharedSpread {
    /// Reads it from a record; `None` if the record has none. Blocks.
    ///
    /// # Errors
    /// Fails if the file cannot be read, or is not a record.
    pub fn open(record: &Path) -> Result<Option<Self>, RecordError> {
        let Some(spread) = serde_json::from_slice::<Part>(&contents(record)?)?.spread else {
            return Ok(None);
        };
        let wrong = |found: &str| RecordError::Field {
            field: "spread",
            found: found.to_owned(),
            allowed: "what trifacet calibrate fit wrote",
        };
        let bytes = STANDARD.decode(spread).map_err(|_| wrong("not base64"))?;
        Self::from_bytes(&bytes).map(Some).ok_or_else(|| wrong("not a usable covariance"))
    }

    /// Takes the bytes of a recording; `None` if they are not usable.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let data: SpreadData = postcard::from_bytes(bytes).ok()?;
        Some(Self(Arc::new(Spread::new(data)?)))
    }

    /// The bytes for a recording.
    pub fn to_bytes(&self) -> Vec<u8> {
        spread_bytes(&self.0)
    }
}

/// The numbers as bytes. Writing into a vector does not fail.
pub(crate) fn spread_bytes(spread: &Spread) -> Vec<u8> {
    postcard::to_stdvec(spread.data()).unwrap_or_default()
}
