//! Export to NumPy's NPZ, for `numpy.load`. docs/captures.md lists the arrays.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};

use ihd_signal::truth::PeriodTruth;
use ihd_signal::{Capture, ORDERS, TimeBase};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// Deflate's level: the higher ones take four times as long for 5 % less.
const LEVEL: i64 = 3;

/// Number of values encoded at a time.
const CHUNK: usize = 1 << 13;

/// File that drops what is written to it after an error: `ZipWriter::drop` completes the archive even then, and prints that it
/// cannot, beside the error that this program reports.
struct FileUntilError {
    file: File,
    at: u64,
    end: u64,
    error: Option<io::ErrorKind>,
}

impl Write for FileUntilError {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = match self.error {
            Some(_) => bytes.len(),
            None => self.file.write(bytes).inspect_err(|e| {
                if e.kind() != io::ErrorKind::Interrupted {
                    self.error = Some(e.kind());
                }
            })?,
        };
        self.at += written as u64;
        self.end = self.end.max(self.at);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Seek for FileUntilError {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::End(by) => self.end.checked_add_signed(by),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
        };
        let at = at.ok_or(io::ErrorKind::InvalidInput)?;
        if self.error.is_none() {
            self.file.seek(SeekFrom::Start(at))?;
        }
        self.at = at;
        Ok(at)
    }
}

/// Archive being written.
pub(super) struct Archive {
    zip: ZipWriter<BufWriter<FileUntilError>>,
}

impl Archive {
    /// Creates an archive without arrays in an empty file.
    pub(super) fn new(file: File) -> Self {
        let file = FileUntilError {
            file,
            at: 0,
            end: 0,
            error: None,
        };
        Self {
            zip: ZipWriter::new(BufWriter::with_capacity(1 << 16, file)),
        }
    }

    /// Writes an array of the numbers in `from`.
    pub(super) fn copied(
        &mut self,
        name: &str,
        descr: &str,
        shape: &str,
        mut from: impl Read,
    ) -> io::Result<()> {
        self.header(name, descr, shape)?;
        io::copy(&mut from, &mut self.zip).map(drop)
    }

    /// Completes the archive with notes.
    pub(super) fn finish(mut self, notes: &BTreeMap<String, String>) -> io::Result<()> {
        self.begin("metadata.json")?;
        serde_json::to_writer_pretty(&mut self.zip, notes)?;
        let mut out = self.zip.finish().map_err(io::Error::other)?;
        out.flush()?;
        match out.get_ref().error {
            Some(kind) => Err(kind.into()),
            None => Ok(()),
        }
    }

    fn begin(&mut self, name: &str) -> io::Result<()> {
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .compression_level(Some(LEVEL))
            .large_file(true);
        self.zip.start_file(name, options).map_err(io::Error::other)
    }

    /// Starts an array by writing its header (NPY format 1.0).
    fn header(&mut self, name: &str, descr: &str, shape: &str) -> io::Result<()> {
        self.begin(&format!("{name}.npy"))?;
        let mut text =
            format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
        // Magic, version, length and text fill a multiple of 64 bytes, a newline last.
        let padded = (10 + text.len() + 1).next_multiple_of(64) - 11;
        text.extend(std::iter::repeat_n(' ', padded - text.len()));
        text.push('\n');
        let length = u16::try_from(text.len()).map_err(io::Error::other)?;
        self.zip.write_all(b"\x93NUMPY\x01\x00")?;
        self.zip.write_all(&length.to_le_bytes())?;
        self.zip.write_all(text.as_bytes())
    }

    fn values<const B: usize>(&mut self, values: impl Iterator<Item = [u8; B]>) -> io::Result<()> {
        let mut buffer = Vec::with_capacity(CHUNK * B);
        for value in values {
            buffer.extend_from_slice(&value);
            if buffer.len() >= CHUNK * B {
                self.zip.write_all(&buffer)?;
                buffer.clear();
            }
        }
        self.zip.write_all(&buffer)
    }

    fn singles(&mut self, name: &str, x: &[f32]) -> io::Result<()> {
        self.header(name, "<f4", &format!("({},)", x.len()))?;
        self.values(x.iter().map(|x| x.to_le_bytes()))
    }

    fn doubles(
        &mut self,
        name: &str,
        count: usize,
        x: impl Iterator<Item = f64>,
    ) -> io::Result<()> {
        self.header(name, "<f8", &format!("({count},)"))?;
        self.values(x.map(f64::to_le_bytes))
    }

    fn scalar(&mut self, name: &str, x: Option<f64>) -> io::Result<()> {
        let Some(x) = x else { return Ok(()) };
        self.header(name, "<f8", "()")?;
        self.values([x.to_le_bytes()].into_iter())
    }

    fn truth(&mut self, truth: &[PeriodTruth]) -> io::Result<()> {
        type Column = (&'static str, fn(&PeriodTruth) -> f64);
        const COLUMNS: [Column; 5] = [
            ("truth_t_s", |t| t.t_s),
            ("truth_f_sw_hz", |t| t.f_sw_hz),
            ("truth_i_a", |t| t.i_a),
            ("truth_r_power_ohm", |t| t.r_power_ohm),
            ("truth_p_w", |t| t.p_w),
        ];
        if truth.is_empty() {
            return Ok(());
        }
        for (name, value) in COLUMNS {
            self.doubles(name, truth.len(), truth.iter().map(value))?;
        }
        let shape = format!("({}, {})", truth.len(), ORDERS.len());
        self.header("truth_r_ohm", "<f8", &shape)?;
        self.values(truth.iter().flat_map(|t| t.r_ohm).map(f64::to_le_bytes))?;
        self.header("truth_l_h", "<f8", &shape)?;
        self.values(truth.iter().flat_map(|t| t.l_h).map(f64::to_le_bytes))
    }
}

/// Writes the whole capture.
///
/// # Errors
/// What the operating system reports.
pub fn write(capture: &Capture, file: File, progress: &mut dyn FnMut(f64)) -> io::Result<()> {
    let mut archive = Archive::new(file);
    match &capture.time {
        TimeBase::Even { t0_s, dt_s } => {
            archive.scalar("t0_s", Some(*t0_s))?;
            archive.scalar("dt_s", Some(*dt_s))?;
        }
        TimeBase::Stamps(t_s) => archive.doubles("time_s", t_s.len(), t_s.iter().copied())?,
    }
    progress(0.2);
    archive.singles("v_V", &capture.v_v)?;
    progress(0.6);
    archive.singles("i_A", &capture.i_a)?;
    archive.scalar("v_full_scale_V", capture.v_full_scale_v)?;
    archive.scalar("i_full_scale_A", capture.i_full_scale_a)?;
    archive.scalar("mains_hz", capture.mains_hz)?;
    archive.scalar("zero_crossing_s", capture.zero_crossing_s)?;
    let steps = &capture.f_sw;
    if !steps.is_empty() {
        archive.doubles("f_sw_t_s", steps.len(), steps.iter().map(|s| s.t_s))?;
        archive.doubles("f_sw_hz", steps.len(), steps.iter().map(|s| s.f_sw_hz))?;
    }
    archive.truth(&capture.truth)?;
    progress(1.0);
    archive.finish(&capture.metadata)
}
