//! Table of the capture formats: name, recognition, reader and writer of each.

use std::fs::{File, FileType};
use std::io::{Cursor, Read};
use std::path::Path;

use ihd_signal::Capture;

use super::error::{CaptureError, FormatError};
use super::exports::{self, ExportError};
use super::formats::csv::CsvSource;
use super::formats::input::{Input, ReadSeek};
use super::formats::isf::{self, IsfSource};
use super::formats::trc::{self, TrcSource};
use super::formats::wfm::{self, WfmSource};
use super::formats::{CaptureFile, ReadProgress, mat, npz};
use super::mcap::{self, McapFileError, SalvagedCapture};
use super::options::ReadOptions;

/// Number of bytes by which a format is recognised.
const HEAD: usize = 4096;

/// File whose header was read, or its defect.
type Opened = Result<Box<dyn CaptureFile>, FormatError>;

/// Reader of a format.
pub(super) enum Opener {
    /// Reads the header first, then the samples of the selected channels; columns apply to tables only.
    Channels(fn(Box<dyn ReadSeek>, ReadOptions<'_>) -> Opened),
    /// Reads a whole capture, for our own format.
    Whole(fn(&Path) -> Result<SalvagedCapture, McapFileError>),
}

/// Reading support of a format.
pub(super) struct ReadSupport {
    /// Returns `true` if a file with this beginning has the format.
    recognises: fn(&[u8]) -> bool,
    /// Reader.
    pub(super) open: Opener,
}

/// Writes a capture to the file at a path.
type Writer = fn(&Capture, &Path, ReadProgress<'_>) -> Result<(), ExportError>;

/// Writing support of a format.
pub struct WriteSupport {
    /// Ending of the file, without the dot.
    pub ending: &'static str,
    /// Writer; `None` if this build has none.
    write: Option<Writer>,
}

/// A format of captures.
pub struct CaptureFormat {
    /// Name shown to users.
    pub name: &'static str,
    /// Reading support; `None` if it cannot be read.
    pub(super) reading: Option<ReadSupport>,
    /// Writing support; `None` if it cannot be written.
    pub writing: Option<WriteSupport>,
}

const fn reading(
    recognises: fn(&[u8]) -> bool,
    open: fn(Box<dyn ReadSeek>, ReadOptions<'_>) -> Opened,
) -> Option<ReadSupport> {
    let open = Opener::Channels(open);
    Some(ReadSupport { recognises, open })
}

/// All formats, in the order of recognition; plain text is last as it has no mark.
pub static FORMATS: [CaptureFormat; 8] = [
    CaptureFormat {
        name: "MCAP",
        reading: Some(ReadSupport {
            recognises: |head| head.starts_with(::mcap::MAGIC),
            open: Opener::Whole(mcap::salvage),
        }),
        writing: Some(WriteSupport {
            ending: "mcap",
            write: Some(|capture, path, _| Ok(mcap::write(capture, path)?)),
        }),
    },
    CaptureFormat {
        name: "Tektronix WFM",
        reading: reading(
            |head| head.get(2..9) == Some(wfm::VERSION),
            |file, _| Input::new(file).and_then(WfmSource::open).map(boxed),
        ),
        writing: None,
    },
    CaptureFormat {
        name: "Tektronix ISF",
        reading: reading(isf::is_isf, |file, _| {
            Input::new(file).and_then(IsfSource::open).map(boxed)
        }),
        writing: None,
    },
    CaptureFormat {
        name: "LeCroy TRC",
        reading: reading(
            |head| trc::descriptor(head).is_some(),
            |file, _| Input::new(file).and_then(TrcSource::open).map(boxed),
        ),
        writing: None,
    },
    CaptureFormat {
        name: "MATLAB MAT v5",
        reading: reading(
            |head| mat::endian(head).is_some(),
            |file, options| {
                let input = Input::new(file)?;
                mat::open(input, options).map(boxed)
            },
        ),
        writing: None,
    },
    CaptureFormat {
        name: "NPZ",
        reading: reading(
            |head| head.starts_with(b"PK\x03\x04") || head.starts_with(b"PK\x05\x06"),
            |file, options| npz::open(file, options).map(boxed),
        ),
        writing: Some(WriteSupport {
            ending: "npz",
            write: Some(exports::write_npz),
        }),
    },
    CaptureFormat {
        name: "CSV",
        reading: reading(is_text, |file, options| {
            CsvSource::open(file, options).map(boxed)
        }),
        writing: Some(WriteSupport {
            ending: "csv",
            write: Some(exports::write_csv),
        }),
    },
    CaptureFormat {
        name: "Parquet",
        reading: None,
        writing: Some(WriteSupport {
            ending: "parquet",
            #[cfg(feature = "parquet")]
            write: Some(exports::write_parquet),
            #[cfg(not(feature = "parquet"))]
            write: None,
        }),
    },
];

fn boxed(source: impl CaptureFile + 'static) -> Box<dyn CaptureFile> {
    Box::new(source)
}

fn is_text(head: &[u8]) -> bool {
    let control = |b: &u8| *b < 0x20 && !matches!(b, b'\t' | b'\n' | b'\r');
    !head.iter().any(control)
}

/// Lists the names of the readable formats, for a message.
fn readable() -> String {
    let names: Vec<&str> = FORMATS
        .iter()
        .filter(|format| format.reading.is_some())
        .map(|format| format.name)
        .collect();
    names.join(", ")
}

/// Lists the endings of the writable formats with their dots, for a message.
fn endings() -> String {
    let endings = FORMATS.iter().filter_map(|format| format.writing.as_ref());
    let dotted: Vec<String> = endings.map(|w| format!(".{}", w.ending)).collect();
    dotted.join(", ")
}

/// Returns the writing support that a file's ending names.
fn writing(path: &Path) -> Result<&'static WriteSupport, ExportError> {
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    let mut writers = FORMATS.iter().filter_map(|format| format.writing.as_ref());
    writers
        .find(|w| Some(w.ending) == ending.as_deref())
        .ok_or_else(|| ExportError::Ending {
            path: path.to_owned(),
            known: endings(),
        })
}

/// Writes a capture, replacing an existing file. `progress` is called with the share done, from 0 to 1.
///
/// # Errors
/// [`ExportError`]; what was written of the file until then is removed.
pub fn write(
    capture: &Capture,
    path: &Path,
    progress: ReadProgress<'_>,
) -> Result<(), ExportError> {
    (writer(path)?)(capture, path, progress)
}

/// Checks that a capture can be written to this path, before a long capture is read for it.
///
/// # Errors
/// [`ExportError::Ending`], or [`ExportError::WithoutParquet`] where that is so.
pub fn check(path: &Path) -> Result<(), ExportError> {
    writer(path).map(drop)
}

fn writer(path: &Path) -> Result<Writer, ExportError> {
    writing(path)?
        .write
        .ok_or_else(|| ExportError::WithoutParquet {
            path: path.to_owned(),
        })
}

/// Opens a regular file; a pipe is rejected, as it would block and has no positions.
pub(super) fn regular(path: &Path) -> Result<File, CaptureError> {
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

/// Recognises a file's format by its first bytes and returns its reader.
pub(super) fn recognise(path: &Path) -> Result<&'static Opener, CaptureError> {
    recognised(path).map(|(_, reading)| &reading.open)
}

/// Returns the name of a file's format, by its first bytes.
///
/// # Errors
/// [`CaptureError`] for a file that cannot be read or is in no known format.
pub fn name(path: &Path) -> Result<&'static str, CaptureError> {
    recognised(path).map(|(format, _)| format.name)
}

/// Format with its reader.
type Reader = (&'static CaptureFormat, &'static ReadSupport);

fn recognised(path: &Path) -> Result<Reader, CaptureError> {
    let mut head = Vec::new();
    let read = regular(path)?.take(HEAD as u64).read_to_end(&mut head);
    read.map_err(|source| CaptureError::Open {
        path: path.to_owned(),
        source,
    })?;
    if head.is_empty() {
        return Err(CaptureError::Empty {
            path: path.to_owned(),
        });
    }
    reader(&head).map_err(|what| CaptureError::Unknown {
        path: path.to_owned(),
        what: format!("{what}; readable are {}", readable()),
    })
}

/// Opens a file in memory, but for MCAP; `None` if its format is not known.
pub fn open_bytes(bytes: Vec<u8>) -> Option<Opened> {
    match reader(&bytes[..bytes.len().min(HEAD)]).map(|(_, reading)| &reading.open) {
        Ok(Opener::Channels(open)) => {
            Some(open(Box::new(Cursor::new(bytes)), ReadOptions::default()))
        }
        Ok(Opener::Whole(_)) | Err(_) => None,
    }
}

/// Returns the format of a file that begins with `head`.
fn reader(head: &[u8]) -> Result<Reader, &'static str> {
    if head.starts_with(b"\x89HDF") || head.starts_with(b"MATLAB 7.3") {
        return Err("it is HDF5 (MATLAB's -v7.3): save it with -v7");
    }
    if head.starts_with(&[0xFF, 0xFE]) || head.starts_with(&[0xFE, 0xFF]) {
        return Err("it is text in UTF-16: save it as UTF-8");
    }
    let mut readers = FORMATS
        .iter()
        .filter_map(|format| Some((format, format.reading.as_ref()?)));
    readers
        .find(|(_, reading)| (reading.recognises)(head))
        .ok_or("it is binary and begins like none of them")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_can_be_read_and_written_is_listed_from_the_table() {
        assert_eq!(
            readable(),
            "MCAP, Tektronix WFM, Tektronix ISF, LeCroy TRC, MATLAB MAT v5, NPZ, CSV"
        );
        assert_eq!(endings(), ".mcap, .npz, .csv, .parquet");
    }

    #[test]
    fn an_ending_names_its_writer_whatever_its_case() {
        let ending = |name: &str| writing(Path::new(name)).map(|w| w.ending).ok();
        assert_eq!(ending("a.NPZ"), Some("npz"));
        assert_eq!(ending("a.mcap"), Some("mcap"));
        assert_eq!(ending("a.wfm"), None);
        assert_eq!(ending("a"), None);
    }
}
