//! Tektronix WFM, versions 1 to 3: one channel a file.
//!
//! After Tektronix' *Reference Waveform File Format* (001-1378-03); version 3 has two more data
//! formats and a wider point density. Samples are value = scale · code + offset. The time of sample
//! k is offset + (k + tt) · scale with the trigger's place between two samples, tt, from the update
//! specification: the CSV that an MSO64 wrote of the same waveform has these times (`analog_waveform`: offset −1 µs,
//! tt 0.83984375, interval 40 ps; first time in the CSV −9.99966406e-07 s, zero index 24999.16015625).
//!
//! Tektronix's package tm_data_types (0.5.0) differs: it reads offset + k · scale, whatever tt
//! (files_and_formats/wfm/wfm.py), and writes 0.5 for it always (wfm_format.py, `setup_update_specifications`). So a tt
//! of 0.5, which an instrument's 8 bits take once in 256, is that package's for "not known" and is left out: its files
//! have the times that it gave them. Both files of one acquisition share tt, so no skew comes of it.

use std::collections::BTreeMap;

use ihd_signal::TimeBase;

use super::input::{Endian, Input, SampleType};
use super::stated_unit::StatedUnit;
use super::{CaptureFile, FileChannel, FileSamples, ReadProgress, single_channel};
use crate::error::FormatError;

/// Byte-order mark of little-endian files; big-endian ones have it reversed.
pub const LITTLE: [u8; 2] = [0x0F, 0x0F];
/// Byte-order mark of big-endian files.
pub const BIG: [u8; 2] = [0xF0, 0xF0];
/// Text after the byte-order mark, up to the digit of the version.
pub const VERSION: &[u8] = b":WFM#00";

/// Size of the second explicit dimension's description, and of the fields that are skipped.
const EXPLICIT_BYTES: u64 = 100;
const IMPLICIT_BYTES: u64 = 76;
const TIME_BASE_BYTES: u64 = 12;

/// Trigger position between two samples that tm_data_types writes for "unknown".
const NOT_KNOWN: f64 = 0.5;

/// Limit of a text in the metadata, in bytes.
const MAX_TEXT_BYTES: u64 = 256;

/// A WFM file whose header has been read.
pub struct WfmSource {
    input: Input,
    endian: Endian,
    channel: FileChannel,
    metadata: BTreeMap<String, String>,
    curve: Curve,
    t0_s: f64,
    dt_s: f64,
}

/// Place and storage of the samples.
struct Curve {
    at: u64,
    samples: u64,
    kind: SampleType,
    scale: f64,
    offset: f64,
}

/// Explicit dimension 1: the vertical axis.
struct Vertical {
    scale: f64,
    offset: f64,
    unit: String,
    extent: (f64, f64),
    format: u32,
}

impl WfmSource {
    /// Reads the header.
    ///
    /// # Errors
    /// [`FormatError`] for a damaged file, and for what holds no voltage or current over time:
    /// FastFrame, digital, IQ, envelope.
    pub fn open(mut input: Input) -> Result<Self, FormatError> {
        let endian = match input.array::<2>()? {
            LITTLE => Endian::Little,
            BIG => Endian::Big,
            mark => {
                let what = format!("{mark:02x?} is no byte-order mark of a WFM file");
                return Err(FormatError::at_byte(0, what));
            }
        };
        let version = match input.array::<8>()? {
            [
                b':',
                b'W',
                b'F',
                b'M',
                b'#',
                b'0',
                b'0',
                digit @ b'1'..=b'3',
            ] => digit - b'0',
            other => {
                let shown = String::from_utf8_lossy(&other).into_owned();
                let what = format!("`{shown}`: versions :WFM#001 to :WFM#003 are read");
                return Err(FormatError::at_byte(2, what));
            }
        };
        Self::header(input, endian, version)
    }

    fn header(mut input: Input, endian: Endian, version: u8) -> Result<Self, FormatError> {
        let file = FileInformation::read(&mut input, endian, version)?;
        let view_bytes = if version == 3 { 60 } else { 56 };
        let vertical = vertical(&mut input, endian)?;
        input.skip(view_bytes + EXPLICIT_BYTES + view_bytes)?;
        let horizontal = Horizontal::read(&mut input, endian)?;
        input.skip(36 + view_bytes + IMPLICIT_BYTES + view_bytes + 2 * TIME_BASE_BYTES + 4)?;
        let (t0_s, dt_s) = horizontal.times(&mut input, endian)?;
        // Fraction and seconds of the trigger; state, type and value of the checksum; precharge.
        input.skip(12 + 10 + 4)?;
        let ends = Ends::read(&mut input, endian)?;
        let kind = kind(vertical.format, version, file.point_bytes)
            .map_err(|what| FormatError::at_byte(ends.at, what))?;
        let samples = ends.samples(kind, horizontal.declared)?;
        input.seek(file.curve_at)?;
        input.need(ends.buffer)?;
        input.seek(file.curve_at + ends.buffer)?;
        let mut metadata = metadata(&mut input, endian)?;
        metadata.insert("format".to_owned(), format!("Tektronix WFM {version}"));
        Ok(Self {
            channel: FileChannel {
                name: file.label.trim().to_owned(),
                unit: StatedUnit::parse(&vertical.unit),
                full_scale: vertical.full_scale(kind),
            },
            input,
            endian,
            metadata,
            curve: Curve {
                at: file.curve_at + ends.first,
                samples,
                kind,
                scale: vertical.scale,
                offset: vertical.offset,
            },
            t0_s,
            dt_s,
        })
    }
}

