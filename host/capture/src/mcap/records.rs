//! Parser of the MCAP records that are read, for untrusted bytes.
//!
//! The `mcap` crate's own parser reserves what a text's length declares before it looks whether the bytes are there
//! (4 GiB in a file of 270 kB). Here a length is held against what is left first.

use std::collections::BTreeMap;

/// Limit of a chunk's header: times, size, CRC, length of the name of its packing, `zstd`, length of its records.
pub const CHUNK_HEADER: usize = 8 + 8 + 8 + 4 + 4 + 4 + 8;

/// Offset of the packing's name within a chunk, length included.
pub const PACKING_AT: usize = 8 + 8 + 8 + 4;

/// Name of the packing as it appears in a chunk, after its length.
pub const ZSTD: [u8; 8] = *b"\x04\0\0\0zstd";

/// A channel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ChannelRecord {
    /// Number of the channel in the file.
    pub id: u16,
    /// Number of its schema; 0 for none.
    pub schema_id: u16,
    /// Its topic.
    pub topic: String,
}

/// Header of a message; its data follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageHeader {
    /// Number of its channel.
    pub channel_id: u16,
    /// Time in nanoseconds.
    pub log_time_ns: u64,
    /// Size of its data in bytes.
    pub data_len: usize,
}

/// Chunk as it lies in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChunkRecord<'a> {
    /// Size of the unpacked bytes.
    pub unpacked: u64,
    /// CRC-32 of the unpacked bytes; 0 for none.
    pub crc: u32,
    /// Name of the packing.
    pub packing: &'a str,
    /// Packed bytes.
    pub data: &'a [u8],
}

/// Bytes of a record, read from front to back.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn take(&mut self, length: usize) -> Result<&'a [u8], String> {
        let left = self.0.len();
        let (taken, rest) = self
            .0
            .split_at_checked(length)
            .ok_or_else(|| format!("{length} bytes declared, {left} left in its record"))?;
        self.0 = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(N)?);
        Ok(bytes)
    }

    fn u16(&mut self) -> Result<u16, String> {
        Ok(u16::from_le_bytes(self.array()?))
    }

    fn u32(&mut self) -> Result<u32, String> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    fn u64(&mut self) -> Result<u64, String> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    fn sized(&mut self) -> Result<&'a [u8], String> {
        let length = self.u32()?;
        self.take(usize::try_from(length).unwrap_or(usize::MAX))
    }

    fn text(&mut self) -> Result<&'a str, String> {
        std::str::from_utf8(self.sized()?).map_err(|_| "a text that is no UTF-8".to_owned())
    }
}

/// Parses profile and library of a header.
pub fn header(body: &[u8]) -> Result<(String, String), String> {
    let mut bytes = Bytes(body);
    Ok((bytes.text()?.to_owned(), bytes.text()?.to_owned()))
}

/// Parses number and name of a schema.
pub fn schema(body: &[u8]) -> Result<(u16, String), String> {
    let mut bytes = Bytes(body);
    Ok((bytes.u16()?, bytes.text()?.to_owned()))
}

/// Parses a channel.
pub fn channel(body: &[u8]) -> Result<ChannelRecord, String> {
    let mut bytes = Bytes(body);
    Ok(ChannelRecord {
        id: bytes.u16()?,
        schema_id: bytes.u16()?,
        topic: bytes.text()?.to_owned(),
    })
}

/// Parses the header of a message.
pub fn message(body: &[u8]) -> Result<MessageHeader, String> {
    let mut bytes = Bytes(body);
    let (channel_id, _sequence) = (bytes.u16()?, bytes.u32()?);
    let (log_time_ns, _published_ns) = (bytes.u64()?, bytes.u64()?);
    Ok(MessageHeader {
        channel_id,
        log_time_ns,
        data_len: bytes.0.len(),
    })
}

/// Parses name and entries of a table of text.
pub fn metadata(body: &[u8]) -> Result<(String, BTreeMap<String, String>), String> {
    let mut bytes = Bytes(body);
    let name = bytes.text()?.to_owned();
    let mut table = Bytes(bytes.sized()?);
    let mut entries = BTreeMap::new();
    while !table.0.is_empty() {
        entries.insert(table.text()?.to_owned(), table.text()?.to_owned());
    }
    Ok((name, entries))
}

/// Parses a chunk.
pub fn chunk(body: &[u8]) -> Result<ChunkRecord<'_>, String> {
    let mut bytes = Bytes(body);
    bytes.take(16)?;
    let (unpacked, crc) = (bytes.u64()?, bytes.u32()?);
    let packing = bytes.text()?;
    let length = bytes.u64()?;
    let data = bytes.take(usize::try_from(length).unwrap_or(usize::MAX))?;
    if !bytes.0.is_empty() {
        let rest = bytes.0.len();
        return Err(format!("a chunk with {rest} bytes behind its records"));
    }
    Ok(ChunkRecord {
        unpacked,
        crc,
        packing,
        data,
    })
}

/// Returns `true` if the given beginning of a record's body fits a chunk of `length` bytes packed with zstd.
pub fn begins_as_chunk(head: &[u8], length: u64) -> bool {
    let Some((times, rest)) = head.split_at_checked(PACKING_AT) else {
        return false;
    };
    let (Some((from, _)), Some((to, _))) = (
        times.split_first_chunk::<8>(),
        times[8..].split_first_chunk::<8>(),
    ) else {
        return false;
    };
    let Some(records) = rest
        .strip_prefix(&ZSTD)
        .and_then(<[u8]>::first_chunk::<8>)
        .map(|bytes| u64::from_le_bytes(*bytes))
    else {
        return false;
    };
    u64::from_le_bytes(*from) <= u64::from_le_bytes(*to)
        && records.checked_add(CHUNK_HEADER as u64) == Some(length)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(text: &str) -> Vec<u8> {
        let mut bytes = (text.len() as u32).to_le_bytes().to_vec();
        bytes.extend(text.as_bytes());
        bytes
    }

    #[test]
    fn records_as_the_specification_lays_them_out() {
        let body = [text("ihd-capture 1"), text("ihd 0.1")].concat();
        assert_eq!(
            header(&body),
            Ok(("ihd-capture 1".into(), "ihd 0.1".into()))
        );
        let entries = [text("coil"), text("23 turns")].concat();
        let table = (entries.len() as u32).to_le_bytes().to_vec();
        let body = [text("notes"), table, entries].concat();
        let (name, entries) = metadata(&body).unwrap();
        assert_eq!(
            (name.as_str(), entries["coil"].as_str()),
            ("notes", "23 turns")
        );
        let mut body = vec![7, 0, 1, 0, 0, 0];
        body.extend(9u64.to_le_bytes());
        body.extend(9u64.to_le_bytes());
        body.extend(b"abc");
        let head = message(&body).unwrap();
        assert_eq!(
            (head.channel_id, head.log_time_ns, head.data_len),
            (7, 9, 3)
        );
    }

    /// Nothing is reserved for what is not there: this would be 4 GiB.
    #[test]
    fn a_text_longer_than_its_record_is_refused() {
        let body = [&[0xff; 4][..], b"ihd"].concat();
        for refused in [
            header(&body).map(drop),
            metadata(&body).map(drop),
            schema(&[&[1, 0][..], &body].concat()).map(drop),
            channel(&[&[1, 0, 1, 0][..], &body].concat()).map(drop),
            chunk(&[&[0; PACKING_AT][..], &body].concat()).map(drop),
        ] {
            let why = refused.unwrap_err();
            assert_eq!(why, "4294967295 bytes declared, 3 left in its record");
        }
    }
}
