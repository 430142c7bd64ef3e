//! The window: every sample pair of one mains half-cycle, and the estimator's trajectory through it.
//!
//! On the wire a window is a `WindowStart`, as many `WindowChunk`s and `TrajectoryChunk`s as it needs,
//! and a `WindowEnd` with the CRC-32 of all pair bytes followed by all trajectory bytes. Pairs are
//! [`crate::sampling::Pair::to_le_bytes`]; trajectory entries are [`TrajectoryEntry::to_le_bytes`]. Raw
//! little-endian, because postcard's varints would make samples 40 % longer. A piece that is lost is asked for
//! again (`ResendWindow`).

use crate::units::{MicroOhm, PicoHenry};

/// Room for the pairs of one half-cycle: 50 Hz at 80 kHz gives 16 267.
pub const MAX_PAIRS: usize = 16_384;

/// Room for the trajectory of one half-cycle, one entry a block: 50 Hz at 80 kHz gives 267.
pub const MAX_TRAJECTORY: usize = 272;

/// Bytes of one pair on the wire.
pub const PAIR_BYTES: usize = 4;

/// Bytes of one trajectory entry on the wire.
pub const TRAJECTORY_ENTRY_BYTES: usize = 8;

/// Raw bytes in a full chunk: 240 pairs or 120 trajectory entries, so that a frame stays under
/// [`crate::wire::frame::MAX_BODY`].
pub const CHUNK_BYTES: usize = 960;

/// The estimator's R and L at the centre of one block's demodulation kernel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct TrajectoryEntry {
    /// Resistance.
    pub r: MicroOhm,
    /// Inductance.
    pub l: PicoHenry,
}

impl TrajectoryEntry {
    /// Bytes as places for entries in the wire's layout, where they begin at a word and are a whole number of entries.
    pub fn on_bytes(bytes: &mut [u8]) -> Option<&mut [Self]> {
        const { assert!(cfg!(target_endian = "little")) };
        bytemuck::try_cast_slice_mut(bytes).ok()
    }

    /// The layout on the wire and in files: R in µΩ then L in pH, little-endian signed 32 bit.
    pub fn to_le_bytes(self) -> [u8; TRAJECTORY_ENTRY_BYTES] {
        let mut b = [0; TRAJECTORY_ENTRY_BYTES];
        b[..4].copy_from_slice(&self.r.0.to_le_bytes());
        b[4..].copy_from_slice(&self.l.0.to_le_bytes());
        b
    }

    /// Inverse of [`TrajectoryEntry::to_le_bytes`].
    pub fn from_le_bytes(b: [u8; TRAJECTORY_ENTRY_BYTES]) -> Self {
        Self {
            r: MicroOhm(i32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            l: PicoHenry(i32::from_le_bytes([b[4], b[5], b[6], b[7]])),
        }
    }
}
