//! NumPy's NPZ: a ZIP archive of NPY arrays, stored or deflated.
//!
//! After NumPy's *NPY format* (numpy.lib.format), versions 1 to 3. ZIP by the crate `zip`; the NPY
//! header is read here, as `npyz` brings a parser generator and an old `zip`.

use std::collections::BTreeMap;
use std::io::Read;

use zip::ZipArchive;
use zip::read::ZipFile;

use super::arrays::{Array, ArraySource, Arrays, plausible};
use super::input::{Endian, ReadSeek, SampleType, decode_from};
use super::{CaptureFile, FileChannel, FileFacts, FileSamples, ReadProgress};
use crate::error::FormatError;
use crate::options::ReadOptions;

const MAGIC: &[u8; 6] = b"\x93NUMPY";

/// Limit of an array's header, in bytes.
const MAX_HEADER_BYTES: usize = 4096;

/// Limit of arrays in a file.
const MAX_ARRAYS: usize = 10_000;

/// Ending of an array's name in the archive.
const ENDING: &str = ".npy";

/// Member with the notes that ihd writes beside its arrays.
const NOTES: &str = "metadata.json";

/// Limit of the notes in bytes; longer ones are of another program.
const MAX_NOTES_BYTES: u64 = 1 << 20;

/// Archive and its notes.
pub struct NpzSource {
    arrays: ArraySource<NpzArrays>,
    notes: BTreeMap<String, String>,
}

impl CaptureFile for NpzSource {
    fn channels(&self) -> &[FileChannel] {
        self.arrays.channels()
    }

    fn metadata(&self) -> BTreeMap<String, String> {
        let mut all = self.notes.clone();
        all.extend(self.arrays.metadata());
        all
    }

    fn facts(&mut self) -> Result<FileFacts, FormatError> {
        self.arrays.facts()
    }

    fn read(
        &mut self,
        selected: &[usize],
        progress: ReadProgress<'_>,
    ) -> Result<FileSamples, FormatError> {
        self.arrays.read(selected, progress)
    }
}

/// The arrays of an archive.
pub struct NpzArrays {
    archive: ZipArchive<Box<dyn ReadSeek>>,
    /// Index of each array in the archive.
    members: Vec<usize>,
}

/// Reads the directory of an archive.
///
/// # Errors
/// [`FormatError`] for a damaged file and one without vectors.
pub fn open(
    source: impl ReadSeek + 'static,
    options: ReadOptions<'_>,
) -> Result<NpzSource, FormatError> {
    let source: Box<dyn ReadSeek> = Box::new(source);
    let mut archive = ZipArchive::new(source)
        .map_err(|e| in_archive(0, "no ZIP archive, or its end is cut off", &e))?;
    if archive.len() > MAX_ARRAYS {
        let what = format!("{} arrays; {MAX_ARRAYS} are the most", archive.len());
        return Err(FormatError::at_byte(0, what));
    }
    let mut arrays = Vec::new();
    let mut members = Vec::new();
    let mut notes = BTreeMap::new();
    for index in 0..archive.len() {
        let mut member = archive
            .by_index(index)
            .map_err(|e| in_archive(0, &format!("member {}", index + 1), &e))?;
        let name = member
            .name()
            .map_err(|e| in_archive(0, "a member's name", &e))?;
        if name == NOTES {
            let text = member.by_ref().take(MAX_NOTES_BYTES);
            notes = serde_json::from_reader(text).unwrap_or_default();
            continue;
        }
        let Some(name) = name.strip_suffix(ENDING).map(str::to_owned) else {
            continue;
        };
        if let Some(array) = array(name, &mut member)? {
            arrays.push(array);
            members.push(index);
        }
    }
    let reader = NpzArrays { archive, members };
    let arrays = ArraySource::new(reader, arrays, "NumPy NPZ", options)?;
    Ok(NpzSource { arrays, notes })
}

