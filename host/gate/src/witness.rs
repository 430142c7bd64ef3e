//! What a segment says by itself, whoever identifies it: least squares as the reference, the lock-in as the
//! reference's own check, and tones that belong to somebody else.

use ihd_identify::{Estimate, IdentifyError, Method, Settings, run};
use ihd_signal::{Remark, Segment};

use crate::interference;

/// Computed once a segment, used for every method's result.
#[derive(Clone, Debug)]
pub struct Witness {
    /// Least squares with its default settings, or why it failed.
    pub reference: Result<Estimate, IdentifyError>,
    /// The lock-in with its default settings: it shares neither splines nor prior with the reference.
    pub lockin: Result<Estimate, IdentifyError>,
    /// What was found in the segment itself.
    pub remarks: Vec<Remark>,
}

impl Witness {
    /// Of a segment.
    pub fn of(segment: &Segment) -> Self {
        let settings = Settings::default();
        let reference = run(Method::LeastSquares, segment, &settings);
        let remarks = reference.as_ref().ok();
        let remarks = remarks.and_then(|reference| interference::remark(segment, reference));
        Self {
            lockin: run(Method::Lockin, segment, &settings),
            reference,
            remarks: remarks.into_iter().collect(),
        }
    }
}