/// Static file information and the waveform's header, up to the vertical axis.
struct FileInformation {
    point_bytes: u64,
    curve_at: u64,
    label: String,
}

impl FileInformation {
    /// Reads from behind the version to the vertical axis.
    fn read(input: &mut Input, endian: Endian, version: u8) -> Result<Self, FormatError> {
        input.skip(5)?;
        let point_bytes = input.number(SampleType::U8, endian)? as u64;
        let curve_at = input.number(SampleType::U32, endian)? as u64;
        input.skip(20)?;
        let label = input.text(32)?;
        let more_frames = input.number(SampleType::U32, endian)?;
        if more_frames > 0.0 {
            let what = "FastFrame: export one frame as a waveform of its own";
            return Err(input.wrong(format!("{} frames, {what}", more_frames + 1.0)));
        }
        // Size of the header, and the header up to its data type.
        input.skip(2 + 44)?;
        if input.number(SampleType::I32, endian)? == 6.0 {
            return Err(input.wrong("a digital waveform, no voltage"));
        }
        let summary_frame = if version > 1 { 2 } else { 0 };
        input.skip(28 + summary_frame + 12)?;
        Ok(Self {
            point_bytes,
            curve_at,
            label,
        })
    }
}

/// Implicit dimension 1: the time axis, in the file's unit.
struct Horizontal {
    at: u64,
    interval: f64,
    first: f64,
    declared: u64,
    unit: StatedUnit,
}

impl Horizontal {
    fn read(input: &mut Input, endian: Endian) -> Result<Self, FormatError> {
        Ok(Self {
            at: input.offset(),
            interval: input.number(SampleType::F64, endian)?,
            first: input.number(SampleType::F64, endian)?,
            declared: input.number(SampleType::U32, endian)? as u64,
            unit: StatedUnit::parse(&input.text(20)?),
        })
    }

    /// Time of the first sample and sampling interval, in second, by the trigger's place that stands here.
    fn times(&self, input: &mut Input, endian: Endian) -> Result<(f64, f64), FormatError> {
        let (interval, first) = (self.interval, self.first);
        let trigger = input.number(SampleType::F64, endian)?;
        if !(interval > 0.0 && interval.is_finite() && first.is_finite() && trigger.is_finite()) {
            let what = format!("a sampling interval of {interval:e} s from {first:e} s");
            return Err(FormatError::at_byte(self.at, what));
        }
        let between = if trigger == NOT_KNOWN { 0.0 } else { trigger };
        let scale = self.unit.seconds().map_err(|unit| {
            let what = format!("samples over {unit}, no waveform over time");
            FormatError::at_byte(self.at, what)
        })?;
        Ok(((first + between * interval) * scale, interval * scale))
    }
}

/// Ends of the samples in the curve's buffer, in bytes.
struct Ends {
    at: u64,
    first: u64,
    end: u64,
    buffer: u64,
}

impl Ends {
    fn read(input: &mut Input, endian: Endian) -> Result<Self, FormatError> {
        let at = input.offset();
        let first = input.number(SampleType::U32, endian)? as u64;
        let end = input.number(SampleType::U32, endian)? as u64;
        input.skip(4)?;
        let buffer = input.number(SampleType::U32, endian)? as u64;
        Ok(Self {
            at,
            first,
            end,
            buffer,
        })
    }

    /// Count of samples, which must be the declared one.
    fn samples(&self, kind: SampleType, declared: u64) -> Result<u64, FormatError> {
        let bytes = kind.bytes() as u64;
        let (first, end) = (self.first, self.end);
        let samples = end.saturating_sub(first) / bytes;
        let whole = self.buffer / bytes;
        if first > end || end > self.buffer || (declared != samples && declared != whole) {
            let what = format!(
                "samples from byte {first} to {end} of {}, but {declared} samples declared",
                self.buffer
            );
            return Err(FormatError::at_byte(self.at, what));
        }
        Ok(samples)
    }
}

