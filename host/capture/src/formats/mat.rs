//! MATLAB MAT version 5 (also written by `-v6` and `-v7`): numeric vectors, compressed or not.
//!
//! After MathWorks' *MAT-File Format* (R2023a), chapter 1. A reader of its own: the crate `matfile`
//! (0.5) calls itself alpha, keeps every array as f64 beside the file in memory, unpacks without a
//! bound and reports no offsets.

use std::io::Read;

use flate2::read::ZlibDecoder;

use super::arrays::{Array, ArraySource, Arrays, plausible};
use super::input::{Endian, Input, SampleType, decode_from};
use crate::error::FormatError;
use crate::options::ReadOptions;

/// Size of the file's header in bytes.
pub const HEADER: usize = 128;

const MI_MATRIX: u32 = 14;
const MI_COMPRESSED: u32 = 15;
const MX_CHAR: u8 = 4;
/// Classes of double to uint64 arrays.
const MX_NUMBERS: std::ops::RangeInclusive<u8> = 6..=15;

/// Limit of a name or text, in bytes.
const MAX_TEXT_BYTES: u32 = 256;

/// Limit of arrays in a file.
const MAX_ARRAYS: usize = 10_000;

/// Byte order of a version 5 file with this beginning; `None` for other files.
pub fn endian(head: &[u8]) -> Option<Endian> {
    match head.get(124..HEADER)? {
        [0x00, 0x01, b'I', b'M'] => Some(Endian::Little),
        [0x01, 0x00, b'M', b'I'] => Some(Endian::Big),
        _ => None,
    }
}

/// The elements of a file.
pub struct MatArrays {
    input: Input,
    endian: Endian,
    elements: Vec<Element>,
}

/// Element of the file: an array, possibly compressed.
#[derive(Clone, Copy)]
struct Element {
    at: u64,
    bytes: u64,
    compressed: bool,
}

/// Reads the directory of a file.
///
/// # Errors
/// [`FormatError`] for a damaged file and one without vectors.
pub fn open(
    mut input: Input,
    options: ReadOptions<'_>,
) -> Result<ArraySource<MatArrays>, FormatError> {
    let header = input.array::<HEADER>()?;
    let endian = endian(&header).ok_or_else(|| FormatError::at_byte(124, "no MAT version 5"))?;
    let mut arrays = Vec::new();
    let mut elements = Vec::new();
    while input.remaining() > 0 && arrays.len() < MAX_ARRAYS {
        let at = input.offset();
        let kind = input.number(SampleType::U32, endian)? as u32;
        let bytes = input.number(SampleType::U32, endian)? as u64;
        input.need(bytes)?;
        let element = Element {
            at: at + 8,
            bytes,
            compressed: kind == MI_COMPRESSED,
        };
        if kind == MI_MATRIX || kind == MI_COMPRESSED {
            let array = Matrix::begin(&mut input, element, endian)?.array()?;
            if let Some(array) = array {
                arrays.push(array);
                elements.push(element);
            }
        }
        input.seek(at + 8 + bytes)?;
    }
    let reader = MatArrays {
        input,
        endian,
        elements,
    };
    ArraySource::new(reader, arrays, "MATLAB MAT v5", options)
}

impl Arrays for MatArrays {
    fn numbers(&mut self, index: usize, each: &mut dyn FnMut(f64)) -> Result<(), FormatError> {
        let element = self.elements[index];
        let mut matrix = Matrix::begin(&mut self.input, element, self.endian)?;
        let (_, count) = matrix.describe()?;
        matrix.numbers(count, each)
    }
}

/// Matrix read from front to back.
struct Matrix<'a> {
    bytes: Box<dyn Read + 'a>,
    endian: Endian,
    element: Element,
}

/// Class and name of a matrix.
struct Description {
    class: u8,
    complex: bool,
    name: String,
    vector: bool,
}

impl<'a> Matrix<'a> {
    fn begin(input: &'a mut Input, element: Element, endian: Endian) -> Result<Self, FormatError> {
        input.seek(element.at)?;
        let packed = input.take(element.bytes);
        let mut matrix = Self {
            bytes: Box::new(packed),
            endian,
            element,
        };
        if element.compressed {
            matrix.bytes = Box::new(ZlibDecoder::new(matrix.bytes));
            let (kind, _) = (matrix.number()?, matrix.number()?);
            if kind != MI_MATRIX {
                return Err(matrix.wrong(format!("element of type {kind} in compressed data")));
            }
        }
        Ok(matrix)
    }

    fn wrong(&self, what: impl Into<String>) -> FormatError {
        FormatError::at_byte(self.element.at, what)
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], FormatError> {
        let mut bytes = [0; N];
        let at = self.element.at;
        self.bytes
            .read_exact(&mut bytes)
            .map_err(|e| broken(at, &e))?;
        Ok(bytes)
    }

    fn number(&mut self) -> Result<u32, FormatError> {
        let bytes = self.take()?;
        Ok(match self.endian {
            Endian::Little => u32::from_le_bytes(bytes),
            Endian::Big => u32::from_be_bytes(bytes),
        })
    }

