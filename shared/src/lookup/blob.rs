//! The lookup as bytes: on the wire, in flash and in files.
//!
//! `"IHDL" · format u8 · version u32 · R cells · L cells · observed bits · crc32`, little-endian,
//! cells in index order (`frequency · CURRENTS + current`); the CRC covers all before it.

use core::fmt;

use super::grid::{CELLS, CURRENTS, FREQUENCIES};
use super::plausible::{Implausible, check};
use super::{OBSERVED_BYTES, RlLookup};
use crate::wire::frame::CRC32;
use crate::wire::messages::Outcome;

/// First bytes of every lookup.
pub const MAGIC: [u8; 4] = *b"IHDL";

/// The layout described in this module, on the grid of [`super::grid`].
pub const FORMAT: u8 = 1;

const R_AT: usize = MAGIC.len() + 1 + 4;
const L_AT: usize = R_AT + 2 * CELLS;
const OBSERVED_AT: usize = L_AT + 2 * CELLS;
const CRC_AT: usize = OBSERVED_AT + OBSERVED_BYTES;

/// Length of a lookup in bytes.
pub const LEN: usize = CRC_AT + 4;

/// Reason that bytes are not a lookup that firmware would use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlobError {
    /// Not [`LEN`] bytes.
    Length {
        /// Bytes given.
        got: usize,
    },
    /// No [`MAGIC`], or a format other than [`FORMAT`].
    Format,
    /// The CRC does not match.
    Crc,
    /// The cells are not plausible.
    Implausible(Implausible),
}

impl fmt::Display for BlobError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Length { got } => write!(f, "a lookup has {LEN} bytes, not {got}"),
            Self::Format => write!(f, "not a lookup of format {FORMAT}"),
            Self::Crc => write!(f, "the lookup's CRC-32 does not match"),
            Self::Implausible(why) => write!(f, "the lookup is not plausible: {why}"),
        }
    }
}

impl core::error::Error for BlobError {}

impl BlobError {
    /// The answer a device gives, with its detail.
    pub fn outcome(self) -> (Outcome, u32) {
        match self {
            Self::Length { .. } => (Outcome::LookupLength, LEN as u32),
            Self::Format => (Outcome::LookupFormat, u32::from(FORMAT)),
            Self::Crc => (Outcome::LookupCrc, 0),
            Self::Implausible(Implausible::Range { cell }) => {
                (Outcome::LookupRange, u32::from(cell))
            }
            Self::Implausible(Implausible::Slope { cell }) => {
                (Outcome::LookupSlope, u32::from(cell))
            }
            Self::Implausible(Implausible::NotMonotone { cell }) => {
                (Outcome::LookupNotMonotone, u32::from(cell))
            }
        }
    }
}

impl RlLookup {
    /// The lookup's bytes.
    pub fn to_bytes(&self) -> [u8; LEN] {
        let mut b = [0; LEN];
        b[..MAGIC.len()].copy_from_slice(&MAGIC);
        b[MAGIC.len()] = FORMAT;
        b[R_AT - 4..R_AT].copy_from_slice(&self.version.to_le_bytes());
        for cell in 0..CELLS {
            let (f, i) = (cell / CURRENTS, cell % CURRENTS);
            b[R_AT + 2 * cell..][..2].copy_from_slice(&self.r[f][i].to_le_bytes());
            b[L_AT + 2 * cell..][..2].copy_from_slice(&self.l[f][i].to_le_bytes());
        }
        b[OBSERVED_AT..CRC_AT].copy_from_slice(&self.observed);
        let crc = CRC32.checksum(&b[..CRC_AT]);
        b[CRC_AT..].copy_from_slice(&crc.to_le_bytes());
        b
    }

    /// Reads and checks a lookup: length, format, CRC, plausibility.
    ///
    /// # Errors
    /// [`BlobError`], in that order.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, BlobError> {
        let b: &[u8; LEN] = bytes
            .try_into()
            .map_err(|_| BlobError::Length { got: bytes.len() })?;
        if b[..MAGIC.len()] != MAGIC || b[MAGIC.len()] != FORMAT {
            return Err(BlobError::Format);
        }
        if CRC32.checksum(&b[..CRC_AT]).to_le_bytes() != b[CRC_AT..] {
            return Err(BlobError::Crc);
        }
        let cell_at =
            |at: usize, cell: usize| u16::from_le_bytes([b[at + 2 * cell], b[at + 2 * cell + 1]]);
        let mut lookup = Self {
            version: u32::from_le_bytes([b[R_AT - 4], b[R_AT - 3], b[R_AT - 2], b[R_AT - 1]]),
            r: [[0; CURRENTS]; FREQUENCIES],
            l: [[0; CURRENTS]; FREQUENCIES],
            observed: [0; OBSERVED_BYTES],
        };
        for cell in 0..CELLS {
            let (f, i) = (cell / CURRENTS, cell % CURRENTS);
            lookup.r[f][i] = cell_at(R_AT, cell);
            lookup.l[f][i] = cell_at(L_AT, cell);
        }
        lookup.observed.copy_from_slice(&b[OBSERVED_AT..CRC_AT]);
        check(&lookup).map_err(BlobError::Implausible)?;
        Ok(lookup)
    }
}

#[cfg(test)]
mod tests {
    use super::super::prior::prior;
    use super::*;

    #[test]
    fn bytes_and_back() {
        let mut lookup = prior();
        lookup.version = 7;
        lookup.mark_observed(3, 4);
        assert_eq!(RlLookup::from_bytes(&lookup.to_bytes()), Ok(lookup));
    }

    #[test]
    fn every_flipped_bit_is_refused() {
        let bytes = prior().to_bytes();
        for bit in 0..8 * LEN {
            let mut broken = bytes;
            broken[bit / 8] ^= 1 << (bit % 8);
            assert!(RlLookup::from_bytes(&broken).is_err(), "bit {bit}");
        }
    }

    #[test]
    fn refusals_say_why() {
        let bytes = prior().to_bytes();
        assert_eq!(
            RlLookup::from_bytes(&bytes[1..]),
            Err(BlobError::Length { got: LEN - 1 })
        );
        let mut format = bytes;
        format[4] = 9;
        assert_eq!(RlLookup::from_bytes(&format), Err(BlobError::Format));
        let mut wild = prior();
        wild.r[0][0] = 3;
        assert_eq!(
            RlLookup::from_bytes(&wild.to_bytes()).map_err(BlobError::outcome),
            Err((Outcome::LookupRange, 0))
        );
    }
}
