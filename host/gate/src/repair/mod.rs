//! Repair of faults of a capture that its own samples show and undo: exchanged or reversed channels, single samples that are off,
//! samples that are missing without a mark, samples beyond a channel's range.
//!
//! ```text
//! Capture ─► wiring ─► spikes ─► gaps ─► clipping ─► Capture, remarks
//! ```
//!
//! Each repair is a warning, and what it leaves is judged as any other capture.

mod censored;
mod clipping;
mod gaps;
mod spikes;
#[cfg(test)]
mod tests;
mod wiring;

use std::borrow::Cow;

use ihd_signal::{Capture, Remark};
use ihd_survey::{Hints, Survey, SurveyError};

/// Capture after the repairs.
#[derive(Clone, Debug)]
pub struct RepairedCapture<'a> {
    /// Capture, changed if anything was repaired.
    pub capture: Cow<'a, Capture>,
    /// Survey of `capture`.
    pub survey: Survey,
    /// Warnings on what was repaired.
    pub remarks: Vec<Remark>,
    /// Standard deviations of R and of L, as shares, that restored samples add.
    pub shares: [f64; 2],
}

/// Repairs a capture and surveys it.
///
/// # Errors
/// [`SurveyError`] if the capture holds nothing that can be identified.
pub fn repair<'a>(
    capture: Cow<'a, Capture>,
    hints: &Hints,
) -> Result<RepairedCapture<'a>, SurveyError> {
    let survey = Survey::from_capture(&capture, hints)?;
    let mut repaired = RepairedCapture {
        capture,
        survey,
        remarks: Vec::new(),
        shares: [0.0; 2],
    };
    for step in [wiring::repair, spikes::repair, gaps::repair] {
        if let Some(remark) = step(&mut repaired.capture, &repaired.survey) {
            repaired.remarks.push(remark);
            repaired.survey = Survey::from_capture(&repaired.capture, hints)?;
        }
    }
    if let Some(restored) = clipping::repair(&mut repaired.capture, &repaired.survey) {
        repaired.remarks.push(restored.remark);
        repaired.shares = restored.shares;
        repaired.survey = Survey::from_capture(&repaired.capture, hints)?;
    }
    Ok(repaired)
}
