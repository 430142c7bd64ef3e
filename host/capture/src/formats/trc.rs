//! LeCroy TRC (template LECROY_2_x): one channel a file.
//!
//! After the template that LeCroy's instruments answer to `TEMPLATE?`, printed in their remote
//! control manuals. value = VERTICAL_GAIN · code − VERTICAL_OFFSET,
//! time = HORIZ_OFFSET + k · HORIZ_INTERVAL. The gain holds the probe's ratio already.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use ihd_signal::TimeBase;

use super::input::{Endian, Input, SampleType};
use super::stated_unit::StatedUnit;
use super::{CaptureFile, FileChannel, FileSamples, ReadProgress, single_channel};
use crate::error::FormatError;

/// Name at the descriptor's beginning.
const DESCRIPTOR: &[u8] = b"WAVEDESC";

/// Range in bytes within which the descriptor must begin: the length of a block may precede it.
const MAX_LEAD_BYTES: usize = 64;

/// Smallest size of a descriptor, in bytes.
const MIN_DESCRIPTOR: u64 = 346;

/// Offsets of the descriptor's fields.
mod field {
    pub const TEMPLATE: u64 = 16;
    pub const COMM_TYPE: u64 = 32;
    pub const COMM_ORDER: u64 = 34;
    pub const WAVE_DESCRIPTOR: u64 = 36;
    pub const USER_TEXT: u64 = 40;
    pub const TRIGTIME_ARRAY: u64 = 48;
    pub const RIS_TIME_ARRAY: u64 = 52;
    pub const WAVE_ARRAY_1: u64 = 60;
    pub const INSTRUMENT_NAME: u64 = 76;
    pub const TRACE_LABEL: u64 = 96;
    pub const FIRST_VALID_POINT: u64 = 124;
    pub const LAST_VALID_POINT: u64 = 128;
    pub const SUBARRAY_COUNT: u64 = 144;
    pub const VERTICAL_GAIN: u64 = 156;
    pub const VERTICAL_OFFSET: u64 = 160;
    pub const MAX_VALUE: u64 = 164;
    pub const MIN_VALUE: u64 = 168;
    pub const HORIZ_INTERVAL: u64 = 176;
    pub const HORIZ_OFFSET: u64 = 180;
    pub const VERT_UNIT: u64 = 196;
    pub const HOR_UNIT: u64 = 244;
    pub const RECORD_TYPE: u64 = 316;
    pub const WAVE_SOURCE: u64 = 344;
}

/// Offset of the descriptor in a file with this beginning; `None` if there is none.
pub fn descriptor(head: &[u8]) -> Option<usize> {
    let lead = head.get(..MAX_LEAD_BYTES.min(head.len()))?;
    lead.windows(DESCRIPTOR.len()).position(|w| w == DESCRIPTOR)
}

/// A TRC file whose descriptor has been read.
pub struct TrcSource {
    input: Input,
    endian: Endian,
    layout: Layout,
}

/// Fields of the descriptor.
struct Descriptor<'a> {
    input: &'a mut Input,
    begin: u64,
    endian: Endian,
}

impl Descriptor<'_> {
    fn number(&mut self, field: u64, kind: SampleType) -> Result<f64, FormatError> {
        self.input.seek(self.begin + field)?;
        let value = self.input.number(kind, self.endian)?;
        if value.is_finite() {
            Ok(value)
        } else {
            let what = "a field of the descriptor is not finite";
            Err(FormatError::at_byte(self.begin + field, what))
        }
    }

    fn text(&mut self, field: u64, length: usize) -> Result<String, FormatError> {
        self.input.seek(self.begin + field)?;
        Ok(self.input.text(length)?.trim().to_owned())
    }

    /// Reads a length or count: a positive 32-bit integer.
    fn count(&mut self, field: u64) -> Result<u64, FormatError> {
        let value = self.number(field, SampleType::I32)?;
        if value < 0.0 {
            let what = format!("a length of {value}");
            return Err(FormatError::at_byte(self.begin + field, what));
        }
        Ok(value as u64)
    }
}

impl TrcSource {
    /// Reads the descriptor.
    ///
    /// # Errors
    /// [`FormatError`] for a damaged file, another template, and sequences.
    pub fn open(mut input: Input) -> Result<Self, FormatError> {
        let mut head = vec![0; MAX_LEAD_BYTES.min(input.length() as usize)];
        input.exact(&mut head)?;
        let begin = descriptor(&head).map(|k| k as u64);
        let begin = begin.ok_or_else(|| FormatError::at_byte(0, "no WAVEDESC"))?;
        input.seek(begin)?;
        input.need(MIN_DESCRIPTOR)?;
        input.seek(begin + field::COMM_ORDER)?;
        let endian = match input.array::<2>()? {
            [1, 0] => Endian::Little,
            [0, 0] => Endian::Big,
            other => return Err(input.wrong(format!("COMM_ORDER {other:02x?}"))),
        };
        let descriptor = Descriptor {
            input: &mut input,
            begin,
            endian,
        };
        let layout = Layout::read(descriptor)?;
        input.seek(layout.at)?;
        input.need(layout.samples * layout.kind.bytes() as u64)?;
        Ok(Self {
            endian,
            layout,
            input,
        })
    }
}

/// Place and meaning of the samples.
struct Layout {
    kind: SampleType,
    at: u64,
    samples: u64,
    gain: f64,
    offset: f64,
    time: TimeBase,
    channel: FileChannel,
    metadata: BTreeMap<String, String>,
}

