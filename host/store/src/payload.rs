//! Packing of a window's samples and trajectory, lossless.

use ihd_link::Window;
use ihd_shared::sampling::Pair;
use ihd_shared::window::{PAIR_BYTES, TRAJECTORY_ENTRY_BYTES, TrajectoryEntry};
use zstd::bulk::{Compressor, Decompressor};
use zstd::zstd_safe::CParameter;

/// zstd's level: the higher ones take several times as long for a few percent of such noise.
const LEVEL: i32 = 1;

/// Most entries that are unpacked; a row that declares more is an error.
const MAX_ENTRIES: usize = 1 << 20;

/// Packed samples and trajectory of a window's row.
pub struct Payload {
    /// Pairs, packed.
    pub pairs: Vec<u8>,
    /// Trajectory entries, packed.
    pub trajectory: Vec<u8>,
}

/// Compressor of a level of zstd, with zstd's own checksum: SQLite has none.
pub fn compressor(level: i32) -> std::io::Result<Compressor<'static>> {
    let mut compressor = Compressor::new(level)?;
    compressor.set_parameter(CParameter::ChecksumFlag(true))?;
    Ok(compressor)
}

/// Packs a window's pairs and trajectory.
///
/// # Errors
/// Errors of zstd, which means a lack of memory.
pub fn pack(window: &Window) -> std::io::Result<Payload> {
    let mut compressor = compressor(LEVEL)?;
    Ok(Payload {
        pairs: compressor.compress(&window.pair_bytes())?,
        trajectory: compressor.compress(&window.trajectory_bytes())?,
    })
}

/// Unpacks `count` pairs.
///
/// # Errors
/// Description of the fault in the bytes.
pub fn pairs(bytes: &[u8], count: usize) -> Result<Vec<Pair>, String> {
    let raw = unpack(bytes, count, PAIR_BYTES)?;
    let (pairs, _) = raw.as_chunks::<PAIR_BYTES>();
    Ok(pairs.iter().map(|b| Pair::from_le_bytes(*b)).collect())
}

/// Unpacks `count` trajectory entries.
///
/// # Errors
/// Description of the fault in the bytes.
pub fn trajectory(bytes: &[u8], count: usize) -> Result<Vec<TrajectoryEntry>, String> {
    let raw = unpack(bytes, count, TRAJECTORY_ENTRY_BYTES)?;
    let (entries, _) = raw.as_chunks::<TRAJECTORY_ENTRY_BYTES>();
    let entry = |b: &[u8; TRAJECTORY_ENTRY_BYTES]| TrajectoryEntry::from_le_bytes(*b);
    Ok(entries.iter().map(entry).collect())
}

fn unpack(bytes: &[u8], count: usize, size: usize) -> Result<Vec<u8>, String> {
    if count > MAX_ENTRIES {
        return Err(format!(
            "it declares {count} entries, more than {MAX_ENTRIES}"
        ));
    }
    let mut decompressor = Decompressor::new().map_err(|e| e.to_string())?;
    let raw = decompressor
        .decompress(bytes, count * size)
        .map_err(|e| format!("its samples cannot be unpacked: {e}"))?;
    if raw.len() == count * size {
        Ok(raw)
    } else {
        let got = raw.len();
        Err(format!(
            "it declares {count} entries of {size} bytes and holds {got} bytes"
        ))
    }
}
