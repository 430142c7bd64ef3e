//! Settings of the estimators from a file.

use std::path::Path;

use anyhow::{Context, Result};
use ihd_identify::IdentifyOptions;

use crate::cli::usage::Usage;

/// Reads the estimators' settings from a TOML file.
///
/// # Errors
/// A file that cannot be read or holds no settings; [`Usage`](crate::cli::usage::Usage) for start values out of range.
pub fn read(path: &Path) -> Result<IdentifyOptions> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let settings: IdentifyOptions =
        toml::from_str(&text).with_context(|| format!("{} holds no settings", path.display()))?;
    settings.check_start().map_err(Usage::from_error)?;
    Ok(settings)
}