/// Describes an array of an archive; `None` if it is text.
fn array(
    name: String,
    member: &mut ZipFile<'_, Box<dyn ReadSeek>>,
) -> Result<Option<Array>, FormatError> {
    let offset = member.data_start().unwrap_or(0);
    let (packed, unpacked) = (member.compressed_size(), member.size());
    let wrong = |what: String| FormatError::at_byte(offset, format!("array `{name}`: {what}"));
    let header = Header::read(member).map_err(wrong)?;
    if header.is_text {
        return Ok(None);
    }
    let Some((kind, endian)) = header.kind else {
        return Ok(Some(Array {
            length: 0,
            name,
            offset,
            scalar: None,
            text: None,
        }));
    };
    let bytes = header.count.checked_mul(kind.bytes() as u64);
    let whole = bytes.and_then(|bytes| bytes.checked_add(header.bytes));
    if whole != Some(unpacked) || !plausible(packed, unpacked) {
        let what = format!(
            "{} numbers declared, {packed} bytes packed, {unpacked} unpacked",
            header.count
        );
        return Err(wrong(what));
    }
    let mut scalar = None;
    if header.count == 1 {
        let bytes = kind.bytes() as u64;
        decode_from(member, bytes, kind, endian, &mut |x| scalar = Some(x))
            .map_err(|e| wrong(e.to_string()))?;
    }
    Ok(Some(Array {
        length: if header.vector { header.count } else { 0 },
        name,
        offset,
        scalar,
        text: None,
    }))
}

fn in_archive(offset: u64, what: &str, e: &zip::result::ZipError) -> FormatError {
    FormatError::at_byte(offset, format!("{what}: {e}"))
}

impl Arrays for NpzArrays {
    fn numbers(&mut self, index: usize, each: &mut dyn FnMut(f64)) -> Result<(), FormatError> {
        let member = self.members[index];
        let mut member = self
            .archive
            .by_index(member)
            .map_err(|e| in_archive(0, "member", &e))?;
        let offset = member.data_start().unwrap_or(0);
        let wrong = |what: String| FormatError::at_byte(offset, what);
        let header = Header::read(&mut member).map_err(wrong)?;
        let Some((kind, endian)) = header.kind else {
            return Ok(());
        };
        let bytes = header.count.saturating_mul(kind.bytes() as u64);
        decode_from(&mut member, bytes, kind, endian, each).map_err(|e| wrong(e.to_string()))?;
        // The checksum is compared at the end of the member.
        match std::io::copy(&mut member, &mut std::io::sink()) {
            Ok(_) => Ok(()),
            Err(e) => Err(wrong(e.to_string())),
        }
    }
}

/// The header of an array.
#[derive(Debug, PartialEq)]
struct Header {
    /// Storage of numbers; `None` for texts, complex numbers and objects.
    kind: Option<(SampleType, Endian)>,
    /// Set for strings.
    is_text: bool,
    /// Number of elements.
    count: u64,
    /// Set if it has one dimension, or several of which all but one are 1.
    vector: bool,
    /// Size of the header in bytes.
    bytes: u64,
}

impl Header {
    fn read(member: &mut impl Read) -> Result<Self, String> {
        let mut start = [0; 8];
        let failed = |e: std::io::Error| format!("header: {e}");
        member.read_exact(&mut start).map_err(failed)?;
        let (magic, version) = start.split_at(MAGIC.len());
        if magic != MAGIC {
            return Err("no NPY array".to_owned());
        }
        let (length, before) = if version[0] == 1 {
            let mut bytes = [0; 2];
            member.read_exact(&mut bytes).map_err(failed)?;
            (usize::from(u16::from_le_bytes(bytes)), 10)
        } else {
            let mut bytes = [0; 4];
            member.read_exact(&mut bytes).map_err(failed)?;
            (u32::from_le_bytes(bytes) as usize, 12)
        };
        if length > MAX_HEADER_BYTES {
            return Err(format!(
                "header of {length} bytes; {MAX_HEADER_BYTES} are the most"
            ));
        }
        let mut text = vec![0; length];
        member.read_exact(&mut text).map_err(failed)?;
        Self::parse(&String::from_utf8_lossy(&text), (before + length) as u64)
    }

