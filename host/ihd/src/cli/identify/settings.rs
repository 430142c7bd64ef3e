//! Settings of the estimators from a file.

use std::ops::RangeInclusive;
use std::path::Path;

use anyhow::{Context, Result};
use ihd_identify::IdentifyOptions;

/// Ranges of start values: R in ohm and L in henry, far beyond those of a hob.
const START: [RangeInclusive<f64>; 2] = [0.01..=100.0, 1e-6..=10e-3];

/// Checks the start values of R in ohm and L in henry.
fn check_start(start: Option<(f64, f64)>) -> Result<()> {
    let Some((r_ohm, l_h)) = start else {
        return Ok(());
    };
    for (name, value, range) in [("R", r_ohm, &START[0]), ("L", l_h, &START[1])] {
        ensure_usage!(
            range.contains(&value),
            "start: {name} is {value:e}, but must be {:e} to {:e}: write ohm and henry, as in start = [2.5, 20e-6]",
            range.start(),
            range.end()
        );
    }
    Ok(())
}

/// Reads the estimators' settings from a TOML file.
///
/// # Errors
/// A file that cannot be read or holds no settings; [`Usage`](crate::cli::usage::Usage) for start values out of range.
pub fn read(path: &Path) -> Result<IdentifyOptions> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let settings: IdentifyOptions =
        toml::from_str(&text).with_context(|| format!("{} holds no settings", path.display()))?;
    check_start(settings.start)?;
    Ok(settings)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::usage::Usage;

    /// 20 µH as 20, and 2.5 ohm as milliohm.
    #[test]
    fn a_start_in_another_unit_is_refused() {
        assert!(check_start(None).is_ok() && check_start(Some((2.5, 20e-6))).is_ok());
        for start in [
            (2.5, 20.0),
            (2500.0, 20e-6),
            (0.0, 20e-6),
            (f64::NAN, 20e-6),
        ] {
            let why = check_start(Some(start)).unwrap_err();
            assert!(
                why.is::<Usage>() && why.to_string().contains("henry"),
                "{why}"
            );
        }
    }
}
