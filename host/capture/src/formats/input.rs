//! File input: typed values in either byte order, bounded, with the offset for messages.

use std::io::{self, BufReader, Read, Seek, SeekFrom};

use super::ReadProgress;
use crate::error::FormatError;

/// Readable and seekable source, a file or bytes in memory: a `dyn` takes one trait that has methods.
pub trait ReadSeek: Read + Seek {}

impl<T: Read + Seek> ReadSeek for T {}

/// Byte order of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Endian {
    /// Least significant first.
    Little,
    /// Most significant first.
    Big,
}

/// Storage type of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleType {
    /// Signed 8 bit.
    I8,
    /// Unsigned 8 bit.
    U8,
    /// Signed 16 bit.
    I16,
    /// Unsigned 16 bit.
    U16,
    /// Signed 32 bit.
    I32,
    /// Unsigned 32 bit.
    U32,
    /// Signed 64 bit.
    I64,
    /// Unsigned 64 bit.
    U64,
    /// IEEE 754 single.
    F32,
    /// IEEE 754 double.
    F64,
}

impl SampleType {
    /// Size of one sample in bytes.
    pub const fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// Smallest and largest value of an integer; `None` for floating point.
    pub fn range(self) -> Option<(f64, f64)> {
        let bits = 8 * self.bytes() as i32;
        match self {
            Self::I8 | Self::I16 | Self::I32 | Self::I64 => {
                let half = libm::exp2(f64::from(bits - 1));
                Some((-half, half - 1.0))
            }
            Self::U8 | Self::U16 | Self::U32 | Self::U64 => {
                Some((0.0, libm::exp2(f64::from(bits)) - 1.0))
            }
            Self::F32 | Self::F64 => None,
        }
    }
}

/// Number of bytes decoded at a time.
const CHUNK: usize = 1 << 16;

/// Number of samples between two progress reports.
const PART: u64 = 1 << 18;

/// File read from front to back, with jumps.
pub struct Input {
    bytes: BufReader<Box<dyn ReadSeek>>,
    offset: u64,
    length: u64,
}

impl Input {
    /// Creates an input at the first byte of `source`.
    ///
    /// # Errors
    /// [`FormatError`] when the length cannot be found.
    pub fn new(source: impl ReadSeek + 'static) -> Result<Self, FormatError> {
        let mut source: Box<dyn ReadSeek> = Box::new(source);
        let length = source.seek(SeekFrom::End(0));
        let length = length.map_err(|e| FormatError::io(0, &e))?;
        source
            .seek(SeekFrom::Start(0))
            .map_err(|e| FormatError::io(0, &e))?;
        Ok(Self {
            bytes: BufReader::with_capacity(CHUNK, source),
            offset: 0,
            length,
        })
    }

    /// Offset of the next byte.
    pub fn offset(&self) -> u64 {
        self.offset
    }

    /// Length of the file in bytes.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Number of bytes up to the end.
    pub fn remaining(&self) -> u64 {
        self.length.saturating_sub(self.offset)
    }

    /// Creates an error at this offset.
    pub fn wrong(&self, what: impl Into<String>) -> FormatError {
        FormatError::at_byte(self.offset, what)
    }

    /// Seeks to an offset from the beginning.
    ///
    /// # Errors
    /// [`FormatError`] at the present offset when it lies behind the file's end.
    pub fn seek(&mut self, offset: u64) -> Result<(), FormatError> {
        if offset > self.length {
            let end = self.length;
            return Err(self.wrong(format!(
                "points to byte {offset}, but the file ends at {end}"
            )));
        }
        let by = offset as i64 - self.offset as i64;
        self.bytes
            .seek_relative(by)
            .map_err(|e| FormatError::io(self.offset, &e))?;
        self.offset = offset;
        Ok(())
    }

    /// Skips `bytes`.
    ///
    /// # Errors
    /// [`FormatError`] when they are not all there.
    pub fn skip(&mut self, bytes: u64) -> Result<(), FormatError> {
        self.need(bytes)?;
        self.seek(self.offset + bytes)
    }

    /// Checks that `bytes` more are available, before allocating memory for them.
    ///
    /// # Errors
    /// [`FormatError`] at this offset, with both numbers.
    pub fn need(&self, bytes: u64) -> Result<(), FormatError> {
        if bytes > self.remaining() {
            let left = self.remaining();
            return Err(self.wrong(format!("{bytes} bytes declared, {left} left in the file")));
        }
        Ok(())
    }

    /// Fills `buffer`.
    ///
    /// # Errors
    /// [`FormatError`] when the file ends before.
    pub fn exact(&mut self, buffer: &mut [u8]) -> Result<(), FormatError> {
        self.need(buffer.len() as u64)?;
        self.bytes
            .read_exact(buffer)
            .map_err(|e| FormatError::io(self.offset, &e))?;
        self.offset += buffer.len() as u64;
        Ok(())
    }

    /// Reads the next `N` bytes.
    ///
    /// # Errors
    /// [`FormatError`] when the file ends before.
    pub fn array<const N: usize>(&mut self) -> Result<[u8; N], FormatError> {
        let mut bytes = [0; N];
        self.exact(&mut bytes)?;
        Ok(bytes)
    }

    /// Reads the next `length` bytes as Latin-1 text up to the first NUL.
    ///
    /// # Errors
    /// [`FormatError`] when the file ends before.
    pub fn text(&mut self, length: usize) -> Result<String, FormatError> {
        self.need(length as u64)?;
        let mut bytes = vec![0; length];
        self.exact(&mut bytes)?;
        let until_nul = bytes.split(|b| *b == 0).next().unwrap_or(&[]);
        Ok(until_nul.iter().map(|b| char::from(*b)).collect())
    }

