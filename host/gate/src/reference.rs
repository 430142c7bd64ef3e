//! Reference results for a segment, independent of the method to judge: least squares, the lock-in as a check of least
//! squares, and foreign tones.

use ihd_identify::pooled::PoolPhasors;
use ihd_identify::{
    Estimate, IdentifyError, IdentifyOptions, Method, Preprocessing, run, run_independently,
};
use ihd_signal::noise::WhiteNoise;
use ihd_signal::{Remark, Segment, SegmentError};

use crate::interference::{self, Interference};

/// Reference results for a segment, computed once and used for every method's estimate.
#[derive(Clone, Debug)]
pub struct ReferenceResults {
    /// Least squares with its default options, or the error with which it failed.
    pub least_squares: Result<Estimate, IdentifyError>,
    /// Least squares on the segment without foreign tones; `None` if there are none.
    pub cleaned: Option<Estimate>,
    /// Lock-in with its default options and its own σ, without foreign tones, which it follows further than any other method. It shares
    /// neither splines nor prior with least squares.
    pub lockin: Result<Estimate, IdentifyError>,
    /// Remarks on the segment itself.
    pub remarks: Vec<Remark>,
    /// Phasors of the segment to be pooled; `None` if they are not known.
    phasors: Option<PoolPhasors>,
}

impl ReferenceResults {
    /// Returns `true` if the result of a method with these options is that of the reference.
    pub fn knows(&self, method: Method, settings: &IdentifyOptions) -> bool {
        method == Method::LeastSquares && has_default_least_squares(settings)
    }

    /// Result of a method with these options if it is known already.
    pub fn result_of(
        &self,
        method: Method,
        settings: &IdentifyOptions,
    ) -> Option<Result<Estimate, IdentifyError>> {
        let is_known = self.knows(method, settings);
        is_known.then(|| self.least_squares.clone())
    }

    /// Result of least squares with these options if it is known already.
    pub fn least_squares_of(&self, settings: &IdentifyOptions) -> Option<&Estimate> {
        let known = self.least_squares.as_ref().ok();
        known.filter(|_| has_default_least_squares(settings))
    }

    /// Takes the phasors of the same segment to be pooled out; `noise` is its.
    pub fn take_phasors(&mut self, segment: &Segment, noise: WhiteNoise) -> PoolPhasors {
        let known = self.phasors.take();
        known.unwrap_or_else(|| PoolPhasors::demodulate(segment, noise))
    }

    /// Computes the reference results of a segment with its preprocessing; `known` is its interference if that is known already.
    pub fn compute(
        segment: &Segment,
        preprocessing: &Result<Preprocessing, SegmentError>,
        known: Option<Interference>,
    ) -> Self {
        let settings = IdentifyOptions::default();
        let by = |method: Method| match preprocessing {
            Ok(preprocessing) => run_independently(method, segment, Some(preprocessing), &settings),
            Err(e) => Err(e.clone().into()),
        };
        let least_squares = by(Method::LeastSquares);
        let found = match (&least_squares, preprocessing) {
            (Ok(_), Ok(p)) => known.unwrap_or_else(|| interference::find(segment, p.noise())),
            _ => Interference::default(),
        };
        // Least squares says when and by how much a load steps.
        let is_step = |r: &Remark| r.code == "load_step";
        let step_is_known = matches!(&least_squares, Ok(e) if e.remarks.iter().any(is_step));
        let law = found.law_remark(segment);
        let mut remarks: Vec<Remark> =
            (law.into_iter().filter(|r| !(step_is_known && is_step(r)))).collect();
        let (tones, phasors) = (found.tones, found.phasors);
        if tones.is_empty() {
            return Self {
                lockin: by(Method::Lockin),
                least_squares,
                cleaned: None,
                remarks,
                phasors,
            };
        }
        let clean = interference::remove_tones(segment, &tones);
        let cleaned = run(Method::LeastSquares, &clean, &settings).ok();
        let both = least_squares.as_ref().ok().zip(cleaned.as_ref());
        remarks.extend(both.and_then(|(with, without)| {
            interference::remark(segment, &tones, with, without, false)
        }));
        Self {
            lockin: run_independently(Method::Lockin, &clean, None, &settings),
            least_squares,
            cleaned,
            remarks,
            phasors,
        }
    }
}

fn has_default_least_squares(settings: &IdentifyOptions) -> bool {
    settings.least_squares == IdentifyOptions::default().least_squares
}
