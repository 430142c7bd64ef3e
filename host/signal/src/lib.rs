//! Common types of the host: captures, segments for estimators, loads and their truth. Also the processing of samples
//! before estimation.
//!
//! ```text
//! Capture ─► Segment ─► estimator ─► R(t), L(t)  against  Truth
//!            Correlator, WhiteNoise   AdcGrid, quantise: the same samples as a board sees them
//! ```

pub mod atomic;
pub mod capture;
pub mod carrier;
pub mod correlation;
pub mod current_transformer;
pub mod interpolation;
pub mod load;
pub mod noise;
pub mod printable;
pub mod quantise;
pub mod remark;
pub mod resample;
pub mod samples;
pub mod segment;
pub mod truth;
pub mod vectorised;
pub mod warp;
pub mod with_sigma;

pub use capture::{Capture, FrequencyStep, TimeBase};
pub use ihd_fourier as fourier;
pub use load::{Load, ORDERS};
pub use printable::printable;
pub use remark::{Remark, Severity};
pub use samples::{RawSamples, Samples};
pub use segment::{Segment, SegmentError};
pub use with_sigma::WithSigma;
