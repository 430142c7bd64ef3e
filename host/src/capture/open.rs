//! Opens a capture, whatever wrote it: the format is told by the content, not by the name.

use std::fs::{File, FileType};
use std::io::Read;
use std::path::{Path, PathBuf};

use super::channels::{ChannelOptions, ChannelRef, choose};
use super::error::{CaptureError, FormatError};
use super::formats::Source;
use super::formats::csv::CsvSource;
use super::{Capture, TimeBase, mcap};

/// What the user says of a file, and a second one with the other channel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OpenOptions {
    /// File with the other channel, of one acquisition; its channels are numbered after the first's.
    pub second: Option<PathBuf>,
    /// Channels, units, ratios and signs.
    pub channels: ChannelOptions,
    /// Columns of a table: time (`-` for none), voltage, current; instead of
    /// [`ChannelOptions::channels`].
    pub columns: Option<[ChannelRef; 3]>,
    /// Sampling rate in hertz instead of the file's time.
    pub rate_hz: Option<f64>,
}

/// Bytes from which the format is told.
const HEAD: usize = 4096;

/// Formats that are read.
const READABLE: &str = "CSV, Tektronix WFM and ISF, LeCroy TRC, MATLAB MAT v5, NPZ, and ihd's \
    own MCAP";

/// A format, by its content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Csv,
    Mcap,
}

/// Opens a capture.
///
/// # Errors
/// [`CaptureError`] naming the file, the place in it and what to do.
pub fn open(path: &Path, options: &OpenOptions) -> Result<Capture, CaptureError> {
    open_with(path, options, &mut |_| ())
}

/// Opens a capture; `progress` hears how far the file has been read, from 0 to 1.
///
/// # Errors
/// As [`open`].
pub fn open_with(
    path: &Path,
    options: &OpenOptions,
    progress: &mut dyn FnMut(f64),
) -> Result<Capture, CaptureError> {
    let format = recognise(path)?;
    if format == Format::Mcap {
        return Ok(mcap::read(path)?);
    }
    let mut source = source(path, format, options)?;
    from_source(path, source.as_mut(), options, progress)
}

/// Opens a regular file; nothing else, as a pipe would block and cannot be sought.
fn regular(path: &Path) -> Result<File, CaptureError> {
    let failed = |source| CaptureError::Open {
        path: path.to_owned(),
        source,
    };
    let kind = std::fs::metadata(path).map_err(failed)?.file_type();
    if !kind.is_file() {
        return Err(CaptureError::NotAFile {
            path: path.to_owned(),
            kind: described(kind),
        });
    }
    File::open(path).map_err(failed)
}

fn described(kind: FileType) -> &'static str {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if kind.is_fifo() {
            return "a pipe";
        }
        if kind.is_socket() {
            return "a socket";
        }
    }
    if kind.is_dir() {
        "a directory"
    } else {
        "a device"
    }
}

/// Tells the format from the first bytes.
fn recognise(path: &Path) -> Result<Format, CaptureError> {
    let mut head = Vec::new();
    let read = regular(path)?.take(HEAD as u64).read_to_end(&mut head);
    read.map_err(|source| CaptureError::Open {
        path: path.to_owned(),
        source,
    })?;
    let unknown = |what: &str| {
        Err(CaptureError::Unknown {
            path: path.to_owned(),
            what: format!("{what}; readable are {READABLE}"),
        })
    };
    if head.is_empty() {
        return unknown("it is empty");
    }
    if head.starts_with(::mcap::MAGIC) {
        return Ok(Format::Mcap);
    }
    if head.starts_with(&[0xFF, 0xFE]) || head.starts_with(&[0xFE, 0xFF]) {
        return unknown("it is text in UTF-16, save it as UTF-8");
    }
    let control = |b: &u8| *b < 0x20 && !matches!(b, b'\t' | b'\n' | b'\r');
    if head.iter().any(control) {
        return unknown("it is binary and begins like none of them");
    }
    Ok(Format::Csv)
}

fn source(
    path: &Path,
    format: Format,
    options: &OpenOptions,
) -> Result<Box<dyn Source>, CaptureError> {
    let file = regular(path)?;
    let opened: Result<Box<dyn Source>, FormatError> = match format {
        Format::Csv => CsvSource::open(file, options.columns.as_ref())
            .map(|source| Box::new(source) as Box<dyn Source>),
        Format::Mcap => unreachable_format(),
    };
    opened.map_err(|e| e.in_file(path))
}

fn unreachable_format() -> Result<Box<dyn Source>, FormatError> {
    Err(FormatError::at_byte(
        0,
        "a recording has no channels to choose",
    ))
}