impl Vertical {
    /// Largest magnitude: the file's extent if given, else the range of the integers.
    fn full_scale(&self, kind: SampleType) -> Option<f64> {
        let value = |code: f64| (self.scale * code + self.offset).abs();
        if self.extent.1 > self.extent.0 {
            return Some(self.extent.0.abs().max(self.extent.1.abs())).filter(|x| x.is_finite());
        }
        kind.range().map(|(low, high)| value(low).max(value(high)))
    }
}

fn vertical(input: &mut Input, endian: Endian) -> Result<Vertical, FormatError> {
    let at = input.offset();
    let scale = input.number(SampleType::F64, endian)?;
    let offset = input.number(SampleType::F64, endian)?;
    if !scale.is_finite() || !offset.is_finite() || scale == 0.0 {
        let what = format!("a vertical scale of {scale:e} with offset {offset:e}");
        return Err(FormatError::at_byte(at, what));
    }
    input.skip(4)?;
    let unit = input.text(20)?;
    let low = input.number(SampleType::F64, endian)?;
    let high = input.number(SampleType::F64, endian)?;
    input.skip(16)?;
    let format = input.number(SampleType::U32, endian)? as u32;
    let storage = input.number(SampleType::U32, endian)? as u32;
    if storage != 0 {
        return Err(input.wrong("an envelope or histogram, no samples over time"));
    }
    input.skip(20)?;
    Ok(Vertical {
        scale,
        offset,
        unit,
        extent: (low, high),
        format,
    })
}

/// Storage type of the data format's code; 6 and 7 came with version 3.
fn kind(format: u32, version: u8, point_bytes: u64) -> Result<SampleType, String> {
    let kind = match (format, version) {
        (0, _) if point_bytes == 1 => SampleType::I8,
        (0, _) => SampleType::I16,
        (1, _) => SampleType::I32,
        (2, _) => SampleType::U32,
        (3, _) => SampleType::U64,
        (4, _) => SampleType::F32,
        (5, _) => SampleType::F64,
        (6, 3) => SampleType::U8,
        (7, 3) => SampleType::I8,
        _ => {
            return Err(format!(
                "data format {format} is unknown in version {version}"
            ));
        }
    };
    if kind.bytes() as u64 == point_bytes {
        Ok(kind)
    } else {
        Err(format!(
            "{point_bytes} bytes a point do not fit data format {format}"
        ))
    }
}

/// Key-value pairs after the samples (`tekmeta!`); absent in older files.
fn metadata(input: &mut Input, endian: Endian) -> Result<BTreeMap<String, String>, FormatError> {
    let mut all = BTreeMap::new();
    // A checksum of 8 bytes comes first.
    if input.remaining() < 20 {
        return Ok(all);
    }
    input.skip(8)?;
    if &input.array::<8>()? != b"tekmeta!" {
        return Ok(all);
    }
    let count = input.number(SampleType::U32, endian)? as u64;
    for _ in 0..count {
        let key = sized_text(input, endian)?;
        let value = match input.number(SampleType::U8, endian)? as u8 {
            1 => sized_text(input, endian)?,
            2 => input.number(SampleType::I32, endian)?.to_string(),
            3 => input.number(SampleType::F64, endian)?.to_string(),
            4 => input.number(SampleType::U32, endian)?.to_string(),
            other => {
                let what = format!("metadata `{key}` has the unknown type {other}");
                return Err(input.wrong(what));
            }
        };
        if key.starts_with("IQ_") {
            return Err(input.wrong("an IQ waveform, no voltage over time"));
        }
        if !value.trim().is_empty() {
            all.insert(key, value);
        }
    }
    Ok(all)
}

/// Reads a text with its length; a long one is truncated.
fn sized_text(input: &mut Input, endian: Endian) -> Result<String, FormatError> {
    let length = input.number(SampleType::U32, endian)? as u64;
    input.need(length)?;
    let read = length.min(MAX_TEXT_BYTES);
    let text = input.text(read as usize)?;
    input.skip(length - read)?;
    Ok(text)
}

impl CaptureFile for WfmSource {
    fn channels(&self) -> &[FileChannel] {
        std::slice::from_ref(&self.channel)
    }

    fn metadata(&self) -> BTreeMap<String, String> {
        self.metadata.clone()
    }

    fn read(
        &mut self,
        selected: &[usize],
        progress: ReadProgress<'_>,
    ) -> Result<FileSamples, FormatError> {
        let curve = &self.curve;
        self.input.seek(curve.at)?;
        let values = self.input.samples(
            curve.samples,
            curve.kind,
            self.endian,
            curve.scale,
            curve.offset,
            progress,
        )?;
        let time = TimeBase::Even {
            t0_s: self.t0_s,
            dt_s: self.dt_s,
        };
        Ok(single_channel(values, time, selected))
    }
}
