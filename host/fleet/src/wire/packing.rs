//! CBOR in a zstd frame, and lists of numbers as bytes.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use zstd::bulk::Compressor;
use zstd::zstd_safe::CParameter;

use super::MessageError;

/// Level of zstd, as in the store: a higher one costs time and saves little.
const LEVEL: i32 = 1;

/// Largest unpacked message in bytes: twice the longest window.
pub const MAX_BYTES: usize = 4 << 20;

/// Deepest nesting of a message.
const MAX_DEPTH: usize = 8;

pub(super) fn pack<T: Serialize>(message: &T) -> Result<Vec<u8>, MessageError> {
    let mut bytes = Vec::new();
    let written = ciborium::into_writer(message, &mut bytes);
    written.map_err(|e| MessageError::Fields(e.to_string()))?;
    let packed = || {
        let mut compressor = Compressor::new(LEVEL)?;
        compressor.set_parameter(CParameter::ChecksumFlag(true))?;
        compressor.compress(&bytes)
    };
    packed().map_err(MessageError::Packed)
}

pub(super) fn unpack<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, MessageError> {
    let bytes = zstd::bulk::decompress(bytes, MAX_BYTES).map_err(MessageError::Packed)?;
    let read = ciborium::de::from_reader_with_recursion_limit(bytes.as_slice(), MAX_DEPTH);
    read.map_err(|e| MessageError::Fields(e.to_string()))
}

/// A list of numbers as little-endian singles in one byte string.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub(super) struct Singles(#[serde(with = "serde_bytes")] Vec<u8>);

impl Singles {
    pub fn encode(values: &[f64]) -> Self {
        let bytes = values.iter().flat_map(|x| (*x as f32).to_le_bytes());
        Self(bytes.collect())
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns the numbers of a field, all finite and at most `most` of them.
    pub fn read(&self, field: &'static str, most: usize) -> Result<Vec<f64>, MessageError> {
        let (chunks, rest) = self.0.as_chunks::<4>();
        if !rest.is_empty() || chunks.len() > most {
            let why = format!(
                "has {} bytes, not 4 a point of at most {most}",
                self.0.len()
            );
            return Err(MessageError::value(field, why));
        }
        let number = |bytes: &[u8; 4]| f64::from(f32::from_le_bytes(*bytes));
        let numbers: Vec<f64> = chunks.iter().map(number).collect();
        match numbers.iter().all(|x| x.is_finite()) {
            true => Ok(numbers),
            false => Err(MessageError::value(field, "holds what is no number")),
        }
    }
}
