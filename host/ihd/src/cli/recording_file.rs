//! File of a recording on the command line.

use std::path::PathBuf;

use ihd_capture::exports::ExportError;
use ihd_capture::format;

/// Parses the name of a recording, which is MCAP and so must not have another format's ending.
///
/// # Errors
/// The way to the format that the ending names.
pub fn parse(name: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(name);
    let is_mcap = path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("mcap"));
    if is_mcap || matches!(format::check(&path), Err(ExportError::Ending { .. })) {
        return Ok(path);
    }
    let mcap = path.with_extension("mcap");
    Err(format!(
        "a recording is MCAP: --out {0}, then `ihd convert {0} --out {name}`",
        mcap.display()
    ))
}
