//! Tektronix ISF: the response to `WAVFRM?` or `SAVE:WAVEFORM` as a file, one channel.
//!
//! After the programmer manuals of the TDS, DPO and MSO series (WFMPRE, WFMOUTPRE and CURVE
//! commands): a text of `KEY VALUE;` pairs, in long or short form, then `:CURVE #`, the number of
//! digits of the length, the length, and the samples. value = YZERO + YMULT (code − YOFF),
//! time = XZERO + XINCR (k − PT_OFF).

use std::collections::BTreeMap;

use ihd_signal::TimeBase;

use super::input::{Endian, Input, SampleType};
use super::stated_unit::StatedUnit;
use super::{CaptureFile, FileChannel, FileSamples, ReadProgress, single_channel};
use crate::error::FormatError;

/// Limit of the text before the samples, in bytes.
const MAX_HEADER_BYTES: usize = 16 * 1024;

/// Returns `true` if a file with this beginning is an ISF.
pub fn is_isf(head: &[u8]) -> bool {
    let begin = head.get(..256.min(head.len())).unwrap_or(head);
    let text = String::from_utf8_lossy(begin).to_uppercase();
    text.starts_with(":WFM") && !text.starts_with(":WFM#") || text.starts_with("BYT_N")
}

/// An ISF file whose header has been read.
pub struct IsfSource {
    input: Input,
    endian: Endian,
    kind: SampleType,
    samples: u64,
    scale: f64,
    offset: f64,
    time: TimeBase,
    channel: FileChannel,
    metadata: BTreeMap<String, String>,
}

/// Key-value pairs of the header.
struct Header {
    pairs: Vec<(String, String)>,
}

impl Header {
    fn parse(text: &str) -> Self {
        let pair = |part: &str| {
            let part = part.trim();
            // `:WFMPRE:BYT_NR 2`: the path stands before the first key only.
            let (key, value) = part.split_once([' ', '\t'])?;
            let key = key.rsplit(':').next().unwrap_or(key).to_uppercase();
            Some((key, value.trim().trim_matches('"').to_owned()))
        };
        Self {
            pairs: split_outside_quotes(text).filter_map(pair).collect(),
        }
    }

    /// Storage of the samples.
    fn storage(&self) -> Result<(SampleType, Endian), FormatError> {
        let wrong = |what: String| Err(FormatError::at_byte(0, what));
        let kind = match (self.get("BN_F"), self.number("BYT_N")? as u32) {
            (Some("FP"), 4) => SampleType::F32,
            (Some("RP"), 1) => SampleType::U8,
            (Some("RP"), 2) => SampleType::U16,
            (Some("RI") | None, 1) => SampleType::I8,
            (Some("RI") | None, 2) => SampleType::I16,
            (format, bytes) => {
                let format = format.unwrap_or("?");
                return wrong(format!("{bytes} bytes of BN_FMT {format} are not known"));
            }
        };
        match self.get("BYT_O").map(str::to_uppercase).as_deref() {
            Some("LSB") => Ok((kind, Endian::Little)),
            Some("MSB") | None => Ok((kind, Endian::Big)),
            Some(other) => wrong(format!("byte order BYT_OR `{other}`")),
        }
    }

    /// Times of the samples.
    fn time(&self) -> Result<TimeBase, FormatError> {
        let (dt, first, point) = (
            self.number("XIN")?,
            self.number("XZE")?,
            self.number("PT_O")?,
        );
        if dt <= 0.0 {
            let what = format!("XINCR {dt:e}: a sampling interval is positive");
            return Err(FormatError::at_byte(0, what));
        }
        let scale = self.unit("XUN").seconds().map_err(|unit| {
            FormatError::at_byte(0, format!("samples over {unit}, no waveform over time"))
        })?;
        Ok(TimeBase::Even {
            t0_s: (first - dt * point) * scale,
            dt_s: dt * scale,
        })
    }

    /// Value of the key that begins with `short`, its shortest form.
    fn get(&self, short: &str) -> Option<&str> {
        let pair = self.pairs.iter().find(|(key, _)| key.starts_with(short));
        pair.map(|(_, value)| value.as_str())
    }

    /// Unit under a key.
    fn unit(&self, short: &str) -> StatedUnit {
        StatedUnit::parse(self.get(short).unwrap_or_default())
    }

