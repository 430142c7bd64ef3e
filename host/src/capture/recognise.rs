//! Which format a file is of, by its content; only regular files are looked at.

use std::fs::{File, FileType};
use std::io::Read;
use std::path::Path;

use super::error::CaptureError;
use super::formats::{isf, mat, trc, wfm};

/// Bytes from which the format is told.
const HEAD: usize = 4096;

/// Formats that are read.
const READABLE: &str = "MCAP, CSV, Tektronix WFM and ISF, LeCroy TRC, MATLAB MAT v5 and NPZ";

/// A format, by its content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Format {
    Csv,
    Wfm,
    Isf,
    Trc,
    Mat,
    Npz,
    Mcap,
}

/// Opens a regular file; nothing else, as a pipe would block and cannot be sought.
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

/// Tells the format from the first bytes.
pub(super) fn recognise(path: &Path) -> Result<Format, CaptureError> {
    let mut head = Vec::new();
    let read = regular(path)?.take(HEAD as u64).read_to_end(&mut head);
    read.map_err(|source| CaptureError::Open {
        path: path.to_owned(),
        source,
    })?;
    format_of(&head).map_err(|what| CaptureError::Unknown {
        path: path.to_owned(),
        what: format!("{what}; readable are {READABLE}"),
    })
}

/// The format of a file that begins with `head`.
fn format_of(head: &[u8]) -> Result<Format, &'static str> {
    if head.is_empty() {
        return Err("it is empty");
    }
    if head.get(2..9) == Some(wfm::VERSION) {
        return Ok(Format::Wfm);
    }
    if trc::descriptor(head).is_some() {
        return Ok(Format::Trc);
    }
    if isf::is_isf(head) {
        return Ok(Format::Isf);
    }
    if mat::endian(head).is_some() {
        return Ok(Format::Mat);
    }
    if head.starts_with(b"\x89HDF") || head.starts_with(b"MATLAB 7.3") {
        return Err("it is HDF5 (MATLAB's -v7.3): save it with -v7");
    }
    if head.starts_with(b"PK\x03\x04") || head.starts_with(b"PK\x05\x06") {
        return Ok(Format::Npz);
    }
    if head.starts_with(::mcap::MAGIC) {
        return Ok(Format::Mcap);
    }
    if head.starts_with(&[0xFF, 0xFE]) || head.starts_with(&[0xFE, 0xFF]) {
        return Err("it is text in UTF-16: save it as UTF-8");
    }
    let control = |b: &u8| *b < 0x20 && !matches!(b, b'\t' | b'\n' | b'\r');
    if head.iter().any(control) {
        return Err("it is binary and begins like none of them");
    }
    Ok(Format::Csv)
}
