//! What everything on the host speaks of: captures, the segments that estimators take, loads and
//! their truth; and what is done to samples before anybody estimates.
//!
//! ```text
//! Capture ─► Segment ─► estimator ─► R(t), L(t)  against  Truth
//!            Correlator, WhiteNoise   AdcGrid, quantise: the same samples as a board sees them
//! ```

pub mod atomic;
pub mod capture;
pub mod carrier;
pub mod correlation;
pub mod fourier;
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

pub use capture::{Capture, FrequencyStep, TimeBase};
pub use load::Load;
pub use printable::printable;
pub use remark::{Remark, Severity};
pub use samples::{Raw, Samples};
pub use segment::{Segment, SegmentError};