    /// Reads type and length of the next element, and the data of a small one.
    fn tag(&mut self) -> Result<(u32, u32, Option<[u8; 4]>), FormatError> {
        let word = self.number()?;
        // A small element has its length in the upper half, and its data in four bytes.
        if word >> 16 == 0 {
            return Ok((word, self.number()?, None));
        }
        let length = word >> 16;
        if length > 4 {
            return Err(self.wrong(format!("a small element of {length} bytes")));
        }
        Ok((word & 0xFFFF, length, Some(self.take()?)))
    }

    /// Reads the bytes of the next element, padding included; at most `most`.
    fn short(&mut self, most: u32) -> Result<Vec<u8>, FormatError> {
        let (_, length, small) = self.tag()?;
        if let Some(small) = small {
            return Ok(small[..length as usize].to_vec());
        }
        if length > most {
            return Err(self.wrong(format!("{length} bytes of a name or dimensions")));
        }
        let mut bytes = vec![0; length.next_multiple_of(8) as usize];
        let at = self.element.at;
        self.bytes
            .read_exact(&mut bytes)
            .map_err(|e| broken(at, &e))?;
        bytes.truncate(length as usize);
        Ok(bytes)
    }

    /// Reads the description of the array and its declared number of elements.
    fn describe(&mut self) -> Result<(Description, u64), FormatError> {
        let flags = self.short(8)?;
        let word = match self.endian {
            Endian::Little => [flags.first(), flags.get(1)],
            Endian::Big => [flags.get(3), flags.get(2)],
        };
        let [Some(&class), Some(&flag)] = word else {
            return Err(self.wrong("no array flags"));
        };
        let dimensions = self.short(MAX_TEXT_BYTES)?;
        let mut sizes = Vec::new();
        super::input::decode(&dimensions, SampleType::I32, self.endian, |d| sizes.push(d));
        let name = self.short(MAX_TEXT_BYTES)?;
        let name = name.iter().map(|b| char::from(*b)).collect();
        let count = sizes.iter().product::<f64>();
        if sizes.len() < 2 || sizes.iter().any(|d| *d < 0.0) || count > u32::MAX.into() {
            return Err(self.wrong(format!("array `{name}` with the sizes {sizes:?}")));
        }
        let description = Description {
            class,
            complex: flag & 0x08 != 0,
            name,
            vector: sizes.iter().filter(|d| **d != 1.0).count() <= 1,
        };
        Ok((description, count as u64))
    }

    /// Returns the array for the directory; `None` if it is neither numeric nor text.
    fn array(mut self) -> Result<Option<Array>, FormatError> {
        let (description, count) = self.describe()?;
        let mut array = Array {
            name: description.name,
            length: 0,
            offset: self.element.at,
            scalar: None,
            text: None,
        };
        if description.class == MX_CHAR && count <= MAX_TEXT_BYTES.into() {
            let mut text = String::new();
            self.numbers(count, &mut |c| {
                text.extend(char::from_u32(c as u32).filter(|c| !c.is_control()));
            })?;
            array.text = Some(text);
            return Ok(Some(array));
        }
        let real = MX_NUMBERS.contains(&description.class) && !description.complex;
        if !real || !description.vector {
            return Ok(None);
        }
        if count == 1 {
            let mut value = 0.0;
            self.numbers(1, &mut |x| value = x)?;
            array.scalar = Some(value);
        } else {
            // Only its length is checked here.
            self.storage(count)?;
        }
        array.length = count;
        Ok(Some(array))
    }

    /// Returns storage type and size in bytes of the `count` numbers of the real part, and the data of a small element.
    fn storage(&mut self, count: u64) -> Result<(SampleType, u64, Option<[u8; 4]>), FormatError> {
        let (code, length, small) = self.tag()?;
        let kind = match code {
            1 => SampleType::I8,
            // UTF-8, UTF-16: texts.
            2 | 16 => SampleType::U8,
            3 => SampleType::I16,
            4 | 17 => SampleType::U16,
            5 => SampleType::I32,
            6 => SampleType::U32,
            7 => SampleType::F32,
            9 => SampleType::F64,
            12 => SampleType::I64,
            13 => SampleType::U64,
            other => return Err(self.wrong(format!("numbers of type {other}"))),
        };
        let bytes = count * kind.bytes() as u64;
        let packed = self.element.bytes;
        let fits = if self.element.compressed {
            plausible(packed, bytes)
        } else {
            bytes <= packed
        };
        if bytes != u64::from(length) || !fits {
            let what = format!("{count} numbers declared, {length} bytes of them in {packed}");
            return Err(self.wrong(what));
        }
        Ok((kind, bytes, small))
    }

    /// Passes the `count` numbers of the real part to `each`.
    fn numbers(&mut self, count: u64, each: &mut dyn FnMut(f64)) -> Result<(), FormatError> {
        let (kind, bytes, small) = self.storage(count)?;
        match small {
            // At most four bytes.
            Some(small) => super::input::decode(&small[..bytes as usize], kind, self.endian, each),
            None => {
                let at = self.element.at;
                decode_from(&mut self.bytes, bytes, kind, self.endian, each)
                    .map_err(|e| broken(at, &e))?;
            }
        }
        Ok(())
    }
}

/// Converts an I/O error within the element at `at`.
fn broken(at: u64, source: &std::io::Error) -> FormatError {
    match source.kind() {
        std::io::ErrorKind::UnexpectedEof => {
            FormatError::at_byte(at, "the element that begins here is shorter than declared")
        }
        _ => FormatError::at_byte(at, format!("compressed data: {source}")),
    }
}
