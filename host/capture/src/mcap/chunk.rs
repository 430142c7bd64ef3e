//! Contents of a chunk: unpacking, and the records in it.

use super::records::ChunkRecord;

/// Size of a record's opcode and length, in bytes.
pub const PREFIX: usize = 9;

/// Record as it lies in the file or in a chunk.
pub struct RawRecord<'a> {
    /// Kind of record.
    pub opcode: u8,
    /// Contents.
    pub body: &'a [u8],
}

/// Unpacks a chunk into a buffer and checks its size and CRC-32.
///
/// # Errors
/// Reason why it cannot be read.
pub fn unpack(chunk: &ChunkRecord<'_>, into: &mut Vec<u8>) -> Result<(), String> {
    let size = chunk.unpacked as usize;
    into.clear();
    match chunk.packing {
        "" => into.extend_from_slice(chunk.data),
        "zstd" => {
            let unpacked = zstd::bulk::decompress(chunk.data, size);
            *into = unpacked.map_err(|e| format!("its chunk does not unpack: {e}"))?;
        }
        other => {
            return Err(format!(
                "its chunks are packed with {other:?}; pack them with zstd (`mcap compress`)"
            ));
        }
    }
    if into.len() != size {
        return Err("its chunk unpacks to another size than it declares".into());
    }
    if chunk.crc != 0 && crc32(into) != chunk.crc {
        return Err("its chunk fails its CRC-32".into());
    }
    Ok(())
}

fn crc32(bytes: &[u8]) -> u32 {
    /// CRC-32 of the wire with sixteen tables instead of one: a capture has hundreds of megabytes.
    static CRC32: crc::Crc<u32, crc::Table<16>> =
        crc::Crc::<u32, crc::Table<16>>::new(ihd_shared::wire::frame::CRC32.algorithm);
    CRC32.checksum(bytes)
}

/// Record at `at` of an unpacked chunk, and the offset of the next; `None` at the end.
pub fn record_at(chunk: &[u8], at: usize) -> Result<Option<(RawRecord<'_>, usize)>, &'static str> {
    let rest = chunk.get(at..).unwrap_or_default();
    let Some((&[opcode, ref length @ ..], behind)) = rest.split_first_chunk::<PREFIX>() else {
        return if rest.is_empty() {
            Ok(None)
        } else {
            Err("its chunk ends within a record")
        };
    };
    let length = usize::try_from(u64::from_le_bytes(*length)).unwrap_or(usize::MAX);
    let body = behind.get(..length);
    let body = body.ok_or("a record within its chunk is longer than the chunk")?;
    let next = at + PREFIX + length;
    Ok(Some((RawRecord { opcode, body }, next)))
}
