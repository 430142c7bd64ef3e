//! What a segment says by itself, whoever identifies it: least squares as the reference, the lock-in as the
//! reference's own check, and tones that belong to somebody else.

use ihd_identify::{Estimate, IdentifyError, LookedAt, Method, Settings, run, run_again};
use ihd_signal::{Remark, Segment};

use crate::interference;

/// Computed once a segment, used for every method's result.
#[derive(Clone, Debug)]
pub struct Witness {
    /// Least squares with its default settings, or why it failed.
    pub reference: Result<Estimate, IdentifyError>,
    /// Least squares on the segment without foreign tones; `None` where there are none.
    pub cleaned: Option<Estimate>,
    /// The lock-in with its default settings, without foreign tones, which it follows further than anybody: it shares
    /// neither splines nor prior with the reference.
    pub lockin: Result<Estimate, IdentifyError>,
    /// What was found in the segment itself.
    pub remarks: Vec<Remark>,
}

impl Witness {
    /// What a method with these settings would find, where that is known already.
    pub fn result_of(
        &self,
        method: Method,
        settings: &Settings,
    ) -> Option<Result<Estimate, IdentifyError>> {
        let default = Settings::default();
        match method {
            Method::LeastSquares if settings.least_squares == default.least_squares => {
                Some(self.reference.clone())
            }
            _ => None,
        }
    }

    /// Of a segment.
    pub fn of(segment: &Segment) -> Self {
        let settings = Settings::default();
        let looked_at = LookedAt::of(segment);
        let by = |method: Method| match &looked_at {
            Ok(looked_at) => run_again(method, segment, looked_at, &settings),
            Err(e) => Err(e.clone().into()),
        };
        let reference = by(Method::LeastSquares);
        let tones = match &reference {
            Ok(reference) => interference::find(segment, reference),
            Err(_) => Vec::new(),
        };
        if tones.is_empty() {
            return Self {
                lockin: by(Method::Lockin),
                reference,
                cleaned: None,
                remarks: Vec::new(),
            };
        }
        let clean = interference::without(segment, &tones);
        let cleaned = run(Method::LeastSquares, &clean, &settings).ok();
        let both = reference.as_ref().ok().zip(cleaned.as_ref());
        let remark =
            both.and_then(|(with, without)| interference::remark(segment, &tones, with, without));
        Self {
            lockin: run(Method::Lockin, &clean, &settings),
            reference,
            cleaned,
            remarks: remark.into_iter().collect(),
        }
    }
}