    fn number(&self, short: &str) -> Result<f64, FormatError> {
        let value = self.get(short).and_then(|v| v.parse::<f64>().ok());
        value.filter(|x| x.is_finite()).ok_or_else(|| {
            let text = self.get(short).unwrap_or("nothing");
            FormatError::at_byte(
                0,
                format!("{short} in the header must be a number, is `{text}`"),
            )
        })
    }
}

/// Splits at semicolons outside quotes: the waveform's name may contain one.
fn split_outside_quotes(text: &str) -> impl Iterator<Item = &str> {
    let mut quoted = false;
    text.split(move |c| {
        quoted ^= c == '"';
        c == ';' && !quoted
    })
}

impl IsfSource {
    /// Reads the header.
    ///
    /// # Errors
    /// [`FormatError`] for a damaged header, samples as text, and envelopes.
    pub fn open(mut input: Input) -> Result<Self, FormatError> {
        let mut begin = vec![0; MAX_HEADER_BYTES.min(input.length() as usize)];
        input.exact(&mut begin)?;
        let is_curve = |word: &[u8]| word.eq_ignore_ascii_case(b":CURV");
        let curve = begin.windows(5).position(is_curve).ok_or_else(|| {
            let what = format!("no :CURVE in the first {MAX_HEADER_BYTES} bytes");
            FormatError::at_byte(0, what)
        })?;
        let (text, block) = begin.split_at(curve);
        let header = Header::parse(&String::from_utf8_lossy(text));
        // `:CURVE #` or `:CURV#`; text samples have a number there.
        let hash = block.iter().take(16).position(|b| *b == b'#');
        let hash = hash.ok_or_else(|| {
            let what = "samples as text: save as binary (ENCDG BINARY)";
            FormatError::at_byte(curve as u64, what)
        })?;
        input.seek((curve + hash + 1) as u64)?;
        let length = block_length(&mut input)?;
        Self::from_header(input, &header, length)
    }

    fn from_header(input: Input, header: &Header, length: u64) -> Result<Self, FormatError> {
        let wrong = |what: String| Err(FormatError::at_byte(0, what));
        let (kind, endian) = header.storage()?;
        if header
            .get("PT_F")
            .is_some_and(|f| !f.eq_ignore_ascii_case("Y"))
        {
            return wrong("an envelope (PT_FMT ENV), no samples over time".to_owned());
        }
        let samples = header.number("NR_P")?;
        if samples < 0.0 || samples * kind.bytes() as f64 != length as f64 {
            return wrong(format!(
                "NR_PT {samples} samples, but {length} bytes of them"
            ));
        }
        input.need(length)?;
        let scale = header.number("YMU")?;
        let offset = header.number("YZE")? - scale * header.number("YOF")?;
        let value = |code: f64| (scale * code + offset).abs();
        let full_scale = kind.range().map(|(low, high)| value(low).max(value(high)));
        let name = header.get("WFI").unwrap_or_default();
        let mut metadata = BTreeMap::from([("format".to_owned(), "Tektronix ISF".to_owned())]);
        if !name.is_empty() {
            metadata.insert("waveform".to_owned(), name.to_owned());
        }
        Ok(Self {
            endian,
            kind,
            samples: samples as u64,
            scale,
            offset,
            time: header.time()?,
            channel: FileChannel {
                // `Ch1, DC coupling, 2.000V/div, …`
                name: name.split(',').next().unwrap_or_default().trim().to_owned(),
                unit: header.unit("YUN"),
                full_scale,
            },
            metadata,
            input,
        })
    }
}

/// Reads the length of a block (IEEE 488.2) whose `#` has been read; `#0` extends to the end of the file.
fn block_length(input: &mut Input) -> Result<u64, FormatError> {
    let [digits] = input.array::<1>()?;
    match digits {
        b'0' => Ok(input.remaining()),
        b'1'..=b'9' => {
            let text = input.text(usize::from(digits - b'0'))?;
            let length = text.parse();
            length.map_err(|_| input.wrong(format!("`{text}` is no length of a block")))
        }
        _ => Err(input.wrong("no length after `#`")),
    }
}

impl CaptureFile for IsfSource {
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
        let at = self.input.offset();
        let values = self.input.samples(
            self.samples,
            self.kind,
            self.endian,
            self.scale,
            self.offset,
            progress,
        )?;
        self.input.seek(at)?;
        Ok(single_channel(values, self.time.clone(), selected))
    }
}