fn from_source(
    path: &Path,
    source: &mut dyn Source,
    options: &OpenOptions,
    progress: &mut dyn FnMut(f64),
) -> Result<Capture, CaptureError> {
    let choice = |what: String| CaptureError::Choice {
        path: path.to_owned(),
        what,
    };
    let [v, i] = choose(source.channels(), &options.channels).map_err(choice)?;
    let full_scale = |c: super::channels::Chosen| {
        let channel = source.channels().get(c.index)?;
        channel.full_scale.map(|full| full * c.factor.abs())
    };
    let (v_full_scale_v, i_full_scale_a) = (full_scale(v), full_scale(i));
    let samples = source.read(&[v.index, i.index], progress);
    let samples = samples.map_err(|e| e.in_file(path))?;
    let mut columns = samples.columns.into_iter();
    let mut column = |factor: f64| {
        let mut values = columns.next().unwrap_or_default();
        if factor != 1.0 {
            values
                .iter_mut()
                .for_each(|x| *x = (f64::from(*x) * factor) as f32);
        }
        values
    };
    let (v_v, i_a) = (column(v.factor), column(i.factor));
    let stated = options.rate_hz.map(|rate_hz| TimeBase::Even {
        t0_s: 0.0,
        dt_s: 1.0 / rate_hz,
    });
    let time = stated.or(samples.time).ok_or_else(|| {
        choice(
            "the file tells no time: give the sampling rate with --rate, as in --rate 50M".into(),
        )
    })?;
    Ok(Capture {
        name: path.display().to_string(),
        time,
        v_v,
        i_a,
        v_full_scale_v,
        i_full_scale_a,
        f_sw: Vec::new(),
        mains_hz: None,
        zero_crossing_s: None,
        truth: Vec::new(),
        metadata: source.metadata(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(name: &str, content: &[u8]) -> (tempfile::TempDir, PathBuf) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(name);
        std::fs::write(&path, content).unwrap();
        (dir, path)
    }

    #[test]
    fn a_plain_table_is_a_capture() {
        let text = "time_s,v_V,i_mA\n-1e-6,10,1000\n0,20,-500\n1e-6,30,250\n";
        let (_dir, path) = written("a.csv", text.as_bytes());
        let capture = open(&path, &OpenOptions::default()).unwrap();
        assert_eq!(capture.v_v, [10.0, 20.0, 30.0]);
        assert_eq!(capture.i_a, [1.0, -0.5, 0.25]);
        let TimeBase::Even { t0_s, dt_s } = capture.time else {
            panic!("{:?}", capture.time);
        };
        assert!((t0_s + 1e-6).abs() < 1e-18 && (dt_s - 1e-6).abs() < 1e-18);
    }

    #[test]
    fn columns_and_rate_by_the_user() {
        let text = "1,5,7,9\n2,6,8,10\n";
        let (_dir, path) = written("a.csv", text.as_bytes());
        let columns = ["-", "4", "2"].map(ChannelRef::parse);
        let options = OpenOptions {
            columns: Some(columns),
            channels: ChannelOptions {
                channels: Some([ChannelRef::Number(1), ChannelRef::Number(2)]),
                ..ChannelOptions::default()
            },
            rate_hz: Some(2.0),
            ..OpenOptions::default()
        };
        let capture = open(&path, &options).unwrap();
        assert_eq!(
            (capture.v_v, capture.i_a),
            (vec![9.0, 10.0], vec![5.0, 6.0])
        );
        let dt_s = 0.5;
        assert_eq!(capture.time, TimeBase::Even { t0_s: 0.0, dt_s });
        let no_rate = OpenOptions {
            rate_hz: None,
            ..options
        };
        let asked = open(&path, &no_rate).unwrap_err().to_string();
        assert!(asked.contains("--rate 50M"), "{asked}");
    }

    #[test]
    fn what_is_no_file_or_no_capture_is_told() {
        let told = |path: &Path| open(path, &OpenOptions::default()).unwrap_err().to_string();
        let (dir, path) = written("a.bin", b"\x01\x02\x03");
        assert!(told(&path).contains("binary"));
        assert!(told(dir.path()).contains("is a directory"));
        std::fs::write(&path, b"").unwrap();
        assert!(told(&path).contains("empty"));
        std::fs::write(&path, b"t,v,i\n").unwrap();
        assert!(told(&path).contains("a.bin, line"), "{}", told(&path));
        assert!(told(&dir.path().join("none.csv")).contains("none.csv"));
    }
}