impl Layout {
    fn read(mut d: Descriptor<'_>) -> Result<Self, FormatError> {
        let template = d.text(field::TEMPLATE, 16)?;
        if !template.starts_with("LECROY_2_") {
            let what = format!("template `{template}`: LECROY_2_x is read");
            return Err(FormatError::at_byte(d.begin + field::TEMPLATE, what));
        }
        let kind = d.kind()?;
        let record = d.number(field::RECORD_TYPE, SampleType::U16)?;
        if record != 0.0 || d.count(field::SUBARRAY_COUNT)? > 1 {
            let what = "a sequence or another record than a single sweep: export one segment";
            return Err(FormatError::at_byte(d.begin + field::RECORD_TYPE, what));
        }
        let (at, valid) = d.samples(kind)?;
        let gain = d.number(field::VERTICAL_GAIN, SampleType::F32)?;
        let offset = -d.number(field::VERTICAL_OFFSET, SampleType::F32)?;
        let metadata = [
            ("format", format!("TRC, {template}")),
            ("instrument", d.text(field::INSTRUMENT_NAME, 16)?),
        ];
        Ok(Self {
            kind,
            at,
            samples: valid.end() - valid.start() + 1,
            gain,
            offset,
            time: d.time(*valid.start())?,
            channel: d.channel(gain, offset)?,
            metadata: metadata.map(|(key, value)| (key.to_owned(), value)).into(),
        })
    }
}

impl Descriptor<'_> {
    /// Storage type of the samples.
    fn kind(&mut self) -> Result<SampleType, FormatError> {
        match self.number(field::COMM_TYPE, SampleType::U16)? as u16 {
            0 => Ok(SampleType::I8),
            1 => Ok(SampleType::I16),
            other => Err(self.input.wrong(format!("COMM_TYPE {other}"))),
        }
    }

    /// Place of the first valid sample in the file, in bytes, and the valid samples.
    fn samples(&mut self, kind: SampleType) -> Result<(u64, RangeInclusive<u64>), FormatError> {
        let mut at = self.begin;
        for length in [
            field::WAVE_DESCRIPTOR,
            field::USER_TEXT,
            field::TRIGTIME_ARRAY,
            field::RIS_TIME_ARRAY,
        ] {
            at += self.count(length)?;
        }
        let bytes = kind.bytes() as u64;
        let stored = self.count(field::WAVE_ARRAY_1)? / bytes;
        let first = self.count(field::FIRST_VALID_POINT)?;
        let last = self.count(field::LAST_VALID_POINT)?;
        if last < first || last >= stored {
            let what = format!("valid points {first} to {last} of {stored}");
            let at = self.begin + field::FIRST_VALID_POINT;
            return Err(FormatError::at_byte(at, what));
        }
        Ok((at + first * bytes, first..=last))
    }

    /// Times of the samples from sample `first` on.
    fn time(&mut self, first: u64) -> Result<TimeBase, FormatError> {
        let dt_s = self.number(field::HORIZ_INTERVAL, SampleType::F32)?;
        let begin_s = self.number(field::HORIZ_OFFSET, SampleType::F64)?;
        if dt_s <= 0.0 {
            let what = format!("a sampling interval of {dt_s:e} s");
            let at = self.begin + field::HORIZ_INTERVAL;
            return Err(FormatError::at_byte(at, what));
        }
        let scale = StatedUnit::parse(&self.text(field::HOR_UNIT, 48)?);
        let scale = scale.seconds().map_err(|unit| {
            let what = format!("samples over {unit}, no waveform over time");
            FormatError::at_byte(self.begin + field::HOR_UNIT, what)
        })?;
        Ok(TimeBase::Even {
            t0_s: (begin_s + first as f64 * dt_s) * scale,
            dt_s: dt_s * scale,
        })
    }

    /// Name, unit and range of the channel, of which a code is `gain` · code + `offset`.
    fn channel(&mut self, gain: f64, offset: f64) -> Result<FileChannel, FormatError> {
        let magnitude = |code: f64| (gain * code + offset).abs();
        let high = magnitude(self.number(field::MAX_VALUE, SampleType::F32)?);
        let low = magnitude(self.number(field::MIN_VALUE, SampleType::F32)?);
        let label = self.text(field::TRACE_LABEL, 16)?;
        let source = self.number(field::WAVE_SOURCE, SampleType::U16)? as u32;
        Ok(FileChannel {
            name: match label.is_empty() {
                true => format!("C{}", source + 1),
                false => label,
            },
            unit: StatedUnit::parse(&self.text(field::VERT_UNIT, 48)?),
            full_scale: Some(high.max(low)).filter(|x| *x > 0.0),
        })
    }
}

impl CaptureFile for TrcSource {
    fn channels(&self) -> &[FileChannel] {
        std::slice::from_ref(&self.layout.channel)
    }

    fn metadata(&self) -> BTreeMap<String, String> {
        self.layout.metadata.clone()
    }

    fn read(
        &mut self,
        selected: &[usize],
        progress: ReadProgress<'_>,
    ) -> Result<FileSamples, FormatError> {
        self.input.seek(self.layout.at)?;
        let values = self.input.samples(
            self.layout.samples,
            self.layout.kind,
            self.endian,
            self.layout.gain,
            self.layout.offset,
            progress,
        )?;
        Ok(single_channel(values, self.layout.time.clone(), selected))
    }
}