    /// Reads `{'descr': '<f8', 'fortran_order': False, 'shape': (1000,), }`.
    fn parse(text: &str, bytes: u64) -> Result<Self, String> {
        let behind = |key: &str| {
            let tail = text.split_once(key).map(|(_, tail)| tail);
            tail.and_then(|tail| tail.split_once(':'))
                .map(|(_, value)| value.trim_start())
        };
        let missing = || format!("header `{}`", text.chars().take(80).collect::<String>());
        let descr = behind("'descr'").ok_or_else(missing)?;
        // A list stands for a record: no numbers.
        let code = descr.strip_prefix('\'').and_then(|d| d.split('\'').next());
        let shape = behind("'shape'").and_then(|s| s.strip_prefix('('));
        let shape = shape.and_then(|s| s.split_once(')')).ok_or_else(missing)?.0;
        let sizes = shape.split(',').map(str::trim).filter(|s| !s.is_empty());
        let sizes: Vec<u64> = sizes
            .map(str::parse)
            .collect::<Result<_, _>>()
            .map_err(|_| missing())?;
        let count = sizes
            .iter()
            .try_fold(1u64, |product, s| product.checked_mul(*s));
        Ok(Self {
            kind: code.and_then(number),
            is_text: code.is_some_and(|code| code.contains(['U', 'S'])),
            count: count.ok_or_else(missing)?,
            vector: sizes.iter().filter(|s| **s != 1).count() <= 1,
            bytes,
        })
    }
}

/// Storage type of a type code: `<f8`, `>i2`, `|u1`.
fn number(code: &str) -> Option<(SampleType, Endian)> {
    let endian = match code.chars().next()? {
        '>' => Endian::Big,
        '<' | '|' | '=' => Endian::Little,
        _ => return None,
    };
    let kind = match code.get(1..)? {
        "i1" => SampleType::I8,
        "u1" => SampleType::U8,
        "i2" => SampleType::I16,
        "u2" => SampleType::U16,
        "i4" => SampleType::I32,
        "u4" => SampleType::U32,
        "i8" => SampleType::I64,
        "u8" => SampleType::U64,
        "f4" => SampleType::F32,
        "f8" => SampleType::F64,
        _ => return None,
    };
    Some((kind, endian))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_as_numpy_writes_them() {
        let of = |text: &str| Header::parse(text, 128);
        let vector = of("{'descr': '<f8', 'fortran_order': False, 'shape': (1000,), }  \n");
        let vector = vector.unwrap();
        assert_eq!(vector.kind, Some((SampleType::F64, Endian::Little)));
        assert!(vector.count == 1000 && vector.vector);
        let scalar = of("{'descr': '>i2', 'fortran_order': False, 'shape': (), }").unwrap();
        assert!(scalar.count == 1 && scalar.kind == Some((SampleType::I16, Endian::Big)));
        let matrix = of("{'descr': '<f4', 'fortran_order': True, 'shape': (2, 3), }").unwrap();
        assert!(!matrix.vector && matrix.count == 6);
        let text = of("{'descr': '<U5', 'fortran_order': False, 'shape': (), }").unwrap();
        assert!(text.is_text && text.kind.is_none());
        let complex = of("{'descr': '<c16', 'fortran_order': False, 'shape': (9,), }").unwrap();
        assert!(!complex.is_text && complex.kind.is_none());
        for bad in ["", "{'descr': '<f8'}", "{'descr': '<f8', 'shape': (-1,)}"] {
            assert!(of(bad).is_err(), "{bad}");
        }
        let hostile = of("{'descr': '<f8', 'shape': (4294967296, 4294967296)}");
        assert!(hostile.is_err());
    }
}