    /// Reads the next number.
    ///
    /// # Errors
    /// [`FormatError`] when the file ends before.
    pub fn number(&mut self, kind: SampleType, endian: Endian) -> Result<f64, FormatError> {
        let mut bytes = [0; 8];
        let bytes = &mut bytes[..kind.bytes()];
        self.exact(bytes)?;
        let mut value = 0.0;
        decode(bytes, kind, endian, |x| value = x);
        Ok(value)
    }

    /// Passes `count` numbers to `each`, one by one.
    ///
    /// # Errors
    /// [`FormatError`] when they are not all there: then none is handed over.
    pub fn numbers(
        &mut self,
        count: u64,
        kind: SampleType,
        endian: Endian,
        mut each: impl FnMut(f64),
    ) -> Result<(), FormatError> {
        let bytes = count.saturating_mul(kind.bytes() as u64);
        self.need(bytes)?;
        let at = self.offset;
        decode_from(self, bytes, kind, endian, &mut each).map_err(|e| FormatError::io(at, &e))
    }

    /// Reads `count` samples as scale · number + offset; those that are not finite stay so: the survey cuts the capture there.
    ///
    /// # Errors
    /// [`FormatError`] when they are not all there.
    pub fn samples(
        &mut self,
        count: u64,
        kind: SampleType,
        endian: Endian,
        scale: f64,
        offset: f64,
        progress: ReadProgress<'_>,
    ) -> Result<Vec<f32>, FormatError> {
        self.need(count.saturating_mul(kind.bytes() as u64))?;
        let mut values = Vec::with_capacity(usize::try_from(count).unwrap_or(0));
        let mut left = count;
        while left > 0 {
            let part = left.min(PART);
            self.numbers(part, kind, endian, |x| {
                values.push((scale * x + offset) as f32);
            })?;
            left -= part;
            progress(1.0 - left as f64 / count as f64);
        }
        Ok(values)
    }
}

impl Read for Input {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.bytes.read(buffer)?;
        self.offset += read as u64;
        Ok(read)
    }
}

/// Decodes `bytes` bytes of `source`, a chunk at a time.
///
/// # Errors
/// What the operating system reports, or an unexpected end.
pub fn decode_from<F: FnMut(f64) + ?Sized>(
    source: &mut impl Read,
    bytes: u64,
    kind: SampleType,
    endian: Endian,
    each: &mut F,
) -> io::Result<()> {
    let mut left = bytes;
    let mut buffer = vec![0; CHUNK.min(usize::try_from(left).unwrap_or(CHUNK))];
    while left > 0 {
        let size = buffer.len().min(usize::try_from(left).unwrap_or(CHUNK));
        source.read_exact(&mut buffer[..size])?;
        decode(&buffer[..size], kind, endian, &mut *each);
        left -= size as u64;
    }
    Ok(())
}

/// Decodes a whole number of values.
pub fn decode(bytes: &[u8], kind: SampleType, endian: Endian, mut each: impl FnMut(f64)) {
    macro_rules! all {
        ($number:ty, $to:expr) => {{
            let (values, _) = bytes.as_chunks::<{ size_of::<$number>() }>();
            match endian {
                Endian::Little => values
                    .iter()
                    .for_each(|b| each($to(<$number>::from_le_bytes(*b)))),
                Endian::Big => values
                    .iter()
                    .for_each(|b| each($to(<$number>::from_be_bytes(*b)))),
            }
        }};
    }
    match kind {
        SampleType::I8 => all!(i8, f64::from),
        SampleType::U8 => all!(u8, f64::from),
        SampleType::I16 => all!(i16, f64::from),
        SampleType::U16 => all!(u16, f64::from),
        SampleType::I32 => all!(i32, f64::from),
        SampleType::U32 => all!(u32, f64::from),
        SampleType::I64 => all!(i64, |x| x as f64),
        SampleType::U64 => all!(u64, |x| x as f64),
        SampleType::F32 => all!(f32, f64::from),
        SampleType::F64 => all!(f64, |x| x),
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    #[test]
    fn numbers_in_both_byte_orders() {
        let mut input = Input::new(Cursor::new(vec![0x01, 0x02, 0x01, 0x02, 0xFF])).unwrap();
        assert_eq!(input.number(SampleType::U16, Endian::Little), Ok(513.0));
        assert_eq!(input.number(SampleType::I16, Endian::Big), Ok(258.0));
        assert_eq!(input.number(SampleType::I8, Endian::Big), Ok(-1.0));
        let end = input.number(SampleType::F64, Endian::Big).unwrap_err();
        assert_eq!(
            end,
            FormatError::at_byte(5, "8 bytes declared, 0 left in the file")
        );
    }

    #[test]
    fn hostile_lengths_are_refused_before_allocating() {
        let mut input = Input::new(Cursor::new(vec![0; 16])).unwrap();
        for count in [3, 1 << 60, u64::MAX] {
            let refused = input.numbers(count, SampleType::F64, Endian::Little, |_| ());
            assert!(refused.is_err(), "{count}");
        }
        assert!(input.text(1 << 60).is_err());
        assert!(input.seek(17).unwrap_err().what.contains("byte 17"));
        let mut seen = 0;
        input
            .numbers(2, SampleType::F64, Endian::Little, |_| seen += 1)
            .unwrap();
        assert_eq!(seen, 2);
    }
}
